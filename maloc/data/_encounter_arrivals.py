"""Arrival times read as encounters: who heard each ping, the times being forgotten."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from maloc.data._encounter_pings import travel_slack
from maloc.data._time import NS
from maloc.data.arrivals import ArrivalTimes, SetAside
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

__all__ = ["history_of"]


def history_of(
    toas: Sequence[ArrivalTimes], known: bool | None, fields: dict[str, Any]
) -> dict[str, Any]:
    """Fields of what `EncounterHistory.from_arrivals` returns."""
    heard = [t for t in toas if t.heard.any()]
    if not heard:
        raise InputError("no ping was heard")
    one = heard[0].receivers
    for toa in heard[1:]:
        r = toa.receivers
        if r.labels != one.labels or not np.array_equal(r.xy, one.xy):
            raise InputError(f"tag {toa.tag}: its receivers are not those of tag {heard[0].tag}")
    if len({t.origin is None for t in heard}) > 1:
        raise InputError("some arrival times have a date and some have none")
    zero = None if heard[0].origin is None else min(t.origin or 0 for t in heard)
    later = [0.0 if zero is None else ((t.origin or 0) - zero) / NS for t in heard]
    schedules = {str(astuple(t.schedule)): t.schedule for t in heard}
    if "schedule" not in fields and len(schedules) > 1:
        raise InputError("the tags have different schedules", mend="give schedule=")
    fields = {"schedule": heard[0].schedule, **fields}
    if known is None:
        known = any((t.n_heard == 0).any() for t in heard)
    silent = [Note("warning", f"tag {t.tag} was never heard: left out") for t in toas]
    silent = [n for n, t in zip(silent, toas, strict=True) if not t.heard.any()]
    detection = None
    if all(t.detection is not None for t in heard):
        detection = np.concatenate([np.asarray(t.detection) for t in heard])
    who = np.concatenate([t.heard for t in heard])
    parts = [t.set_aside for t in heard]
    aside = SetAside(
        np.concatenate([p.receiver for p in parts]),
        np.concatenate([p.time + s for p, s in zip(parts, later, strict=True)]),
        np.concatenate([p.detection for p in parts]),
        np.concatenate([p.why for p in parts]),
    )
    return {
        "time": np.concatenate([t.first + s for t, s in zip(heard, later, strict=True)]),
        "tag": np.repeat(np.arange(len(heard)), [len(t) for t in heard]),
        "heard": who,
        "receivers": one,
        "tags": tuple(t.tag or f"track {i + 1}" for i, t in enumerate(heard)),
        "known": known,
        "origin": zero,
        "detection": detection,
        "set_aside": aside,
        "report": ReadReport.merge(t.report for t in heard).add(*silent),
        "slack": travel_slack(one.xy[who.any(axis=0)]),
        **fields,
    }
