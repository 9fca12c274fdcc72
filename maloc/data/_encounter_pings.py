"""Who heard which ping: windows in time, known pings, doubles; one tag at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc.data._sorting import Sorting
from maloc.data._time import NS
from maloc.data.arrivals import DEFAULT_SOUND_SPEED, Schedule, SetAside
from maloc.data.report import Note
from maloc.errors import InputError

__all__ = [
    "all_aside",
    "beyond",
    "group",
    "match",
    "matrix",
    "check_clocks",
    "slack_of",
    "travel_slack",
    "window_width",
]

SHARE = 0.4  # of the shortest interval: two pings never share a window, with room for clocks
WIDEST = 10.0  # s; window where nothing is known of the schedule
RANGE = 1500.0  # m; few tags are heard further away
OFTEN = 0.05  # more times from ping to ping than this share outside the limits: worth a warning
TOO_CLOSE = 0.2  # more pings than this share nearer than an interval: clocks are apart
MEND = "bring the clocks together first: maloc.sync.fit, or maloc.sync.rough without sync tags"


def window_width(works: list[Sorting], shortest: float, window: float | None) -> tuple[float, str]:
    """Width of a ping (s) and where it is from."""
    if window is not None:
        if not (np.isfinite(window) and window >= 0):
            raise InputError(f"window {window:g} s is not a number from 0")
        if shortest > 0 and window >= shortest / 2:
            raise InputError(
                f"a window of {window:g} s is not below half the shortest interval, {shortest:g} s"
            )
        return float(window), "as asked"
    if shortest > 0:
        return SHARE * shortest, f"{SHARE:g} of the shortest interval"
    steps = []
    for work in works:
        order = np.lexsort((work.time, work.column))
        gap, same = np.diff(work.time[order]), np.diff(work.column[order]) == 0
        steps.append(gap[same])
    found = np.concatenate([*steps, np.empty(0)])
    if not len(found):
        return WIDEST, "no receiver heard a tag twice"
    # a few false detections between two pings shall not set it
    least = float(np.quantile(found, 0.02, method="lower"))
    return min(SHARE * least, WIDEST), f"shortest time between pings at one receiver {least:.3g} s"


def group(work: Sorting, width: float, shortest: float) -> np.ndarray:
    """Number the pings of one tag, set aside what fits none, and return their times (P,)."""
    work.ping = np.full(len(work.time), -1, np.int64)
    at = count = 0
    while at < len(work.time):
        until = int(np.searchsorted(work.time, work.time[at] + width, side="right"))
        work.ping[at:until] = count
        at, count = until, count + 1
    _drop_doubles(work)
    if shortest > 0:
        work.drop_impossible(np.zeros((len(work.receivers),) * 2), shortest, width)
    return _medians(work)


def match(work: Sorting, sent: Any, width: float, zero: int) -> np.ndarray:
    """Give each detection its known ping, set aside what fits none; return all times (P,)."""
    raw = np.asarray(sent)
    ns = raw.astype("datetime64[ns]").astype(np.int64) if raw.dtype.kind == "M" else raw
    time = np.sort((ns.astype(np.int64) - zero) / NS)
    if not len(time):
        raise InputError(f"no times of pings were given for tag {work.tag}")
    right = np.clip(np.searchsorted(time, work.time), 1, max(len(time) - 1, 1))
    right = np.minimum(right, len(time) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(time[right] - work.time) < np.abs(time[left] - work.time)
    work.ping = np.where(nearer, right, left)
    far = np.abs(time[work.ping] - work.time) > width
    why = [f"no ping was sent within {width:.3g} s"] * int(far.sum())
    work.drop(far, why, "detections at times when no ping was sent", "warning")
    _drop_doubles(work)
    return time


def _drop_doubles(work: Sorting) -> None:
    key = work.ping * len(work.receivers) + work.column
    gone = np.ones(len(key), bool)
    gone[np.unique(key, return_index=True)[1]] = False
    why = ["second of one ping at one receiver"] * int(gone.sum())
    work.drop(gone, why, "detections of a ping that the receiver had heard already")


def _medians(work: Sorting) -> np.ndarray:
    """Median time of each ping's detections, (P,); pings are renumbered without holes."""
    work.ping = np.unique(work.ping, return_inverse=True)[1]
    size = np.bincount(work.ping)
    start = np.cumsum(size) - size
    order = np.lexsort((work.time, work.ping))
    time = work.time[order]
    return (time[start + (size - 1) // 2] + time[start + size // 2]) / 2


def check_clocks(
    works: list[Sorting], times: list[np.ndarray], shortest: float, width: float
) -> list[Note]:
    """Refuse clocks so far apart that one ping becomes several; warn where a few do.

    Raises
    ------
    InputError
        If more than a fifth of the times from ping to ping are too short.
    """
    steps = np.concatenate([np.diff(t) for t in times])
    alone = sum(w.startswith("alone") for work in works for a in work.aside for w in a[2])
    close, total = int((steps < shortest - width).sum()) + alone, len(steps) + alone
    if close < 3 or close <= OFTEN * total:
        return []
    text = (
        f"{close} of {total} times from ping to ping are shorter than the shortest interval, "
        f"{shortest:g} s: the clocks look unsynchronised, or the interval is wrong"
    )
    if total >= 10 and close > TOO_CLOSE * total:
        raise InputError(text, mend=MEND)
    return [Note("warning", f"{text}; {MEND}", close)]


def beyond(times: list[np.ndarray], schedule: Schedule, slack: float) -> list[Note]:
    """Note on times from ping to ping that lie just above the longest interval, if there are many.

    Makers often state the delay between pings, which leaves out the ping's own length.
    """
    steps = np.concatenate([np.diff(t) for t in times])
    steps = steps[(steps > schedule.lo - slack) & (steps < 1.12 * schedule.hi + slack)]
    above = int((steps > schedule.hi + slack).sum())
    if above < 3 or above < OFTEN * len(steps):
        return []
    low, high = float(np.quantile(steps, 0.01)), float(steps.max())
    text = (
        f"{above} of {len(steps)} times from ping to ping are a little above the longest interval, "
        f"{schedule.hi:g} s; they run from {low:.3g} to {high:.3g} s: is the interval stated from "
        "the end of a ping to the start of the next?"
    )
    return [Note("warning", text, above)]


def travel_slack(xy: np.ndarray) -> float:
    """How far travel time from the tag may differ between two pings, s; receivers at (M, 2) m."""
    return min(float(np.hypot(*np.ptp(xy, axis=0))), RANGE) / DEFAULT_SOUND_SPEED


def slack_of(works: list[Sorting]) -> float:
    """How far a time from ping to ping may be off: rounding, travel, clocks (s)."""
    rows = np.concatenate([w.rows for w in works])
    rounding = 1.0 if (works[0].detections.time[rows] % NS == 0).all() else 0.0
    column = np.unique(np.concatenate([w.column for w in works]))
    travel = travel_slack(works[0].receivers.xy[column])
    spreads = []
    for work in works:
        size = np.bincount(work.ping)
        first = np.full(len(size), np.inf)
        last = np.full(len(size), -np.inf)
        np.minimum.at(first, work.ping, work.time)
        np.maximum.at(last, work.ping, work.time)
        spreads.append((last - first)[size > 1])
    spread = np.concatenate(spreads)
    clocks = float(np.quantile(spread, 0.9)) if len(spread) else 0.0
    return max(rounding + travel, clocks)


def matrix(works: list[Sorting], times: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Who heard what (P, R), and the row of each detection, -1 for none."""
    heard, source = [], []
    for work, time in zip(works, times, strict=True):
        mine = np.full((len(time), len(work.receivers)), -1, np.int64)
        mine[work.ping, work.column] = work.rows
        source.append(mine)
        heard.append(mine >= 0)
    return np.concatenate(heard), np.concatenate(source)


def all_aside(works: list[Sorting]) -> SetAside:
    """Everything that was set aside, of all tags, in time order."""
    parts = [w.set_aside() for w in works]
    fields = ("receiver", "time", "detection", "why")
    joined = [np.concatenate([getattr(p, f) for p in parts]) for f in fields]
    order = np.argsort(joined[1], kind="stable")
    return SetAside(*(values[order] for values in joined))
