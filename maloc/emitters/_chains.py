"""Chains of pings that one transmitter can have sent, by least-cost flow."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from maloc.emitters._chain_laws import AWAY, Pings, Settings

__all__ = ["ENTER", "Chains", "best_chains"]

ENTER = 40.0  # nats that a transmitter more must be worth; more than an absence costs
_EXCHANGE = 5.0  # nats; what costs less may be an exchange of two transmitters


class Chains(NamedTuple):
    """The best chains.

    Attributes
    ----------
    chains : list of array of int
        Pings of each transmitter, in order of time.
    gain : float
        Nats by which the second chain explains the pings better; 0 where it is not worth `ENTER`.
    apart : float
        Nats by which the chains' own paths explain the places better than one path through all.
    exchange : array (E, 2)
        Where two chains may as well have changed places: time, s, and the nats it would cost.
    settings : Settings
        As learnt.
    """

    chains: list[np.ndarray]
    gain: float
    apart: float
    exchange: np.ndarray
    settings: Settings


def best_chains(pings: Pings, settings: Settings, most: int) -> Chains:
    """Find the number of transmitters and their pings; movement and misses are learnt on the way.

    Parameters
    ----------
    pings : Pings
        N located pings.
    settings : Settings
        Laws to start from.
    most : int
        Chains at most.

    Returns
    -------
    Chains
        As many as are each worth something.
    """
    if not len(pings.time):
        return Chains([], 0.0, 0.0, np.empty((0, 2)), settings)
    extent = np.ptp(pings.xy, axis=0) + 100.0
    area = float(np.prod(extent))
    for _ in range(3):
        chains, _ = _flow(pings, settings, area, min(most, 2))
        settings = _learnt(pings, settings, chains)
    values = [0.0]
    best: list[np.ndarray] = []
    for k in range(1, most + 1):
        chains, value = _flow(pings, settings, area, k)
        if len(chains) < k or value <= values[-1]:
            break
        values.append(value)
        best = chains
    gain = values[2] - values[1] + ENTER if len(values) > 2 else 0.0
    exchange = _exchanges(pings, settings, area, best)
    return Chains(best, gain, _apart(pings, settings, area, best), exchange, settings)


def _learnt(pings: Pings, settings: Settings, chains: list[np.ndarray]) -> Settings:
    """Diffusion and share of missed pings, from the chains' steps."""
    a = np.concatenate([c[:-1] for c in chains] or [np.empty(0, int)])
    b = np.concatenate([c[1:] for c in chains] or [np.empty(0, int)])
    dt = pings.time[b] - pings.time[a]
    here = dt < settings.longest
    if here.sum() < 5:
        return settings
    a, b, dt = a[here], b[here], dt[here]
    square = ((pings.xy[b] - pings.xy[a]) ** 2).sum(axis=1)
    error = np.trace(pings.covariance[a] + pings.covariance[b], axis1=1, axis2=2)
    # the median of a chi square of two degrees is 2 log 2
    diffusion = max(float(np.median((square - error) / dt)) / (2 * np.log(2)), 1e-2)
    missed = 1 - len(dt) * settings.schedule.mean / dt.sum()
    return replace(settings, diffusion=diffusion, missed=float(np.clip(missed, 0.02, 0.95)))


def _apart(pings: Pings, settings: Settings, area: float, chains: list[np.ndarray]) -> float:
    """Nats that two paths explain places better than one, over the time that both were there."""
    if len(chains) < 2:
        return 0.0

    def move(rows: np.ndarray) -> float:
        return float(settings.log_move(pings, rows[:-1], rows[1:], area).sum())

    two = sorted(chains, key=len)[-2:]
    first = max(c[0] for c in two)
    last = min(c[-1] for c in two)
    two = [c[(c >= first) & (c <= last)] for c in two]
    # joining two paths into one adds a step: against "anywhere" that is worth nothing
    return sum(move(c) for c in two) - move(np.sort(np.concatenate(two)))


