"""Which detections belong to one ping: limits on the delay between every pair of receivers.

A direct arrival at receiver j follows one at k by no more than their distance in sound time,
|t_j - t_k| <= d_jk / c + tolerance; a reflected one may be later by up to `late`. Detections are
taken in time order and each joins an open ping whose every member it is compatible with, or starts
a new one. Where several fit (short burst intervals, wide arrays) the one wins whose delays look
most like those of the pings before: an animal moves little between pings.
"""

from __future__ import annotations

import numpy as np

SPEED = 5.0  # m/s, no animal's pattern of delays changes faster for long


def echoes(time: np.ndarray, column: np.ndarray, window: float) -> np.ndarray:
    """Return for each detection the one that it echoes, -1 for none.

    Parameters
    ----------
    time : array (N,)
        s, sorted.
    column : array (N,) of int
        Receiver's column.
    window : float
        A detection less than this many seconds after the first of a burst at its receiver is an
        echo of that first one.

    Returns
    -------
    array (N,) of int64
    """
    out = np.full(len(time), -1, np.int64)
    order = np.lexsort((time, column))
    t, c = time[order], column[order]
    close = np.flatnonzero((np.diff(t) < window) & (np.diff(c) == 0)) + 1
    head = -1
    for k in close:
        if out[order[k - 1]] < 0:
            head = int(order[k - 1])
        if time[order[k]] - time[head] < window:
            out[order[k]] = head
    return out


