"""The joint fit and the jumps: look for jumps, fit, date them, drop the doubtful, again."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from maloc.sync import _jumps
from maloc.sync._arrivals import Arrivals, Geometry, distances, log_density
from maloc.sync._curve import evaluate
from maloc.sync._model import Grid, Jumps, Solution, Start, solve
from maloc.sync._polish import Jump, joined, polish
from maloc.sync._progress import Tell, silent

__all__ = ["Dated", "fit_with_jumps"]

MANY = 120_000  # arrivals of a first fit
LEAST = 0.004  # smallest jump, s
SURE = 5.0  # a jump is this many times as large as its standard error
PENALTY = 12.0  # log likelihood that a jump must bring
EITHER_SIDE = 5  # direct arrivals that a jump needs: fewer may as well be late
RUN = 15  # arrivals of which most must fit
ROUNDS = 6


class Dated(NamedTuple):
    """Jumps in the order of `Jumps`, common times in s, arrays (J,)."""

    jumps: Jumps
    low: np.ndarray  # of the last arrival that lies before it for sure
    high: np.ndarray  # of the first arrival that lies after it for sure
    before: np.ndarray  # of the arrivals that most likely are its neighbours
    after: np.ndarray


def fit_with_jumps(
    a: Arrivals,
    common: np.ndarray,
    sizes: list[tuple[int, float]],
    state: np.ndarray,
    geometry: Geometry,
    grid: Grid,
    reference: int,
    *,
    varying: bool,
    tell: Tell = silent,
) -> tuple[Arrivals, Solution, Dated]:
    """Fit the clocks, and find and date their jumps.

    Parameters
    ----------
    a : Arrivals
        Segments as far as the coarse clocks know.
    common : array (N,)
        Coarse common time, s.
    sizes : list of (clock, size)
        Jumps of the coarse clocks, s, in the order of `a.segment`.
    state : array (K, R, 2)
        Coarse state at the knots, jumps taken out.
    geometry, grid, reference, varying, tell
        As in `solve`.

    Returns
    -------
    Arrivals
        With all segments.
    Solution
    Dated
    """
    n_clocks = state.shape[1]
    rows = [np.flatnonzero(a.receiver == j) for j in range(n_clocks)]
    rows = [r[np.lexsort((common[r], a.segment[r]))] for r in rows]
    jumps = _known(a, rows, sizes)
    solved = partial(
        solve, geometry=geometry, grid=grid, reference=reference, varying=varying, tell=tell
    )
    travel = distances(geometry.xyz, a.place, a.source) / geometry.sound_speed
    curve = evaluate(state, grid.first, grid.spacing, a.receiver, common)
    polished = polish(a.recorded - travel, a.ping, curve, common, rows, jumps)
    jumps, state = polished.jumps, _state(polished.nodes, grid, reference)
    a, table = _segments(a, rows, jumps)
    start = Start(state, table)
    every = len(a.recorded) // MANY
    if every > 1:
        thin = a.ping % every == 0
        part = Arrivals(*(x[thin] for x in a))
        part = part._replace(ping=np.unique(part.ping, return_inverse=True)[1])
        start = solved(part, start=start).end
    fitted = solved(a, start=start)
    if _lost(rows, fitted):
        # a curve left its arrivals while its noise was not known yet: once more, knowing it
        known = Start(state, table, reflected=fitted.reflected, intensity=fitted.end.intensity)
        again = solved(a, start=known)
        fitted = max(fitted, again, key=_worth)
    add = True
    for _ in range(ROUNDS):
        revised, changed = _revise(a, rows, fitted, jumps, add=add)
        if not changed:
            break
        b, table = _segments(a, rows, revised)
        begin = fitted.end._replace(jumps=table)
        again = solved(b, start=begin)
        if _worth(again) > _worth(fitted):
            a, jumps, fitted = b, revised, again
        elif add:
            add = False
        else:
            break
    return a, fitted, _dated(rows, fitted, jumps, _apart(a, fitted))


def _lost(rows: list[np.ndarray], fitted: Solution) -> bool:
    """Whether hardly an arrival of a run at some receiver fits."""
    for mine in rows:
        off = fitted.p_direct[mine] < 0.5
        if len(mine) >= RUN and np.convolve(off, np.ones(RUN), "valid").max() >= 0.8 * RUN:
            return True
    return False


def _worth(fitted: Solution) -> float:
    """Log likelihood less what each jump must be worth."""
    likelihood = log_density(fitted.residual, fitted.sigma, fitted.reflected).sum()
    return float(likelihood) - PENALTY * len(fitted.end.jumps.size)


def _known(a: Arrivals, rows: list[np.ndarray], sizes: list[tuple[int, float]]) -> list[Jump]:
    """Jumps of the coarse clocks that have arrivals on either side."""
    out = []
    for j, mine in enumerate(rows):
        own = [size for clock, size in sizes if clock == j]
        for n, size in enumerate(own):
            first = int(np.searchsorted(a.segment[mine], n, "right"))
            if 0 < first < len(mine):
                out.append(Jump(j, first, size))
    return out


def _segments(a: Arrivals, rows: list[np.ndarray], jumps: list[Jump]) -> tuple[Arrivals, Jumps]:
    segment = np.zeros(len(a.recorded), int)
    order = np.zeros(len(jumps), int)
    for j, mine in enumerate(rows):
        own = [n for n, jump in enumerate(jumps) if jump.clock == j]
        order[own] = np.arange(len(own))
        cuts = np.array([jumps[n].first for n in own], int)
        segment[mine] = np.searchsorted(cuts, np.arange(len(mine)), "right")
    clock = np.array([j.clock for j in jumps], int)
    size = np.array([j.size for j in jumps], float)
    return a._replace(segment=segment), Jumps(clock, order, size)


def _state(
    nodes: list[tuple[np.ndarray, np.ndarray] | None], grid: Grid, reference: int
) -> np.ndarray:
    """State (K, R, 2) at the knots against the reference's curve."""
    state, half = np.zeros((grid.n, len(nodes), 2)), grid.spacing / 2

    def at(node: tuple[np.ndarray, np.ndarray], time: np.ndarray) -> np.ndarray:
        x, y = node
        line = np.polyfit(x - x[0], y, 1) if len(x) > 1 else np.array([0.0, y[0]])
        flat = np.interp(time, x, y - np.polyval(line, x - x[0]))
        return flat + np.polyval(line, time - x[0])

    for j, node in enumerate(nodes):
        if node is not None:
            state[:, j, 0] = at(node, grid.time)
            state[:, j, 1] = at(node, grid.time + half) - at(node, grid.time - half)
    return state - state[:, [reference]]


