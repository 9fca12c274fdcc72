"""The gaps of an encounter history in which pings may have been missed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.arrivals import Schedule
from maloc.data.encounters import EncounterHistory

__all__ = ["Silence", "find_gaps", "most_missed", "widened"]


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


def widened(history: EncounterHistory) -> Schedule:
    """The schedule with the slack of the times from ping to ping added to its limits."""
    s, slack = history.schedule, history.slack
    if s.kind == "random":
        return Schedule("random", max(s.lo - slack, 0.1 * s.lo), s.hi + slack)
    if s.kind == "stable":
        return Schedule("stable", s.lo, float(np.hypot(s.hi, slack)))
    return s


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
    schedule = widened(history)
    if schedule.kind == "poisson":
        return gap.duration / schedule.lo
    shortest = max(schedule.shortest, 0.1 * schedule.lo)
    return np.floor(gap.duration / shortest) - (gap.kind == "inside") + (gap.kind == "before")
