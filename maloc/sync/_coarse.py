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
    best = int(votes.argmax())
    ambiguous = False
    rivals = np.flatnonzero(votes > 0.8 * votes[best])
    far = rivals[np.abs(rivals - best) > 2]
    if len(far):
        best = int(rivals[np.abs((rivals + 1) * width - limit).argmin()])
        ambiguous = True
    near = np.abs(difference - ((best + 1) * width - limit)) <= width
    distinct = len(np.unique(j[near]))
    background = len(difference) * width / limit
    chance = background + 5 * np.sqrt(background) + 4
    if distinct < 5 or near.sum() <= chance:
        return None
    span = time[np.unique(i[near])]
    offset = float(np.median(difference[near]))
    votes_best = int(near.sum())
    return _Vote(float(span.mean()), offset, votes_best, span[0], span[-1], ambiguous)


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


def _runs(votes: list[_Vote]) -> list[list[_Vote]]:
    """Split votes where neighbours disagree by more than any drift explains."""
    runs = [[votes[0]]]
    for a, b in zip(votes[:-1], votes[1:], strict=True):
        if abs(b.offset - a.offset) > 1.0 + DRIFT * abs(b.time - a.time):
            runs.append([])
        runs[-1].append(b)
    return runs


def _line(votes: list[_Vote], drift: float) -> CoarseClock:
    time = np.array([v.time for v in votes])
    offset = np.array([v.offset for v in votes])
    if len(votes) > 1:
        drift = float(np.median(np.diff(offset) / np.maximum(np.diff(time), 1.0)))
    return CoarseClock(time, offset, drift)


def _refine(
    clock: CoarseClock, time: np.ndarray, key: np.ndarray, known: np.ndarray, tolerance: float
) -> CoarseClock:
    """Sharpen to medians of matched differences in windows of `NODE` seconds."""
    offset = clock.at(time)
    k = key - offset
    right = np.clip(np.searchsorted(known, k), 1, len(known) - 1)
    nearest = np.where(np.abs(known[right] - k) < np.abs(known[right - 1] - k), right, right - 1)
    rest = k - known[nearest]
    ok = np.abs(rest) < tolerance
    x, e = time[ok], (offset + rest)[ok]
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
    runs = _runs(votes)
    run = max(runs, key=lambda r: sum(v.votes for v in r))
    ambiguous = any(v.ambiguous for v in run)
    clock = _line(run, 0.0)
    # wide first: the votes know the offset only to the width of a bin
    for tolerance in (0.6 + DRIFT * min(WINDOW, float(np.ptp(time))) / 8, 0.6, 0.3):
        clock = _refine(clock, time, key, known, tolerance)
    if len(runs) > 1:
        jump = max(
            (b[0].offset - a[-1].offset for a, b in zip(runs, runs[1:], strict=False)), key=abs
        )
        clock = clock._replace(start=run[0].first, end=run[-1].last, jump=float(jump))
    return clock._replace(ambiguous=ambiguous)
