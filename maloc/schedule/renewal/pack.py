"""From gaps to batches of one form and like size."""

from __future__ import annotations

import numpy as np

from maloc.data._padding import bucket
from maloc.schedule.intervals import IntervalLaw, Poisson, Stable, Table
from maloc.schedule.renewal.counts import CountPart, path_weights, terms
from maloc.schedule.renewal.exact import ExactPart
from maloc.schedule.renewal.gap import (
    Gap,
    adiabatic,
    away,
    end_of,
    is_narrow,
    kind_code,
    knots,
    needed,
)
from maloc.schedule.renewal.grid import Grid, end_rows, first_size, grid_of, recursion
from maloc.schedule.renewal.long import ENDS, LongPart, splines
from maloc.schedule.renewal.poisson import PoissonPart

__all__ = [
    "FLOOR",
    "batch_size",
    "exact_part",
    "parts_of",
]

FLOOR = 1e-6  # likelihood, per mean interval, of a gap that the law rules out
_CLASSES = (4, 16)  # blocks of the batches that are always there


def batch_size(n: int, pad: bool, like) -> int:
    """Rows of a batch of n gaps."""
    return max(bucket(n) if pad else n, 0 if like is None else len(like.index))


def _possible(gap: Gap, law: Table, c0: float, first: float) -> bool:
    """Whether some number of intervals makes up the gap."""
    if gap.kind == "after" or (gap.kind == "before" and not gap.first_at_start):
        return True
    if c0 + first > FLOOR / law.mean:
        return True
    low, high = (law.lo, law.hi) if gap.kind == "inside" else (0.0, law.first_breaks(True)[-1])
    m = np.arange(2, int(gap.duration / max(law.lo, 1e-3 * law.hi)) + 2)
    edge = 1e-3 * law.sd
    inside = (low + m * law.lo + edge < gap.duration) & (gap.duration < high + m * law.hi - edge)
    return bool(np.any(inside))


