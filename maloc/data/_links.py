"""How many burst intervals lie between heard pings, and how long they should be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.arrivals import ArrivalTimes, Schedule
from maloc.errors import InputError

__all__ = [
    "Links",
    "count_intervals",
    "find_phase",
    "insert_unheard",
    "links_of",
    "sequence_counts",
    "stable_counts",
]

_LOOSE = 0.25  # of an interval: further from a whole number, a gap counts no intervals
_DRIFT = 1e-3  # relative; tags' clocks are better
_MISFITS = 0.1  # share of gaps that may fit no stretch of a sequence (false detections)


class Links(NamedTuple):
    """From each row to the next (P - 1,): burst intervals (0 = not known), their length in s."""

    n: np.ndarray
    nominal: np.ndarray


def stable_counts(gaps: np.ndarray, mean: float) -> tuple[np.ndarray, float]:
    """Intervals in each gap (0 where none fits) and the interval's own mean, s."""
    for _ in range(5):  # the nearer the mean, the longer the gaps that can be counted
        n = np.rint(gaps / mean)
        good = (n >= 1) & (np.abs(gaps - n * mean) < _LOOSE * mean / np.sqrt(np.maximum(n, 1)))
        if not good.any():
            break
        few = good & (n <= 2 * n[good].min())
        mean = float(np.median(gaps[few] / n[few]))
    n = np.rint(gaps / mean)
    good = (n >= 1) & (np.abs(gaps - n * mean) < _LOOSE * mean)
    return np.where(good, n, 0.0), mean


def find_phase(gaps: np.ndarray, intervals: np.ndarray, slack: float) -> tuple[int, np.ndarray]:
    """Place in a repeating sequence of intervals at which the first ping was sent.

    Parameters
    ----------
    gaps : (G,) array
        Times between heard pings, s.
    intervals : (L,) array
        The sequence, s; it starts again after its last.
    slack : float
        How far a gap may be off, s; 1e-3 of the gap is added for the tag's clock.

    Returns
    -------
    start : int
        Interval that follows the first ping.
    counts : (G,) array
        Intervals in each gap; 0 where none fit.

    Raises
    ------
    InputError
        If more than a tenth of the gaps fits nowhere, or two places fit equally well.
    """
    intervals = np.asarray(intervals, float)
    if intervals.ndim != 1 or not len(intervals) or not (intervals > 0).all():
        raise InputError("a sequence of burst intervals must be positive numbers")
    tried = np.array([_misfit(gaps, intervals, slack, k)[0] for k in range(len(intervals))])
    best = int(tried.argmin())
    same = np.array([np.array_equal(np.roll(intervals, -k), np.roll(intervals, -best))
                     for k in range(len(intervals))])  # fmt: skip
    if len(gaps) and tried[best] > _MISFITS * len(gaps):
        raise InputError(
            f"{tried[best]:.0f} of {len(gaps)} gaps between heard pings fit the sequence of burst "
            "intervals nowhere",
            mend="compare the sequence with the tag's, and the clocks with true time",
        )
    if (tried[~same] <= tried[best]).any():
        raise InputError(
            "the heard pings do not tell where in the sequence of burst intervals they are",
            mend="give more pings",
        )
    return best, _misfit(gaps, intervals, slack, best)[1]


def _misfit(gaps, intervals, slack: float, start: int):
    """Gaps that fit no stretch of the sequence from `start`, and the intervals in each gap."""
    ends = np.concatenate([[0.0], np.cumsum(np.roll(intervals, -start))])
    cycle, length = float(ends[-1]), len(intervals)
    counts, place, left, missed = np.zeros(len(gaps)), 0.0, 0, 0
    for i, gap in enumerate(gaps):
        target = place + gap
        turns, rest = divmod(target, cycle)
        near = int(np.abs(ends - rest).argmin())
        at = turns * cycle + ends[near]
        right = int(turns) * length + near
        if right > left and abs(at - target) <= slack + _DRIFT * gap:
            counts[i], place, left = right - left, at, right
        else:
            missed, place = missed + 1, target
    return missed, counts


def sequence_counts(
    first: np.ndarray, intervals: np.ndarray, slack: float
) -> tuple[np.ndarray, np.ndarray]:
    """Intervals in each gap of the first arrivals (P,), and each one's length, s (0: not known)."""
    start, counts = find_phase(np.diff(first), intervals, slack)
    rolled, each, place = np.roll(intervals, -start), [], 0
    for n in counts.astype(int):
        each += [rolled[(place + i) % len(rolled)] for i in range(n)] if n else [0.0]
        place += n
    return counts, np.array(each)


def insert_unheard(toa: ArrivalTimes, counts: np.ndarray) -> ArrivalTimes:
    """Rows that nobody heard where a gap between heard pings (P - 1,) holds several intervals."""
    more = np.maximum(np.asarray(counts, int) - 1, 0)
    if not more.any():
        return toa
    row = np.arange(len(toa)) + np.concatenate([[0], np.cumsum(more)])
    n = int(row[-1]) + 1

    def spread(values, empty):
        out = np.full((n, *np.shape(values)[1:]), empty, np.asarray(values).dtype)
        out[row] = values
        return out

    return toa.replace(
        toa=spread(toa.toa, np.nan),
        sound_speed=np.interp(np.arange(n), row, toa.sound_speed),
        ping=np.arange(1, n + 1),
        depth=None if toa.depth is None else spread(toa.depth, np.nan),
        detection=None if toa.detection is None else spread(toa.detection, -1),
        clock_sd=None if toa.clock_sd is None else spread(toa.clock_sd, 0.0),
    )


def links_of(toa: ArrivalTimes, schedule: Schedule) -> Links:
    """Links of one tag's rows, each a ping and all pings."""
    n = np.ones(max(len(toa) - 1, 0))
    if schedule.kind != "stable":
        return Links(n, np.zeros(len(n)))
    rows = np.flatnonzero(toa.n_heard > 0)
    per = np.diff(toa.first[rows]) / np.diff(rows)
    return Links(n, np.full(len(n), float(np.median(per)) if len(per) else schedule.lo))


def count_intervals(first: np.ndarray, kind: str, lo: float, hi: float, slack: float) -> np.ndarray:
    """Burst intervals in each gap where the limits leave one answer, else 0."""
    gaps = np.diff(first)
    if kind == "stable":
        n = np.rint(gaps / lo)
        fits = np.abs(gaps - n * lo) < np.maximum(0.25 * lo, 5 * hi)
        return np.where(fits & (n >= 1), n, 0.0)
    if kind == "random":
        least = np.ceil((gaps - slack) / hi)
        most = np.floor((gaps + slack) / lo)
        return np.where((least == most) & (least >= 1), least, 0.0)
    return np.zeros_like(gaps)
