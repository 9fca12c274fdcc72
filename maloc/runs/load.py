"""From files to arrival times: read, synchronise, group; what cannot give a track is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError
from maloc.runs.asked import ROW, sync_tags, tags_to_fit, too_soon
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.refuse import check_usable, check_whole_seconds
from maloc.runs.speed import number_sd, sync_speed, usual_speed

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes, Detections, Receivers
    from maloc.sync import ClockSync

__all__ = ["Source", "load", "read_shore"]

ROUGHLY = 1.0  # s; how well clocks agree that were brought together by the animals' own pings


class Source(NamedTuple):
    """What was read: one `ArrivalTimes` a tag, and how it came about."""

    toas: list[ArrivalTimes]
    receivers: Receivers
    detections: Detections | None
    sync: ClockSync | None
    skipped: dict[str, str]  # tags that cannot be positioned, and why
    beacons: tuple[ArrivalTimes, ...] = ()  # sync tags' pings, with --sync beacons


def load(options: TrackOptions, log: Log) -> Source:
    """Read the input and bring it to arrival times, one matrix a tag.

    Raises
    ------
    InputError
        If anything in the input makes positions impossible.
    """
    with log.stage("read"):
        receivers = options.reading.receivers(options.receivers, options.crs, options.receiver_sd)
        log.report(receivers.report)
        if len(receivers.names) < 2:
            raise InputError(
                f"{len(receivers.names)} receiver: positions need at least 3",
                file=options.receivers,
            )
    if options.toa is not None:
        return _load_toa(options, receivers, log)
    return _load_detections(options, receivers, log)


def read_shore(options: TrackOptions, receivers: Receivers, log: Log) -> tuple:
    """One `maloc.habitat.Water` where --water names a file, else nothing."""
    if options.water is None:
        return ()
    from maloc.world.habitat import read_water

    with log.stage("water"):
        return (read_water(options.water, receivers),)


def _load_toa(options: TrackOptions, receivers: Receivers, log: Log) -> Source:
    from maloc.readers import read_toa

    assert options.toa is not None
    with log.stage("read"):
        given = options.speed()
        toas = [
            read_toa(
                options.toa,
                receivers,
                ignore_columns=options.ignore_columns,
                sound_speed=usual_speed(given),
                schedule=options.schedule(),
                tag=tag,
            )
            for tag in _tags_of(options.toa, options.tags)
        ]
        toas = [_as_sure(toa, options) for toa in toas]
        for toa in toas:
            log.report(toa.report)
            check_usable(toa, options.toa)
    return Source(toas, receivers, None, None, {})


def _as_sure(toa: ArrivalTimes, options: TrackOptions) -> ArrivalTimes:
    """Arrival times of a matrix, their sound speed as sure as was said, or as a number is."""
    given, sd = options.speed(), options.speed_sd()
    if options.sound_speed in ("estimated", "drifting") or isinstance(given, Path):
        return toa
    if given is None and toa.sound_speed_sd is not None:  # there was no column of it
        if sd is not None:
            raise InputError("--sound-speed-sd needs --sound-speed C, or a column sound_speed")
        return toa
    return toa.replace(sound_speed_sd=number_sd(sd))


def _tags_of(toa: Path, asked: tuple[str, ...]) -> list[str | None]:
    """Tags of a matrix to fit: those named, or all it has; None where it names none."""
    from maloc.readers.toa import tags_of

    if "all" not in asked:
        return list(dict.fromkeys(asked)) or [None]
    return list(tags_of(toa)) or [None]


def _load_detections(options: TrackOptions, receivers: Receivers, log: Log) -> Source:
    from maloc.data import toa_matrix

    with log.stage("read"):
        detections = options.reading.detections(options.detections)
        log.report(detections.report)
        if not len(detections):
            raise InputError("no detections", file=", ".join(map(str, options.detections)))
        tags = tags_to_fit(options, detections, receivers)
        for tag in tags:
            check_whole_seconds(detections.select(tag), options.detections)
        false = too_soon(options, detections, tags)
        numbered = replace(detections, extra={**detections.extra, ROW: np.arange(len(detections))})
    with log.stage("sync"):
        sync = _sync(options, detections, receivers, log)
        place = receivers if sync is None else _placed(sync)
        common = numbered if sync is None else sync.apply(numbered)
        if options.sync == "beacons":
            common = _roughly(numbered, receivers, options)
        log.report(common.report)
        common = common.select(mask=~np.isin(common.extra[ROW], list(false)))
        if false:
            log.notice(f"{len(false)} detections set aside: too soon after another at a receiver")
    given = options.speed()
    speed = usual_speed(given)
    sure = None if isinstance(given, Path) else number_sd(options.speed_sd())
    if sync is not None and (speed is None or (options.sync == "auto" and speed == given)):
        speed, sure = sync.sound_speed, sync.sound_speed_sd or None
    toas, skipped = [], {}
    known: dict[str, Any] = {"sound_speed": speed}
    if options.sync == "beacons":
        known["tolerance"] = ROUGHLY
    grouped = partial(toa_matrix, common, place, **known)
    with log.stage("group"):
        heard = sync_tags(detections, receivers) if options.sync == "beacons" else ()
        beacons = tuple(grouped(tag) for tag in sorted(heard))
        for tag in tags:
            try:
                if tag not in common.tags:
                    raise InputError(f"tag {tag}: no detection is left on the common clock")
                toa = grouped(tag, schedule=options.schedule())
                toa = _with_rows(toa, common, detections, receivers, false)
                if speed is not None:
                    toa = toa.replace(sound_speed_sd=sure)
                if sync is not None:
                    toa = toa.replace(clock_sd=sync.clock_sd(toa))
                check_usable(toa)
            except InputError as problem:
                if (options.tags and "all" not in options.tags) or len(tags) == 1:
                    raise
                skipped[tag] = str(problem)
                log.warn(f"{problem}; skipped")
                continue
            log.report(toa.report)
            toas.append(toa)
    if not toas:
        raise InputError(f"none of {len(tags)} tags can be positioned", mend="name one with --tag")
    return Source(toas, receivers, detections, sync, skipped, beacons)


def _placed(sync: ClockSync) -> Receivers:
    """Receivers where the synchronisation puts them, as sure as it is of their places."""
    sd = np.sqrt(np.mean(sync.position_sd**2, axis=1))
    return replace(sync.receivers, position_sd=sd)


def _with_rows(
    toa: ArrivalTimes,
    common: Detections,
    detections: Detections,
    receivers: Receivers,
    false: dict[int, str],
) -> ArrivalTimes:
    """Number entries by the rows of the detections as read, and list those that sync set aside."""
    from maloc.data import SetAside

    row = common.extra[ROW]
    assert toa.detection is not None
    number = np.where(toa.detection >= 0, row[toa.detection], -1)
    aside = toa.set_aside
    lost = np.setdiff1d(np.flatnonzero(detections.tag == toa.tag), row[common.tag == toa.tag])
    why = [
        false.get(int(i))
        or (
            "clock not synchronised"
            if detections.receiver[i] in receivers.names
            else f"receiver {detections.receiver[i]} is not in the table"
        )
        for i in lost
    ]
    time = (detections.time[lost] - (toa.origin or 0)) / NS
    merged = (
        np.concatenate([aside.receiver, detections.receiver[lost]]),
        np.concatenate([aside.time, time]),
        np.concatenate([row[aside.detection], lost]),
        np.concatenate([aside.why, np.asarray(why, dtype=str)]),
    )
    order = np.argsort(merged[1], kind="stable")
    return toa.replace(detection=number, set_aside=SetAside(*(m[order] for m in merged)))


def _roughly(detections: Detections, receivers: Receivers, options: TrackOptions) -> Detections:
    """Clocks near enough to tell pings apart; sync tags' pings do the rest, ping by ping."""
    from maloc.sync import rough

    if not sync_tags(detections, receivers):
        raise InputError(
            "--sync beacons needs sync tags, and none of the receivers' is in the detections",
            mend="name them in the table of receivers, column sync_tag",
        )
    return rough(detections, receivers, reference=options.reference)


def _sync(
    options: TrackOptions, detections: Detections, receivers: Receivers, log: Log
) -> ClockSync | None:
    if options.sync in ("none", "beacons"):
        return None
    if options.sync != "auto":
        from maloc.sync import ClockSync

        return ClockSync.from_netcdf(options.sync)
    if not sync_tags(detections, receivers):
        log.notice("no sync tags: times taken as already on one clock")
        return None
    from maloc.sync import fit

    how: dict[str, Any] = {"reference": options.reference, "progress": not log.quiet}
    how |= sync_speed(options.speed(), options.speed_sd(), receivers)
    if receivers.position_sd is not None:
        how["free_positions"] = receivers.position_sd
    sync = fit(detections, receivers, **how)
    for note in sync.notes:
        (log.notice if note.level == "info" else log.warn)(note.text)
    log.notice(repr(sync))
    return sync
