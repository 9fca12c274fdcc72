"""Detections on the common clock, and why some cannot be put there."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import Detections, Note
from maloc.data._time import NS
from maloc.sync._locate import SURE, TWICE, UNSURE, locate, offset_sd
from maloc.sync._prepare import seconds

if TYPE_CHECKING:
    from maloc.sync._clocks import Clocks

__all__ = ["apply"]


def apply(sync: Clocks, detections: Detections) -> Detections:
    """See `ClockSync.apply`."""
    at = locate(sync, detections.receiver, detections.time)
    known = at.status == SURE
    span = np.nan_to_num(sync.span)[np.maximum(at.clock, 0)]
    away = np.maximum(span[:, 0] - at.common, at.common - span[:, 1])
    outside = known & (away > sync.spacing)
    report = detections.report
    minutes = f"{sync.spacing / 60:.0f} min"
    for rows, level, what in (
        (at.clock < 0, "warning", "set aside: their receivers' clocks are not synchronised"),
        (
            at.status == UNSURE,
            "warning",
            "set aside: a jump of their receiver's clock lies between its sync detections "
            "before and after",
        ),
        (
            at.status == TWICE,
            "warning",
            "set aside: their receiver's clock jumped back and showed these times twice",
        ),
        (
            outside,
            "warning",
            f"set aside: more than {minutes} before the first or after the last sync "
            "detection of their receiver",
        ),
        (
            known & (away > 0) & ~outside,
            "info",
            "before the first or after the last sync detection of their receiver, clock "
            f"carried on straight by at most {minutes}",
        ),
    ):
        if n := int(rows.sum()):
            who = ", ".join(map(str, np.unique(detections.receiver[rows])))
            report = report.add(Note(level, f"{n} detections {what} ({who})", n))
    keep = known & ~outside
    offset = seconds(detections.time, sync.origin) - at.common
    # the offset, not the time, goes through a float: nanoseconds survive
    time = detections.time - np.round(offset * NS).astype(np.int64)
    sd = offset_sd(sync, np.maximum(at.clock, 0), at.segment, at.common)
    extra = {**detections.extra, "clock_sd": sd}
    kept = dataclasses.replace(detections, time=time, extra=extra, report=report)
    return kept.select(mask=keep)
