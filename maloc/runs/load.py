"""From files to arrival times: read, synchronise, group; what cannot give a track is refused."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError
from maloc.runs.depth import check_depth
from maloc.runs.log import Log
from maloc.runs.reading import Reading, too_soon
from maloc.runs.refuse import check_usable, check_whole_seconds

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes, Detections, Receivers, Schedule
    from maloc.sync import ClockSync

__all__ = ["Source", "TrackOptions", "load", "speed_of_water", "sync_tags", "tags_to_fit"]

ROW = "row in the detections as read"  # extra column that survives the synchronisation
ROUGHLY = 1.0  # s; how well clocks agree that were brought together by the animals' own pings


@dataclass(frozen=True)
class TrackOptions:
    """Everything that `maloc track` was asked for; written into summary.json."""

    detections: tuple[Path, ...] = ()
    toa: Path | None = None
    receivers: Path = Path()
    reading: Reading = Reading()
    tags: tuple[str, ...] = ()
    sync: str = "auto"
    reference: str | None = None
    model: str = "toa"
    movement: str = "ctcrw"
    detection: str = "halfnormal"
    loss: bool = True
    dispersion: bool = False
    receiver_effects: bool = False
    error: str = "ddetect"
    interval: tuple[float, float] | None = None
    interval_stable: tuple[float, float] | None = None
    schedule_file: Path | None = None
    water: Path | None = None
    depth: str = "flat"
    depth_sd: float = 1.0
    bottom: str | None = None
    sound_speed: str | None = None
    method: str = "laplace"
    start: str = "annealed"
    ignore_columns: tuple[str, ...] = ()
    crs: str | None = None
    draws: int = 1000
    chains: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if bool(self.detections) == (self.toa is not None):
            raise InputError(
                "no input" if self.toa is None else "both files of detections and --toa were given",
                mend="give either files of detections or --toa TOA",
            )
        given = [self.interval, self.interval_stable, self.schedule_file]
        if sum(g is not None for g in given) > 1:
            raise InputError("--interval, --interval-stable and --schedule exclude one another")
        if self.schedule_file is not None and self.model != "joint":
            raise InputError("--schedule goes with --model joint only")
        if self.water is not None and self.model == "detections":
            raise InputError("--water goes with --model toa or joint")
        if self.draws < 1:
            raise InputError(f"--draws must be at least 1, got {self.draws}")
        if self.chains < 2:
            raise InputError("--chains must be 2 or more: one chain cannot show it has converged")
        if self.toa is not None and (self.sync not in ("auto", "none") or self.reference):
            raise InputError("--toa is on one clock already", mend="leave --sync out")
        if self.model == "detections" and self.sound_speed is not None:
            raise InputError("--sound-speed says nothing to --model detections; leave it out")
        if self.sound_speed == "drifting" and self.model != "joint":
            raise InputError("--sound-speed drifting goes with --model joint")
        if self.method == "svi" and self.model == "toa":
            raise InputError("--method svi goes with --model detections or joint")
        if self.start == "pmc" and self.model == "detections":
            raise InputError("--start pmc needs arrival times: not with --model detections")
        if self.toa is not None and self.reading != Reading():
            raise InputError(
                "--format, --tz, --clock and --tag-table go with detections, not --toa"
            )
        if self.detections and self.ignore_columns:
            raise InputError("--ignore-columns goes with --toa only")
        check_depth(self)
        self.schedule()
        self.speed()

    @property
    def positions(self) -> str | None:
        """What a fit starts from besides the middle of the array."""
        return "pmc" if self.start == "pmc" else None

    def schedule(self) -> Schedule:
        """What is known of the burst interval."""
        from maloc.data import Schedule

        if self.interval:
            return Schedule("random", *self.interval)
        if self.interval_stable:
            return Schedule("stable", *self.interval_stable)
        if self.schedule_file is not None:
            from maloc.runs.joint import read_sequence

            sequence = read_sequence(self.schedule_file)
            return Schedule("random", float(sequence.min()), float(sequence.max()))
        return Schedule()

    def speed(self) -> float | Path | None:
        """The sound speed given, m/s, or its table; None where it is to be estimated."""
        estimated = self.sound_speed in ("estimated", "drifting")
        return None if estimated else speed_of_water(self.sound_speed)

    def record(self) -> dict[str, Any]:
        """The options as plain values."""
        return {k: v for k, v in asdict(self).items()}


class Source(NamedTuple):
    """What was read: one `ArrivalTimes` a tag, and how it came about."""

    toas: list[ArrivalTimes]
    receivers: Receivers
    detections: Detections | None
    sync: ClockSync | None
    skipped: dict[str, str]  # tags that cannot be positioned, and why
    beacons: tuple[ArrivalTimes, ...] = ()  # sync tags' pings, with --sync beacons


def speed_of_water(text: str | None) -> float | Path | None:
    """What --sound-speed gives: m/s, or a table of the water's state."""
    if text is None:
        return None
    if Path(text).is_file():
        return Path(text)
    try:
        speed = float(text)
    except ValueError:
        speed = nan
    if not 1300.0 <= speed <= 1700.0:
        raise InputError(
            f"--sound-speed {text} is no file, and no speed of sound in water, 1300 to 1700 m/s",
            mend="give m/s or a table of the water (see --help for words)",
        )
    return speed


