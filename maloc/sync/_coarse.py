"""Coarse alignment: clock offsets of up to a day and drifts of up to a minute a day, by voting.

Every detection of a sync tag, less its travel time, is an emission time on the receiver's own
clock. All differences to emission times of the same tag on clocks already aligned are counted in
bins; the true offset collects the votes of every ping that both heard, wrong pairings spread out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["CoarseClock", "align"]

DRIFT = 8e-4  # largest believable drift, s/s (69 s a day)
WINDOW = 6 * 3600.0  # at most this far between votes, s
FEW = 6  # fewer detections than this cannot be aligned
BEND = 3e-5  # largest change of drift that is no jump, s/s
NODE = 1800.0  # spacing of the piecewise-linear offset, s


class CoarseClock(NamedTuple):
    """Piecewise-linear offset of one receiver.

    Attributes
    ----------
    time : array (M,)
        The receiver's own clock, s.
    offset : array (M,)
        Own clock minus reference clock, s.
    drift : float
        Slope used beyond the ends, s/s.
    start, end : float
        Where on its own clock the receiver was aligned, s; infinite when everywhere.
    jump : float
        Largest jump found and not followed, s; 0 = none.
    ambiguous : bool
        Another offset had nearly as many votes (sync tags with one common, regular interval).
    """

    time: np.ndarray
    offset: np.ndarray
    drift: float
    start: float = -np.inf
    end: float = np.inf
    jump: float = 0.0
    ambiguous: bool = False

    def at(self, time: np.ndarray) -> np.ndarray:
        """Offset (N,) at times (N,) of the receiver's own clock, s."""
        inside = np.clip(time, self.time[0], self.time[-1])
        return np.interp(inside, self.time, self.offset) + self.drift * (time - inside)


class _Vote(NamedTuple):
    time: float
    offset: float
    votes: int
    first: float
    last: float
    ambiguous: bool


