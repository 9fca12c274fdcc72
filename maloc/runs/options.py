"""What a command was asked for: checked once, written into summary.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maloc.errors import InputError
from maloc.runs.reading import Reading
from maloc.runs.speed import speed_error, speed_of_water

if TYPE_CHECKING:
    from maloc.data import Schedule

__all__ = ["TrackOptions", "metres"]

DEPTHS = "flat", "sensor", "3d"


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
    error: str = "auto"
    receiver_errors: str = "auto"
    interval: tuple[float, float] | None = None
    interval_stable: tuple[float, float] | None = None
    schedule_file: Path | None = None
    water: Path | None = None
    depth: str = "flat"
    depth_sd: float = 1.0
    bottom: str | None = None
    sound_speed: str | None = None
    sound_speed_sd: str | None = None
    receiver_sd: float | None = None
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
        _check_depth(self)
        _check_sds(self)
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
            from maloc.readers.sequence import read_sequence

            sequence = read_sequence(self.schedule_file)
            return Schedule("random", float(sequence.min()), float(sequence.max()))
        return Schedule()

    def speed(self) -> float | Path | None:
        """The sound speed given, m/s, or its table; None where it is to be estimated."""
        estimated = self.sound_speed in ("estimated", "drifting")
        return None if estimated else speed_of_water(self.sound_speed)

    def speed_sd(self) -> float | None:
        """How sure the sound speed is, m/s; 0: exact; None: as its source has it."""
        return speed_error(self.sound_speed_sd)

    def record(self) -> dict[str, Any]:
        """The options as plain values."""
        return {k: v for k, v in asdict(self).items()}


def _check_sds(options: TrackOptions) -> None:
    """Raise InputError where the options of sds cannot be meant."""
    options.speed_sd()
    if options.receiver_sd is not None:
        if not (isfinite(options.receiver_sd) and options.receiver_sd >= 0):
            raise InputError(f"--receiver-sd {options.receiver_sd:g} m is negative")
        if options.model == "detections":
            raise InputError("--receiver-sd goes with --model toa or joint")
    if options.sound_speed_sd is None:
        return
    if options.sound_speed in ("estimated", "drifting"):
        raise InputError(
            f"--sound-speed-sd goes with a speed, not --sound-speed {options.sound_speed}"
        )
    if options.sound_speed is None and options.toa is None:
        raise InputError("--sound-speed-sd needs --sound-speed C or TABLE.csv")


def _check_depth(options: TrackOptions) -> None:
    """Raise InputError where the options of depth cannot be meant."""
    flat = options.depth == "flat"
    if not flat and options.model == "detections":
        raise InputError("--depth goes with --model toa or joint")
    if flat and options.bottom is not None:
        raise InputError("--bottom says nothing to a flat track", mend="give --depth, too")
    if not options.depth_sd >= 0:
        raise InputError(f"--depth-sd {options.depth_sd:g} m is negative")
    if options.depth not in DEPTHS and not isfinite(metres(options.depth)):
        raise InputError(f"--depth {options.depth} is none of {', '.join(DEPTHS)}, nor metres")
    if options.bottom is not None and not isfinite(metres(options.bottom)):
        if not Path(options.bottom).exists():
            raise InputError(f"--bottom {options.bottom} is neither metres nor a file")


def metres(text: str) -> float:
    """Return what a text says in metres; NaN where it is no number."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