def load(options: TrackOptions, log: Log) -> Source:
    """Read the input and bring it to arrival times, one matrix a tag.

    Raises
    ------
    InputError
        If anything in the input makes positions impossible.
    """
    with log.stage("read"):
        receivers = options.reading.receivers(options.receivers, options.crs)
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
    from maloc.world.medium import with_sound_speed

    assert options.toa is not None
    with log.stage("read"):
        given = options.speed()
        toas = [
            read_toa(
                options.toa,
                receivers,
                ignore_columns=options.ignore_columns,
                sound_speed=None if isinstance(given, Path) else given,
                schedule=options.schedule(),
                tag=tag,
            )
            for tag in _tags_of(options.toa, options.tags)
        ]
        if isinstance(given, Path):
            toas = [with_sound_speed(toa, given) for toa in toas]
        for toa in toas:
            log.report(toa.report)
            check_usable(toa, options.toa)
    return Source(toas, receivers, None, None, {})


def _tags_of(toa: Path, asked: tuple[str, ...]) -> list[str | None]:
    """Tags of a matrix to fit: those named, or all it has; None where it names none."""
    from maloc.readers.toa import tags_of

    if "all" not in asked:
        return list(dict.fromkeys(asked)) or [None]
    return list(tags_of(toa)) or [None]


def _load_detections(options: TrackOptions, receivers: Receivers, log: Log) -> Source:
    from maloc.data import toa_matrix
    from maloc.world.medium import with_sound_speed

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
        place = receivers if sync is None else sync.receivers
        common = numbered if sync is None else sync.apply(numbered)
        if options.sync == "beacons":
            common = _roughly(numbered, receivers, options)
        log.report(common.report)
        common = common.select(mask=~np.isin(common.extra[ROW], list(false)))
        if false:
            log.notice(f"{len(false)} detections set aside: too soon after another at a receiver")
    given = options.speed()
    speed = None if isinstance(given, Path) else given
    if speed is None and sync is not None:
        speed = sync.sound_speed
    sure = None if sync is None or sync.sound_speed != speed else sync.sound_speed_sd or None
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
                if sure is not None:
                    toa = toa.replace(sound_speed_sd=sure)
                if isinstance(given, Path):
                    toa = with_sound_speed(toa, given)
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


def tags_to_fit(options: TrackOptions, detections: Detections, receivers: Receivers) -> list[str]:
    """Full ids of the tags to fit: those named, or all that are not sync tags."""
    if options.tags and "all" not in options.tags:
        return list(dict.fromkeys(detections.find_tag(t) for t in options.tags))
    sync = sync_tags(detections, receivers)
    tags = [t for t in detections.tags if t not in sync]
    if not tags:
        raise InputError("all tags in the detections are sync tags", mend="name one with --tag")
    return tags


def sync_tags(detections: Detections, receivers: Receivers) -> set[str]:
    """Full ids of the sync tags that are among the detections."""
    wanted = {str(s) for s in receivers.sync_tag if s}
    return {t for t in detections.tags if any(t == s or t.endswith(f"-{s}") for s in wanted)}


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

    how = {"reference": options.reference, "progress": not log.quiet}
    sync = fit(detections, receivers, sound_speed=options.speed(), **how)
    for note in sync.notes:
        (log.notice if note.level == "info" else log.warn)(note.text)
    log.notice(repr(sync))
    return sync
