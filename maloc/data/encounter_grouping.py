"""Detections to encounter histories: one tag's detections within a window are one ping.

Nothing here needs synchronised clocks or fractions of a second, only that clocks differ by less
than half the shortest burst interval; `maloc.sync.fit` or `maloc.sync.rough` bring them there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from maloc.data._encounter_pings import (
    all_aside,
    beyond,
    check_clocks,
    group,
    match,
    matrix,
    slack_of,
    window_width,
)
from maloc.data._sorting import Sorting
from maloc.data._time import NS, OPEN_END, OPEN_START
from maloc.data.arrivals import Schedule
from maloc.data.detections import Detections
from maloc.data.encounters import EncounterHistory
from maloc.data.receivers import Receivers
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

__all__ = ["encounter_history"]

ECHO_S = 0.5  # a second detection within this time at one receiver is the same ping
ECHO_WHOLE_S = 1.5  # the same, where times are whole seconds


def encounter_history(
    detections: Detections,
    receivers: Receivers,
    tags: Sequence[object] | object = None,
    *,
    schedule: Schedule | None = None,
    pings: Mapping[str, Any] | None = None,
    window: float | None = None,
    slack: float | None = None,
    start: Any = None,
    end: Any = None,
    origin: int | None = None,
    **fields: Any,
) -> EncounterHistory:
    """Build the encounter history of some tags from raw detections.

    Detections of one tag within `window` seconds are one ping, at the median of their times. A
    receiver hears a ping once: echoes and doubles are set aside, as are detections by receivers
    that are not in the table or outside their deployments, and lone detections nearer to a ping
    that others heard too than the schedule allows.

    Parameters
    ----------
    detections : Detections
        Clocks need not be synchronised, but must agree to within the window; whole seconds will
        do.
    receivers : Receivers
        The array. Every deployment listened from its start to its end, heard or not.
    tags : sequence of str, or str, optional
        Full ids or unique endings; all but the receivers' sync tags if not given. Tags without a
        detection are left out and reported.
    schedule : Schedule, optional
        Burst interval of the tags. Random, stable or poisson: pings between two heard ones may
        have been missed, and are summed over.
    pings : mapping of str to array, optional
        Every time that a tag sent, ns since 1970 UTC or datetime64, on the receivers' clocks:
        detections that fit none are set aside, and pings without any are rows that nobody heard.
    window : float, optional
        Seconds; .4 of the shortest interval of the schedule, else .4 of the shortest time between
        two detections of a tag at one receiver, up to 10 s.
    slack : float, optional
        How far the time from one ping to the next may be off, s; by default what rounding, travel
        times and the spread of the detections of one ping suggest.
    start, end : time, mapping of str to time, or "deployed", optional
        When each tag was on and under study: ns since 1970, datetime64 or ISO text in UTC.
        "deployed": from the first start to the last end of a deployment. Where not given, silence
        before the first and after the last heard ping says nothing: tags are switched on, leave
        and die at times of their own. Give them where a tag is known to have been on, and silence
        there says that it was out of earshot.
    origin : int, optional
        ns since 1970 UTC of second 0; the whole second before the first detection.
    **fields
        Other fields of `EncounterHistory`: first_at_start, low, high, edge, covariates, lead.

    Returns
    -------
    EncounterHistory

    Raises
    ------
    InputError
        If no tag was heard, the window does not fit the schedule, or clocks differ by more.
    """
    schedule = schedule or Schedule()
    if not len(detections):
        raise InputError("no detections")
    if not len(receivers):
        raise InputError("no receivers in the table")
    names, notes = _tags(detections, receivers, tags if pings is None or tags else list(pings))
    ours = np.isin(detections.tag, names)
    zero = int(detections.time[ours].min() // NS * NS) if origin is None else int(origin)
    works = [_placed(detections, receivers, name, zero) for name in names]
    width, why = window_width(works, schedule.shortest, window)
    notes.append(
        Note("info", f"detections of a tag within {width:.3g} s are one ping ({why})", len(names))
    )
    sent = None if pings is None else {detections.find_tag(k): v for k, v in pings.items()}
    good, times = [], []
    for work in works:
        time = np.empty(0)
        if len(work.time) and sent is not None:
            if work.tag not in sent:
                raise InputError(f"no times of pings were given for tag {work.tag}")
            time = match(work, sent[work.tag], width, zero)
        elif len(work.time):
            time = group(work, width, schedule.shortest)
        if len(work.time):
            good.append(work)
            times.append(time)
        else:
            text = f"tag {work.tag}: no detection by a receiver of the table while deployed"
            notes.append(Note("warning", text))
    if not good:
        raise InputError(
            "no tag was heard by a receiver of the table while deployed",
            file=", ".join(detections.report.files) or None,
            mend="compare the receivers' names in both files",
        )
    if sent is None and schedule.shortest > 0:
        notes += check_clocks(good, times, schedule.shortest, width)
    loose = slack_of(good) if slack is None else float(slack)
    if sent is None and schedule.kind == "random":
        notes += beyond(times, schedule, loose)
    keep = tuple(work.tag for work in good)
    heard, source = matrix(good, times)
    return EncounterHistory(
        np.concatenate(times),
        np.repeat(np.arange(len(good)), [len(t) for t in times]),
        heard,
        receivers,
        keep,
        schedule,
        known=sent is not None,
        start=_span(start, keep, receivers, zero, "start"),
        end=_span(end, keep, receivers, zero, "end"),
        slack=loose,
        origin=zero,
        detection=source,
        set_aside=all_aside(works),
        report=_report(detections, int(ours.sum()), works, notes),
        **fields,
    )


def _placed(detections: Detections, receivers: Receivers, tag: str, zero: int) -> Sorting:
    """One tag's detections at their deployments, without echoes."""
    rows = np.flatnonzero(detections.tag == tag)
    work = Sorting(detections, receivers, tag, rows, (detections.time[rows] - zero) / NS)
    work.place()
    whole = bool((detections.time[rows] % NS == 0).all())
    work.drop_echoes(ECHO_WHOLE_S if whole else ECHO_S)
    return work