def _apart(a: Arrivals, fitted: Solution) -> np.ndarray:
    """Residual (N,) of each arrival to what the others of its ping say, s."""
    total = np.bincount(a.ping, fitted.p_direct)[a.ping]
    rest = np.maximum(1 - fitted.p_direct / np.maximum(total, 1e-9), 0.05)
    return fitted.residual / rest


def _revise(
    a: Arrivals, rows: list[np.ndarray], fitted: Solution, jumps: list[Jump], *, add: bool
) -> tuple[list[Jump], bool]:
    """Date the jumps anew, drop those in doubt, add what residuals show; whether any changed."""
    apart, out = _apart(a, fitted), []
    for n, jump in enumerate(jumps):
        size, sd = float(fitted.end.jumps.size[n]), float(fitted.jump_sd[n])
        if abs(size) >= max(SURE * sd, LEAST):
            best, *_ = _date(rows, fitted, jumps, n, apart)
            out.append(Jump(jump.clock, best, size))
    out = _long_enough(rows, fitted, joined(out, 0))
    changed = [j[:2] for j in out] != [j[:2] for j in jumps]
    if add:
        for j, mine in enumerate(rows):
            for first, size in _jumps.steps(fitted.common[mine], apart[mine], LEAST, most=2):
                if all(jump.clock != j or abs(jump.first - first) > 3 for jump in out):
                    out.append(Jump(j, first, size))
                    changed = True
    return joined(out, 0), changed


def _long_enough(rows: list[np.ndarray], fitted: Solution, jumps: list[Jump]) -> list[Jump]:
    """Undo stretches of too few direct arrivals: at an end they may as well be late."""
    out: list[Jump] = []
    for j in dict.fromkeys(jump.clock for jump in jumps):
        direct = np.concatenate([[0], np.cumsum(fitted.p_direct[rows[j]] > 0.5)])
        own = [jump for jump in jumps if jump.clock == j]
        while own:
            edges = [0, *(jump.first for jump in own), len(rows[j])]
            count = np.diff(direct[edges])
            n = int(count.argmin())
            if count[n] >= EITHER_SIDE:
                break
            if 0 < n < len(own):  # the jumps on either side of it are one
                own[n] = own[n]._replace(size=own[n - 1].size + own[n].size)
            del own[min(max(n - 1, 0), len(own) - 1)]
        out += own
    return out


def _stretch(rows: list[np.ndarray], jumps: list[Jump], n: int) -> tuple[int, int]:
    """First and last (not included) of the clock's arrivals next to jump `n`, to other jumps."""
    own = [j.first for j in jumps if j.clock == jumps[n].clock]
    at = own.index(jumps[n].first)
    end = own[at + 1] if at + 1 < len(own) else len(rows[jumps[n].clock])
    return own[at - 1] if at else 0, end


def _date(
    rows: list[np.ndarray],
    fitted: Solution,
    jumps: list[Jump],
    n: int,
    apart: np.ndarray,
) -> tuple[int, int, int]:
    """Most likely, least and largest number of the clock's arrivals before jump `n`."""
    jump, mine = jumps[n], rows[jumps[n].clock]
    begin, end = _stretch(rows, jumps, n)
    found = _jumps.date(
        mine[begin:end], jump.first - begin, float(fitted.end.jumps.size[n]), apart,
        fitted.sigma, fitted.reflected,
    )  # fmt: skip
    best, low, high = (begin + x for x in found)
    return best, low, high


def _dated(rows: list[np.ndarray], fitted: Solution, jumps: list[Jump], apart) -> Dated:
    at = []
    for n, jump in enumerate(jumps):
        mine = rows[jump.clock]
        _, low, high = _date(rows, fitted, jumps, n, apart)
        last, first = mine[max(low - 1, 0)], mine[min(high, len(mine) - 1)]
        at.append((last, first, mine[jump.first - 1], mine[jump.first]))
    index = np.array(at, int).reshape(-1, 4).T
    return Dated(fitted.end.jumps, *fitted.common[index])