def group(
    time: np.ndarray, column: np.ndarray, travel: np.ndarray, tolerance: float, late: float
) -> np.ndarray:
    """Return the ping of each detection, numbered in the order of first arrivals.

    Parameters
    ----------
    time : array (N,)
        s, sorted.
    column : array (N,) of int
        Receiver's column, 0..R-1.
    travel : array (R, R)
        Sound time between receivers, s.
    tolerance : float
        Timing error allowed in a delay, s.
    late : float
        How much later than direct a reflected arrival may be, s.

    Returns
    -------
    array (N,) of int64
    """
    n = len(time)
    if not n:
        return np.empty(0, np.int64)
    there = np.unique(column)
    widest = float(travel[np.ix_(there, there)].max()) + tolerance + late
    block = np.concatenate([[0], np.cumsum(np.diff(time) > widest)])
    simple = _simple(time, column, block, travel, tolerance + late)
    delays = _pattern(time, column, block, simple, travel + tolerance + late)
    ping = np.full(n, -1, np.int64)
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], block, [block[-1] + 1]])))
    count = 0
    for b in range(len(edges) - 1):
        rows = slice(edges[b], edges[b + 1])
        if simple[b]:
            ping[rows] = count
            count += 1
            delays.learn(time[rows], column[rows])
            continue
        found = _sweep(time[rows], column[rows], travel + tolerance, late, delays)
        ping[rows] = found + count
        count += int(found.max()) + 1
    first = np.full(count, np.inf)
    np.minimum.at(first, ping, time)
    rank = np.empty(count, np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(count)
    return rank[ping]


def _simple(
    time: np.ndarray, column: np.ndarray, block: np.ndarray, travel: np.ndarray, slack: float
) -> np.ndarray:
    """Blocks where each receiver is heard once and every pair's delay is possible."""
    blocks, r = int(block[-1]) + 1, len(travel)
    key = block * r + column
    good = np.bincount(block, minlength=blocks) > 0
    _, index, counts = np.unique(key, return_index=True, return_counts=True)
    good[block[index[counts > 1]]] = False
    there = np.unique(column)
    grid = np.full((blocks, len(there)), np.nan)
    grid[block, np.searchsorted(there, column)] = time
    for a in range(len(there)):
        for b in range(a):
            gap = np.abs(grid[:, a] - grid[:, b])
            good &= ~(gap > travel[there[a], there[b]] + slack)
    return good


class _Delays:
    """The latest delay t_j - t_k seen between each pair of receivers, and when."""

    def __init__(self, r: int) -> None:
        self.delay = np.full((r, r), np.nan)
        self.when = np.full((r, r), -np.inf)

    def learn(self, t: np.ndarray, c: np.ndarray) -> None:
        if len(t) > 1:
            self.delay[np.ix_(c, c)] = t[:, None] - t[None, :]
            self.when[np.ix_(c, c)] = t[0]

    def surprise(self, t: float, j: int, times: list[float], columns: list[int]) -> float:
        """Return how far (s) the delays to a ping's members are from the latest ones seen.

        Motion since then is allowed for. NaN when no member's delay has been seen.
        """
        k = np.asarray(columns)
        since = np.maximum(t - self.when[j, k], 0.0)
        off = np.abs(t - np.asarray(times) - self.delay[j, k]) - 2 * SPEED / 1400.0 * since
        off = off[np.isfinite(off)]
        return float(np.median(np.maximum(off, 0.0))) if len(off) else np.nan


def _pattern(
    time: np.ndarray, column: np.ndarray, block: np.ndarray, simple: np.ndarray, limit: np.ndarray
) -> _Delays:
    """Start from the first simple blocks, so that early difficult ones have a pattern too.

    Pairs of receivers that no simple block joins start from a vote: over the first pings the true
    delay repeats, the delays between one ping and the next do not.
    """
    delays = _Delays(len(limit))
    if not simple.all():
        _vote(time, column, limit, delays)
    for b in np.flatnonzero(simple)[:20][::-1]:
        rows = slice(*np.searchsorted(block, [b, b + 1]))
        delays.learn(time[rows], column[rows])
    return delays


def _vote(
    time: np.ndarray, column: np.ndarray, limit: np.ndarray, delays: _Delays, most: int = 40
) -> None:
    there = np.unique(column)
    early = {int(c): time[column == c][:most] for c in there}
    for a in early:
        for b in early:
            if a == b:
                continue
            gap = (early[a][:, None] - early[b][None, :]).ravel()
            gap = np.sort(gap[np.abs(gap) <= limit[a, b]])
            if len(gap) < 3:
                continue
            inside = np.searchsorted(gap, gap + 0.1, side="right") - np.arange(len(gap))
            k = int(inside.argmax())
            if inside[k] >= 3:
                delays.delay[a, b] = np.median(gap[k : k + inside[k]])
                delays.when[a, b] = time[0]


def _sweep(
    time: np.ndarray, column: np.ndarray, limit: np.ndarray, late: float, delays: _Delays
) -> np.ndarray:
    """Take the detections of one difficult block in time order; return their ping numbers."""
    out = np.empty(len(time), np.int64)
    open_: list[tuple[int, list[float], list[int]]] = []
    widest = float(limit.max()) + late
    count = 0
    for i in range(len(time)):
        t, j = float(time[i]), int(column[i])
        closed = [p for p in open_ if t - p[1][0] > widest]
        for p in closed:
            delays.learn(np.asarray(p[1]), np.asarray(p[2]))
        open_ = [p for p in open_ if t - p[1][0] <= widest]
        best, best_cost = None, np.inf
        for p in open_:
            if j in p[2]:
                continue
            excess = max(t - tk - limit[j, k] for tk, k in zip(p[1], p[2], strict=True))
            if excess > late:
                continue
            surprise = delays.surprise(t, j, p[1], p[2])
            if np.isfinite(surprise) and surprise > late + float(limit.min()):
                continue
            # a delay beyond the direct limit costs as much as being that far off the pattern
            cost = max(excess, 0.0) + (surprise if np.isfinite(surprise) else 0.0)
            if cost < best_cost:
                best, best_cost = p, cost
        if best is None:
            best = (count, [], [])
            open_.append(best)
            count += 1
        best[1].append(t)
        best[2].append(j)
        out[i] = best[0]
    for p in open_:
        delays.learn(np.asarray(p[1]), np.asarray(p[2]))
    return out