def _report(
    detections: Detections, rows: int, works: list[Sorting], notes: list[Note]
) -> ReadReport:
    """Notes of reading and grouping; those that several tags share are counted together."""
    total: dict[tuple[str, str], int] = {}
    for note in (n for work in works for n in work.notes):
        key = note.level, note.text.split(" ", 1)[1]
        total[key] = total.get(key, 0) + note.count
    joined = [Note(level, f"{n} {text}", n) for (level, text), n in total.items()]
    old = detections.report
    return ReadReport(old.format, old.files, rows, old.notes).add(*joined, *notes)


def _tags(detections: Detections, receivers: Receivers, tags: Any) -> tuple[list[str], list[Note]]:
    """Full ids of the tags asked for, and notes on those that were not heard."""
    notes: list[Note] = []
    if tags is None:
        sync = {str(s) for s in receivers.sync_tag if s}
        names = [t for t in detections.tags if not any(f"-{t}".endswith(f"-{s}") for s in sync)]
        if left := len(detections.tags) - len(names):
            notes.append(Note("info", f"{left} sync tags left out", left))
        if not names:
            raise InputError("all tags in the detections are sync tags", mend="name one")
        return names, notes
    names = []
    for wanted in [tags] if isinstance(tags, str | int) else list(tags):
        try:
            names.append(detections.find_tag(wanted))
        except InputError as problem:
            if "ambiguous" in problem.problem:
                raise
            notes.append(Note("warning", f"tag {wanted} was never heard: left out"))
    if not names:
        raise InputError(
            f"none of the {len(notes)} tags asked for is among the detections",
            mend=f"tags there: {', '.join(detections.tags[:20])}",
        )
    return list(dict.fromkeys(names)), notes


def _span(
    value: Any, tags: tuple[str, ...], receivers: Receivers, zero: int, name: str
) -> np.ndarray:
    """Start or end of each tag (N,), s from the origin; NaN where not known."""
    out = np.full(len(tags), np.nan)
    if value is None:
        return out
    if isinstance(value, str) and value == "deployed":
        times, opened = (
            (receivers.start, OPEN_START) if name == "start" else (receivers.end, OPEN_END)
        )
        if (times == opened).any():
            raise InputError(
                f"{name}='deployed', but the receivers table does not say when all deployments "
                f"{'began' if name == 'start' else 'ended'}"
            )
        out[:] = (int(times.min() if name == "start" else times.max()) - zero) / NS
        return out
    for i, tag in enumerate(tags):
        given = value.get(tag) if isinstance(value, Mapping) else value
        if given is not None:
            out[i] = (_ns(given, name) - zero) / NS
    return out


def _ns(value: Any, name: str) -> int:
    """A time in ns since 1970 UTC."""
    if isinstance(value, int | np.integer):
        return int(value)
    try:
        text = value.removesuffix("Z").replace(" ", "T") if isinstance(value, str) else value
        return int(np.datetime64(text, "ns").astype(np.int64))
    except (ValueError, TypeError, AttributeError):
        raise InputError(
            f"{name} {value!r} is not a time", mend="give ISO text in UTC, or ns since 1970"
        ) from None
