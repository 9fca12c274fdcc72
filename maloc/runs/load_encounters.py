"""From files to encounter histories: read, bring clocks together roughly, group."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError
from maloc.runs.asked import ROW, tags_to_fit, too_soon
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

if TYPE_CHECKING:
    from maloc.data import Detections, EncounterHistory, ReadReport, Receivers

__all__ = ["Encounters", "load_encounters"]

FEWEST = 3  # heard pings


class Encounters(NamedTuple):
    """What was read: one history of all tags, and how it came about."""

    history: EncounterHistory
    receivers: Receivers
    detections: Detections | None


def load_encounters(options: TrackOptions, log: Log) -> Encounters:
    """Read the input and bring it to one encounter history of all tags.

    Raises
    ------
    InputError
        If nothing in the input can be used.
    """
    with log.stage("read"):
        receivers = options.reading.receivers(options.receivers, options.crs)
        log.report(receivers.report)
        if len(receivers.names) < 2:
            raise InputError(
                f"{len(receivers.names)} receiver: who heard what tells nothing of where",
                file=options.receivers,
            )
    made = _from_toa if options.toa is not None else _from_detections
    history, detections = made(options, receivers, log)
    _say(history.report, log)
    if (n := int((history.n_heard > 0).sum())) < FEWEST:
        raise InputError(f"{n} pings were heard; a track needs at least {FEWEST}")
    if not history.heard.any(axis=0).sum() > 1:
        name = history.receivers.labels[int(history.heard.any(axis=0).argmax())]
        log.warn(f"only receiver {name} heard anything: positions are rings around it")
    return Encounters(history, receivers, detections)


def _say(report: ReadReport, log: Log) -> None:
    """Pass on a report's notes; whole seconds are no reason to warn here."""
    from maloc.readers._build import WHOLE_SECONDS

    for note in report.notes:
        if note.text == WHOLE_SECONDS:
            log.notice("times are whole seconds: enough for who heard what")
    log.report(replace(report, notes=[n for n in report.notes if n.text != WHOLE_SECONDS]))


def _from_toa(options: TrackOptions, receivers: Receivers, log: Log):
    from maloc.data import EncounterHistory
    from maloc.readers import read_toa

    assert options.toa is not None
    with log.stage("read"):
        toas = [
            read_toa(
                options.toa,
                receivers,
                ignore_columns=options.ignore_columns,
                sound_speed=1500.0,  # not used
                schedule=options.schedule(),
                tag=tag,
            )
            for tag in (dict.fromkeys(options.tags) or [None])
        ]
    return EncounterHistory.from_arrivals(toas), None


def _from_detections(options: TrackOptions, receivers: Receivers, log: Log):
    from maloc.data import encounter_history

    with log.stage("read"):
        detections = options.reading.detections(options.detections)
        _say(detections.report, log)
        if not len(detections):
            raise InputError("no detections", file=", ".join(map(str, options.detections)))
        tags = tags_to_fit(options, detections, receivers)
        false = too_soon(options, detections, tags)
    with log.stage("sync"):
        common, receivers = _one_clock(options, detections, receivers)
        common = common.select(mask=~np.isin(common.extra[ROW], list(false)))
    with log.stage("group"):
        history = encounter_history(common, receivers, tags, schedule=options.schedule())
        row = common.extra[ROW]
        known, aside = history.detection, history.set_aside
        assert known is not None
        history = history.replace(
            detection=np.where(known >= 0, row[known], -1),
            set_aside=replace(aside, detection=row[aside.detection]),
        )
        if false:
            log.notice(f"{len(false)} detections set aside: too soon after another at a receiver")
            history = _with_false(history, detections, false)
    return history, detections


def _with_false(
    history: EncounterHistory, detections: Detections, false: dict[int, str]
) -> EncounterHistory:
    """List detections that were left out before grouping among those set aside."""
    rows, aside = np.array(list(false)), history.set_aside
    listed = {
        "receiver": (aside.receiver, detections.receiver[rows]),
        "time": (aside.time, (detections.time[rows] - (history.origin or 0)) / NS),
        "detection": (aside.detection, rows),
        "why": (aside.why, np.array(list(false.values()))),
    }
    order = np.argsort(np.concatenate(listed["time"]), kind="stable")
    return history.replace(
        set_aside=replace(aside, **{k: np.concatenate(v)[order] for k, v in listed.items()})
    )


def _one_clock(options: TrackOptions, detections: Detections, receivers: Receivers):
    """Detections on about one clock, each with its row as read, and the receivers that have it."""
    numbered = replace(detections, extra={**detections.extra, ROW: np.arange(len(detections))})
    if options.sync == "none":
        return numbered, receivers
    from maloc.sync import ClockSync, rough

    if options.sync == "auto":
        return rough(numbered, receivers, reference=options.reference), receivers
    sync = ClockSync.from_netcdf(options.sync)
    names = np.array(sync.receivers.names)[sync.synced]
    return sync.apply(numbered), receivers.subset(np.isin(receivers.receiver, names))