def _pairs(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs (i, j) with low[i] <= j < high[i]."""
    count = high - low
    i = np.repeat(np.arange(len(count)), count)
    j = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    return i, j


def _vote(time: np.ndarray, key: np.ndarray, known: np.ndarray, limit: float) -> _Vote | None:
    """Find the offset that most same-tag differences within +-`limit` agree on; None if unclear."""
    width = 0.3 + DRIFT * np.ptp(time) / 2
    low, high = np.searchsorted(known, key - limit), np.searchsorted(known, key + limit)
    i, j = _pairs(low, high)
    if len(i) == 0:
        return None
    difference = key[i] - known[j]
    n_bins = int(2 * limit / width) + 2
    count = np.bincount(((difference + limit) / width).astype(int), minlength=n_bins + 1)
    votes = count[:-1] + count[1:]  # overlapping double bins: no offset falls on an edge
    best, ambiguous = int(votes.argmax()), False
    rivals = np.flatnonzero(votes > 0.8 * votes[best])
    if len(rivals) > 1 and np.ptp(rivals) > 2:  # regular intervals: every multiple has its votes
        best, ambiguous = _sharpest(rivals, time[i], difference, width, limit)
    near = np.abs(difference - ((best + 1) * width - limit)) <= width
    distinct = len(np.unique(j[near]))
    # differences of two records of equal length are twice as dense in the middle as on average
    background = 2 * len(difference) * 2 * width / max(float(np.ptp(difference)), 2 * width)
    chance = background + 5 * np.sqrt(background) + 4
    if distinct < 5 or near.sum() <= chance:
        return None
    span = time[np.unique(i[near])]
    offset = float(np.median(difference[near]))
    votes_best = int(near.sum())
    return _Vote(float(span.mean()), offset, votes_best, span[0], span[-1], ambiguous)


def _sharpest(
    rivals: np.ndarray, time: np.ndarray, difference: np.ndarray, width: float, limit: float
) -> tuple[int, bool]:
    """Bin whose differences scatter least about a line, or the one nearest 0 where that is unclear.

    Even regular tags jitter, and only at the true offset does the jitter cancel.
    """
    order = np.argsort(difference)
    sorted_, centre = difference[order], (rivals + 1) * width - limit
    spread = np.full(len(rivals), np.inf)
    for n, c in enumerate(centre):
        rows = order[slice(*np.searchsorted(sorted_, [c - width, c + width]))]
        if len(rows) < 4:  # nothing to tell scatter from
            continue
        rows = rows[np.argsort(time[rows], kind="stable")]
        half = len(rows) // 2
        early, late = rows[:half], rows[half:]
        run = np.median(time[late]) - np.median(time[early])
        rise = np.median(difference[late]) - np.median(difference[early])
        rest = difference[rows] - (rise / run if run > 0 else 0.0) * time[rows]
        spread[n] = np.median(np.abs(rest - np.median(rest)))
    best = int(spread.argmin())
    other = spread[np.abs(rivals - rivals[best]) > 2].min(initial=np.inf)
    if spread[best] < 0.5 * other:
        return int(rivals[best]), False
    return int(rivals[np.abs(centre).argmin()]), True


def _windows(time: np.ndarray, most: int = 150) -> list[np.ndarray]:
    """Row indices of windows along a sorted record, <= WINDOW apart, <= `most` rows each."""
    span = float(time[-1] - time[0])
    n = max(1, int(np.ceil(len(time) / most))) if span < WINDOW else int(np.ceil(span / WINDOW)) + 1
    n = max(1, min(n, len(time) // FEW))
    out = []
    for rows in np.array_split(np.arange(len(time)), n):
        middle = len(rows) // 2
        out.append(rows[max(0, middle - most // 2) : middle + most // 2])
    return out


def _runs(time: np.ndarray, offset: np.ndarray, allowed: float, bend: float) -> list[slice]:
    """Split where neighbours leave the common drift by more than `allowed` s + `bend` s/s."""
    run, rise = np.diff(time), np.diff(offset)
    if len(run) > 1:
        rise = rise - np.median(rise / np.maximum(run, 1.0)) * run
    else:
        bend = DRIFT  # one step says nothing of the drift
    cut = np.flatnonzero(np.abs(rise) > allowed + bend * run) + 1
    edges = [0, *cut.tolist(), len(time)]
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def _line(votes: list[_Vote], drift: float) -> CoarseClock:
    time = np.array([v.time for v in votes])
    offset = np.array([v.offset for v in votes])
    clock = CoarseClock(time, offset, drift)
    return clock._replace(drift=_slope(clock))


def _rest(clock: CoarseClock, time: np.ndarray, key: np.ndarray, known: np.ndarray) -> np.ndarray:
    """How far each detection (N,) is from the nearest known emission under this offset, s."""
    k = key - clock.at(time)
    right = np.clip(np.searchsorted(known, k), 1, len(known) - 1)
    nearest = np.where(np.abs(known[right] - k) < np.abs(known[right - 1] - k), right, right - 1)
    return k - known[nearest]


def _refine(
    clock: CoarseClock, time: np.ndarray, key: np.ndarray, known: np.ndarray, tolerance: float
) -> CoarseClock:
    """Sharpen to medians of matched differences in windows of `NODE` seconds."""
    rest = _rest(clock, time, key, known)
    ok = np.abs(rest) < tolerance
    x, e = time[ok], (clock.at(time) + rest)[ok]
    if len(x) < FEW:
        return clock
    if len(clock.time) == 1:  # no slope yet: repeated medians of half against half
        half = len(x) // 2
        rise = np.median(e[half:]) - np.median(e[:half])
        run = np.median(x[half:]) - np.median(x[:half])
        clock = clock._replace(drift=float(rise / run) if run > 0 else 0.0)
    flat = e - clock.drift * x
    bins = ((x - x[0]) / NODE).astype(int)
    cut = np.r_[0, np.flatnonzero(np.diff(bins)) + 1, len(x)]
    nodes = [
        (x[a:b].mean(), np.median(flat[a:b]))
        for a, b in zip(cut[:-1], cut[1:], strict=True)
        if b - a >= 5
    ]
    if not nodes:
        nodes = [(x.mean(), np.median(flat))]
    t, m = np.array(nodes).T
    return clock._replace(time=t, offset=m + clock.drift * t)


def _merge(known: np.ndarray, key: np.ndarray, within: float = 1.0) -> np.ndarray:
    """Add emission times that are not known yet."""
    right = np.clip(np.searchsorted(known, key), 1, len(known) - 1)
    away = np.minimum(np.abs(known[right] - key), np.abs(known[right - 1] - key))
    new = np.sort(key[away > within])
    if len(new):
        new = new[np.r_[True, np.diff(new) > within]]
    return np.sort(np.concatenate([known, new]))


def align(
    emission: np.ndarray,
    tag: np.ndarray,
    receiver: np.ndarray,
    n_receivers: int,
    reference: int,
    *,
    limit: float = 26 * 3600.0,
) -> dict[int, CoarseClock]:
    """Align all receivers to one, those that share most with the aligned ones first.

    Parameters
    ----------
    emission : array (N,)
        Recorded time less travel time from the sync tag, on the receiver's own clock, s.
    tag, receiver : array (N,) of int
    n_receivers, reference : int
    limit : float
        Largest offset searched for, s.

    Returns
    -------
    dict of int to CoarseClock
        Receivers that could be aligned (the reference among them, offset 0).
    """
    room = 2 * (np.ptp(emission) + 2 * limit + 10.0) if len(emission) else 1.0
    base = emission.min() - limit - 5.0 if len(emission) else 0.0
    key = tag * room + (emission - base)  # one sorted axis on which tags never meet
    rows = [np.flatnonzero(receiver == j) for j in range(n_receivers)]
    rows = [i[np.argsort(emission[i], kind="stable")] for i in rows]
    heard = np.zeros((n_receivers, int(tag.max(initial=0)) + 1))
    np.add.at(heard, (receiver, tag), 1)
    shared = np.minimum(heard[:, None], heard[None]).sum(2)

    zero = np.zeros(1)
    clocks = {reference: CoarseClock(zero, zero, 0.0)}
    known = np.sort(key[rows[reference]])
    todo = [j for j in range(n_receivers) if j != reference and len(rows[j]) >= FEW]
    while todo and len(known) > 1:
        order = sorted(todo, key=lambda j: (-max(shared[j, k] for k in clocks), j))
        for j in order:
            clock = _align_one(emission[rows[j]], key[rows[j]], known, limit)
            if clock is not None:
                break
        else:
            break
        clocks[j] = clock
        todo.remove(j)
        time = emission[rows[j]]
        inside = (time >= clock.start) & (time <= clock.end)
        known = _merge(known, (key[rows[j]] - clock.at(time))[inside])
    return clocks


def _align_one(
    time: np.ndarray, key: np.ndarray, known: np.ndarray, limit: float
) -> CoarseClock | None:
    votes = [v for w in _windows(time) if (v := _vote(time[w], key[w], known, limit)) is not None]
    if not votes:
        return None
    t, o, n = np.array([(v.time, v.offset, v.votes) for v in votes]).T
    runs = _runs(t, o, 1.0, BEND)
    run = max(runs, key=lambda r: n[r].sum())
    jumps = _jumps(o, runs)
    first = votes[run.start - 1].last if run.start else -np.inf
    last = votes[run.stop].first if run.stop < len(votes) else np.inf
    clock = _line(votes[run], 0.0)
    # wide first: the votes know the offset only to the width of a bin
    wide = 0.6 + DRIFT * min(WINDOW, float(np.ptp(time))) / 8
    clock = _refine(clock, time, key, known, wide)
    runs, t = _runs(clock.time, clock.offset, 0.4, BEND), clock.time
    if len(runs) > 1:
        run = max(runs, key=lambda r: r.stop - r.start)
        jumps += _jumps(clock.offset, runs)
        first = max(first, float(clock.time[run.start]) - NODE) if run.start else first
        last = min(last, float(clock.time[run.stop - 1]) + NODE) if run.stop < len(t) else last
        clock = clock._replace(time=clock.time[run], offset=clock.offset[run])
        clock = clock._replace(drift=_slope(clock))
    for tolerance in (0.6, 0.3):
        inside = (time >= first) & (time <= last) if jumps else np.ones(len(time), bool)
        clock = _refine(clock, time[inside], key[inside], known, tolerance)
    if jumps:
        start, end = _stretch(clock, time, key, known, first, last)
        clock = clock._replace(start=start, end=end, jump=max(jumps, key=abs))
    return clock._replace(ambiguous=any(v.ambiguous for v in votes))


def _jumps(offset: np.ndarray, runs: list[slice]) -> list[float]:
    return [float(offset[b.start] - offset[b.start - 1]) for b in runs[1:]]


def _slope(clock: CoarseClock) -> float:
    if len(clock.time) < 2:
        return clock.drift
    return float(np.median(np.diff(clock.offset) / np.maximum(np.diff(clock.time), 1.0)))


def _stretch(
    clock: CoarseClock,
    time: np.ndarray,
    key: np.ndarray,
    known: np.ndarray,
    first: float,
    last: float,
) -> tuple[float, float]:
    """First and last time between which most detections match, within `first` and `last`."""
    inside = (time >= first) & (time <= last)
    match = (np.abs(_rest(clock, time, key, known)) < 0.3) & inside
    share = np.convolve(match, np.full(9, 1 / 9), "same")
    good = time[match & (share >= 0.5)]
    return (float(good[0]), float(good[-1])) if len(good) else (first, last)