def exact_part(gaps, law: Table, grid: Grid, blocks: int, rows: int, nowhere: int):
    """One batch: list of (index, Gap), and which of them the law rules out."""
    size = blocks * grid.block
    width = first_size(law, grid, size)
    n_knots = -(-size // grid.coarse) + 1
    index, duration, kind, _, _ = _nodes_away(gaps, rows, nowhere)
    left, right = np.zeros((rows, n_knots), np.int32), np.zeros((rows, n_knots), np.int32)
    share = np.zeros((rows, n_knots))
    c0, first, later = np.ones(rows), np.zeros((rows, width)), np.zeros((rows, size))
    at = grid.start + grid.path_step * np.arange(n_knots)
    for r, (_, gap) in enumerate(gaps):
        reach = np.minimum(at, gap.duration + grid.path_step)
        left[r], right[r], share[r] = knots(gap, reach)
    for code in np.unique(kind[: len(gaps)]):
        mine = np.flatnonzero(kind[: len(gaps)] == code)
        c0[mine], first[mine], later[mine] = end_rows(
            duration[mine], law, grid, size, *end_of(law, *ENDS[code])
        )
    impossible = []
    for r, (i, gap) in enumerate(gaps):
        if not _possible(gap, law, c0[r], first[r].sum()):
            impossible.append(i)
            c0[r], first[r], later[r] = FLOOR / law.mean, 0.0, 0.0
    a, beta, diagonal = recursion(law, grid, size)
    part = ExactPart(
        index, duration, kind, left, right, share, c0, first, later, a, beta, diagonal, grid.coarse
    )
    return part, impossible


def _classes(blocks: list[int]) -> list[int]:
    """Sizes of the batches, in blocks."""
    most = max(blocks, default=0)
    return [*_CLASSES, *([bucket(most)] if most > _CLASSES[-1] else [])]


def _exact_parts(gaps, law: Table, size: int, pad: bool, like):
    grid = grid_of(law)
    blocks = [-(-needed(gap, law, grid) // grid.block) for _, gap in gaps]
    parts, impossible, low = [], [], 0
    for k, most in enumerate(_classes(blocks)):
        mine = [g for g, b in zip(gaps, blocks, strict=True) if low < b <= most]
        low = most
        rows = batch_size(len(mine), pad, like[k] if k < len(like) else None)
        if rows:
            part, ruled_out = exact_part(mine, law, grid, most, rows, size)
            parts.append(part)
            impossible += ruled_out
    return parts, impossible


def _nodes_away(gaps, rows: int, nowhere: int):
    """Index, duration, kind, node times and states of a batch, the last node repeated."""
    longest = max((len(gap.nodes) for _, gap in gaps), default=2)
    index, kind = np.full(rows, nowhere, np.int32), np.ones(rows, np.int32)
    duration, time = np.zeros(rows), np.zeros((rows, longest))
    states = np.zeros((rows, longest), np.int32)
    for r, (i, gap) in enumerate(gaps):
        index[r], kind[r], duration[r] = i, kind_code(gap), gap.duration
        at, where = away(gap)
        time[r], states[r] = at[-1], where[-1]
        time[r, : len(at)], states[r, : len(at)] = at, where
    return index, duration, kind, time, states


def _width(gaps, pad: bool, like) -> int:
    """Nodes of a batch: a few sizes only."""
    longest = max((len(gap.nodes) for _, gap in gaps), default=2)
    longest = bucket(longest) if pad else longest
    return max(longest, 0 if like is None else like.states.shape[1])


def _widened(array: np.ndarray, width: int) -> np.ndarray:
    """Last column repeated."""
    return np.pad(array, ((0, 0), (0, width - array.shape[1])), mode="edge")


def _long_part(gaps, law: Table, size: int, pad: bool, like):
    rows = batch_size(len(gaps), pad, like)
    index, duration, kind, time, states = _nodes_away(gaps, rows, size)
    width = _width(gaps, pad, like)
    time, states = _widened(time, width), _widened(states, width)
    step = np.diff(time, axis=1) / 2
    weight = np.pad(step, ((0, 0), (1, 0))) + np.pad(step, ((0, 0), (0, 1)))
    real = (np.arange(rows) < len(gaps)).astype(float)
    return LongPart(index, duration, kind, time, weight, states, *splines(law), real)


def _poisson_part(gaps, law: Poisson, size: int, pad: bool, like):
    rows = batch_size(len(gaps), pad, like)
    index, duration, kind, time, states = _nodes_away(gaps, rows, size)
    width = _width(gaps, pad, like)
    return PoissonPart(
        index, duration, kind, _widened(time, width), _widened(states, width),
        np.asarray(1 / law.mean), np.asarray(law.expiry),
    )  # fmt: skip


def _count_part(gaps, law: Table | Stable, size: int, pad: bool, like):
    rows = batch_size(len(gaps), pad, like)
    index, duration, kind, _, states = _nodes_away(gaps, rows, size)
    found = [terms(g.kind, g.duration, law, end_of(law, *ENDS[kind_code(g)])[0]) for _, g in gaps]
    many = max((len(n) for n, _, _ in found), default=1)
    many = -(-many // 4) * 4 if pad else many
    width = _width(gaps, pad, like)
    if like is not None:
        many = max(many, like.log_density.shape[1])
    least = np.zeros(rows, np.int32)
    log_density = np.full((rows, many), -1e30)
    log_density[len(gaps) :, 0] = 0.0
    weight = np.zeros((rows, many, width))
    impossible = []
    floor = np.log(FLOOR / law.mean)
    for r, ((i, gap), (n, density, last)) in enumerate(zip(gaps, found, strict=True)):
        at, _ = away(gap)
        least[r] = n[0]
        if density.max() < (floor if gap.kind == "inside" else -1e10):
            impossible.append(i)
            log_density[r, int(np.argmax(n == n[len(n) // 2]))] = floor
            continue
        log_density[r, : len(n)] = np.maximum(density, -1e30)
        for c, (count, end) in enumerate(zip(n, last, strict=True)):
            if density[c] > -1e10 and count:
                weight[r, c, : len(at)] = path_weights(int(count), float(end), at)
    states = _widened(states, width)
    return CountPart(index, duration, kind, least, log_density, weight, states), impossible


def parts_of(gaps: list[Gap], law: IntervalLaw, size: int, pad: bool, like):
    """Batches, constants (G,) and impossible gaps (G,) of a data set."""
    constant, impossible = np.zeros(len(gaps)), np.zeros(len(gaps), bool)
    for i, gap in enumerate(gaps):
        if not len(gap.nodes):
            constant[i], impossible[i] = _alone(gap, law)
    rest = [(i, gap) for i, gap in enumerate(gaps) if len(gap.nodes)]
    same = {type(part): part for part in like if not isinstance(part, ExactPart)}
    if isinstance(law, Poisson):
        return [_poisson_part(rest, law, size, pad, same.get(PoissonPart))], constant, impossible
    if isinstance(law, Stable) or is_narrow(law):
        part, ruled_out = _count_part(rest, law, size, pad, same.get(CountPart))
        impossible[ruled_out] = True
        return [part], constant, impossible
    far = [(i, g) for i, g in rest if adiabatic(g, law)]
    near = [(i, g) for i, g in rest if not adiabatic(g, law)]
    exact = [part for part in like if isinstance(part, ExactPart)]
    parts, ruled_out = _exact_parts(near, law, size, pad, exact)
    impossible[ruled_out] = True
    if far or pad or LongPart in same:  # padded: the same batches for every data set
        parts.append(_long_part(far, law, size, pad, same.get(LongPart)))
    return parts, constant, impossible


def _alone(gap: Gap, law: IntervalLaw) -> tuple[float, bool]:
    """Log likelihood of a gap in which no ping was missed, and whether the law rules it out."""
    if gap.kind == "inside":
        value = law.density(gap.duration)
    elif gap.kind == "after":
        value = law.survival(gap.duration)
    else:
        value = law.first_density(gap.duration, gap.first_at_start)
    least = FLOOR / law.mean
    return float(np.log(max(float(value), least))), bool(value <= least)
