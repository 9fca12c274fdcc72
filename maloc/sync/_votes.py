"""Votes on a clock's offset: all differences of same-tag emission times, counted in bins.

The true offset collects the votes of every ping that both heard, wrong pairings spread out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["DRIFT", "Vote", "pairs", "vote"]

DRIFT = 1.5e-3  # largest believable drift of two clocks against each other, s/s (130 s a day)


class Vote(NamedTuple):
    time: float
    offset: float
    votes: int
    first: float
    last: float
    ambiguous: bool


def pairs(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs (i, j) with low[i] <= j < high[i]."""
    count = high - low
    i = np.repeat(np.arange(len(count)), count)
    j = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    return i, j


def vote(time: np.ndarray, key: np.ndarray, known: np.ndarray, limit: float) -> Vote | None:
    """Find the offset that most same-tag differences within +-`limit` agree on; None if unclear."""
    width = 0.3 + DRIFT * np.ptp(time) / 2
    low, high = np.searchsorted(known, key - limit), np.searchsorted(known, key + limit)
    i, j = pairs(low, high)
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
    return Vote(float(span.mean()), offset, votes_best, span[0], span[-1], ambiguous)


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
