"""Detections closer than a tag pings: which of them another receiver heard too.

Clocks may be hours apart, so that a ping is found again at another receiver by the pattern of the
pings around it: the offset that most of them agree on.
"""

from __future__ import annotations

import numpy as np

from maloc.data._time import NS
from maloc.data.report import Note

__all__ = ["TOO_SOON", "screen"]

TOO_SOON = "too soon for a ping"
LATE_S = 0.5  # a reflected first arrival shortens the interval to the next by no more than this
AROUND = 6  # pings before and after that make the pattern
AGREE = 5  # of them must be found again at one offset; by chance about once in 1e5 searches
SAME_S = 0.15  # as far as motion and drift change the offset within the pattern
CLOCKS_S = 6 * 3600.0  # clocks further apart than this find nothing again


def screen(
    ns: np.ndarray,
    tag: str,
    trains: list[tuple[str, np.ndarray]],
    limits: tuple[float, float],
    why: np.ndarray,
) -> list[Note]:
    """Write into `why` which detections of a tag are too near another at their receiver.

    Parameters
    ----------
    ns : array (N,) of int64
        Times of all detections.
    tag : str
        The tag.
    trains : list of (str, array of int64)
        Receivers that heard it, and the rows of its detections there in time order.
    limits : (float, float)
        Shortest and longest burst interval, s.
    why : array (N,) of object
        Reasons, changed in place.

    Returns
    -------
    list of Note
        What came too soon but was heard by several receivers.
    """
    shortest, longest = limits
    whole = all((ns[rows] % NS == 0).all() for _, rows in trains)  # seconds were cut or rounded
    apart = shortest - min(LATE_S + whole, shortest / 4)
    start = min((int(ns[rows[0]]) for _, rows in trains), default=0)
    times = [(ns[rows] - start) / NS for _, rows in trains]
    sent = 0
    for k, (receiver, rows) in enumerate(trains):
        time = times[k]
        near = np.flatnonzero(np.diff(time) < apart)
        for cluster in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1) if len(near) else []:
            members = np.arange(cluster[0], cluster[-1] + 2)
            again = _heard_again(time, members, times[:k] + times[k + 1 :])
            worth = 1.0 + 10.0 * again + 0.01 * _fitting(time, members, shortest, longest)
            keep = members[_heaviest(time[members], worth, apart)]
            for m in np.setdiff1d(members, keep):
                if again[m - members[0]]:
                    sent += 1
                    continue
                gap = np.abs(time[keep] - time[m]).min()
                why[rows[m]] = f"{gap:.3f} s from another at {receiver}, {TOO_SOON}"
    if not sent:
        return []
    text = (
        f"{sent} detections of {tag} come sooner than its burst interval allows, but several "
        "receivers heard them: sent so (when switched on?), the limits are wrong, or two tags have "
        "this code (maloc.emitters.split_same_code); kept"
    )
    return [Note("warning", text, sent)]


def _heard_again(time: np.ndarray, members: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """Return which `members` of `time` (N,) another receiver heard, by the pattern around them."""
    around = np.arange(max(members[0] - AROUND, 0), min(members[-1] + AROUND + 1, len(time)))
    pattern = time[np.setdiff1d(around, members)]
    found = np.zeros(len(members), bool)
    if len(pattern) < AGREE:
        return found
    middle = time[members[0]]
    for other in others:
        a, b = np.searchsorted(other, [middle - CLOCKS_S, middle + CLOCKS_S])
        offset = np.sort((other[a:b, None] - pattern).ravel())
        if not len(offset):
            continue
        end = np.searchsorted(offset, offset + 2 * SAME_S, side="right")
        count = end - np.arange(len(offset))
        best = int(count.argmax())
        if count[best] < AGREE:
            continue
        expected = time[members] + np.median(offset[best : end[best]])
        i = np.clip(np.searchsorted(other, expected), 1, max(len(other) - 1, 1))
        left, right = other[i - 1], other[np.minimum(i, len(other) - 1)]
        distance = np.minimum(np.abs(left - expected), np.abs(right - expected))
        found |= distance <= SAME_S
    return found


def _fitting(time: np.ndarray, members: np.ndarray, shortest: float, longest: float) -> np.ndarray:
    """How many of the nearest detections lie one burst interval before or after each member."""
    out = np.zeros(len(members))
    for i, m in enumerate(members):
        a, b = np.searchsorted(time, [time[m] - longest - LATE_S, time[m] + longest + LATE_S])
        gap = np.abs(time[a:b] - time[m])
        out[i] = min(int((gap >= shortest - LATE_S).sum()), 4)
    return out


def _heaviest(time: np.ndarray, worth: np.ndarray, apart: float) -> list[int]:
    """Indices, each at least `apart` from the next, that are worth most; the earlier of equals."""
    n = len(time)
    best, before = np.zeros(n + 1), np.searchsorted(time, time - apart, side="right")
    taken = np.zeros(n, bool)
    for i in range(n):
        with_it = worth[i] + best[before[i]]
        taken[i] = with_it > best[i]
        best[i + 1] = max(with_it, best[i])
    out, i = [], n
    while i > 0:
        if taken[i - 1]:
            out.append(i - 1)
            i = int(before[i - 1])
        else:
            i -= 1
    return out[::-1]
