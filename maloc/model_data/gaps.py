"""The gaps of an encounter history in which pings may have been missed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.encounters import EncounterHistory
from maloc.schedule.intervals import IntervalLaw, interval_law

__all__ = ["Silence", "find_gaps", "law_of", "most_missed"]


class Silence(NamedTuple):
    """One gap of one tag.

    Attributes
    ----------
    kind : str
        "before" the first ping, "inside" between two, "after" the last.
    tag : int
    before, after : int
        Rows of the pings around it, -1 where there is none.
    start, duration : float
        Seconds from the origin, seconds.
    first_at_start : bool
        The tag was switched on at `start`.
    """

    kind: str
    tag: int
    before: int
    after: int
    start: float
    duration: float
    first_at_start: bool = False


def law_of(history: EncounterHistory) -> IntervalLaw:
    """Law of the burst interval, its edges widened by the slack of the pings' times."""
    return interval_law(history.schedule, slack=history.slack)


def find_gaps(history: EncounterHistory) -> list[Silence]:
    """Every gap, tag after tag in order of time; leads are cut to `history.lead` intervals."""
    if not history.summed:
        return []
    out = []
    longest = history.lead * history.schedule.mean
    for tag, (i, j) in enumerate(zip(history.first_rows, history.last_rows, strict=True)):
        first, last = float(history.time[i]), float(history.time[j])
        whole = first - history.start[tag]  # NaN, and so no lead, where the start is not known
        lead = min(whole, longest)
        if lead > 0:
            new = history.first_at_start and lead == whole
            out.append(Silence("before", tag, -1, int(i), first - lead, lead, new))
        for k in range(i, j):
            start = float(history.time[k])
            out.append(Silence("inside", tag, k, k + 1, start, float(history.time[k + 1]) - start))
        lead = min(history.end[tag] - last, longest)
        if lead > 0:
            out.append(Silence("after", tag, int(j), -1, last, lead))
    return out


def most_missed(history: EncounterHistory, gap: Silence) -> float:
    """Most pings that a gap can hold (Poisson: the mean number, which serves as the bound)."""
    law = law_of(history)
    if not law.lo > 0:
        return gap.duration / law.mean
    return np.floor(gap.duration / law.lo) - (gap.kind == "inside") + (gap.kind == "before")