def _exchanges(
    pings: Pings, settings: Settings, area: float, chains: list[np.ndarray]
) -> np.ndarray:
    """Where chains may be exchanged: time (s) of the step and what it would cost (nats), (E, 2)."""

    def cost(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        gap = pings.time[b] - pings.time[a]
        with np.errstate(invalid="ignore"):
            return -settings.log_gap(gap) - settings.log_move(pings, a, b, area)

    found = [np.empty((0, 2))]
    for one, other in combinations(chains, 2):
        i, k = np.arange(len(one) - 1)[:, None], np.arange(len(other) - 1)[None]
        # steps that overlap in time: each begins before the other ends
        i, k = np.nonzero((one[i] < other[k + 1]) & (other[k] < one[i + 1]))
        a, b, c, d = one[i], one[i + 1], other[k], other[k + 1]
        more = cost(a, d) + cost(c, b) - cost(a, b) - cost(c, d)
        near = more < _EXCHANGE
        middle = (np.maximum(pings.time[a], pings.time[c]) + pings.time[np.minimum(b, d)]) / 2
        found.append(np.stack([middle[near], more[near]], axis=1))
    out = np.concatenate(found)
    return out[np.argsort(out[:, 0])]


def _flow(pings: Pings, settings: Settings, area: float, k: int) -> tuple[list[np.ndarray], float]:
    """The best k chains, fewer where fewer are better, and what they are worth (nats)."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_array

    n = len(pings.time)
    i = np.arange(n)
    a, b = _steps(pings.time, settings)
    cost = -settings.log_gap(pings.time[b] - pings.time[a])
    cost -= settings.log_move(pings, a, b, area)
    fine = np.isfinite(cost)
    a, b, cost = a[fine], b[fine], cost[fine]
    later = np.searchsorted(pings.time, pings.time + settings.longest)
    gone = np.flatnonzero(later < n)
    enter, leave, hall, source, sink = i, n + i, 2 * n + i, 3 * n, 3 * n + 1
    edges = [
        (np.full(n, source), enter, np.full(n, ENTER)),
        (enter, leave, -settings.worth(pings.n_heard)),
        (leave, np.full(n, sink), np.zeros(n)),
        (leave[a], enter[b], cost),
        (leave[gone], hall[later[gone]], np.full(len(gone), AWAY)),
        (hall[:-1], hall[1:], np.zeros(n - 1)),
        (hall, enter, np.zeros(n)),
        (np.array([sink]), np.array([source]), np.zeros(1)),
    ]
    tail, head, cost = (np.concatenate(part) for part in zip(*edges, strict=True))
    m = len(cost)
    upper = np.ones(m)
    upper[m - 1] = k
    upper[m - 2 * n : m - n - 1] = k  # any number may wait in the hall
    which = np.arange(m)
    balance = coo_array(
        (np.repeat([1.0, -1.0], m), (np.concatenate([head, tail]), np.tile(which, 2))),
        shape=(3 * n + 2, m),
    ).tocsr()
    solved = linprog(
        cost, A_eq=balance, b_eq=np.zeros(3 * n + 2), bounds=np.stack([np.zeros(m), upper], 1),
        method="highs",
    )  # fmt: skip
    return _read(solved.x > 0.5, tail, head, n), float(-solved.fun)


def _steps(time: np.ndarray, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of pings a shortest interval apart or more, and no absence."""
    first = np.searchsorted(time, time + settings.shortest)
    last = np.searchsorted(time, time + settings.longest)
    size = last - first
    a = np.repeat(np.arange(len(time)), size)
    b = np.arange(len(a)) - np.repeat(np.cumsum(size) - size, size) + first[a]
    return a, b


def _read(used: np.ndarray, tail: np.ndarray, head: np.ndarray, n: int) -> list[np.ndarray]:
    """Chains from the edges used: each ping's next one, through the hall in order of time."""
    after = {int(t): int(h) for t, h in zip(tail[used], head[used], strict=True) if t < 2 * n}
    starts = head[used & (tail == 3 * n)]
    # who waits in the hall leaves it in the order in which they came, as good as any
    exits = sorted(int(h) for t, h in zip(tail[used], head[used], strict=True)
                   if 2 * n <= t < 3 * n and h < n)  # fmt: skip
    came = sorted((h, t) for t, h in after.items() if 2 * n <= h < 3 * n)
    for (_, t), exit_ in zip(came, exits, strict=True):
        after[t] = exit_
    chains = []
    for start in starts:
        chain, node = [], int(start)
        while node < n:
            chain.append(node)
            node = after[n + node]
        chains.append(np.array(chain))
    return sorted(chains, key=len, reverse=True)
