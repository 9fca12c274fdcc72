"""The command ``maloc study canal``: what was asked for, checked; run; told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.simulate.canal import CanalDesign
from maloc.studies.canal.cases import Address, folder_cases, own_cases, read_schedules
from maloc.studies.canal.study import Settings, run_canal
from maloc.studies.canal.tables import read_peer, report

__all__ = ["CanalOptions", "run"]


@dataclass(frozen=True)
class CanalOptions:
    """Options of the command, as given; `maloc.cli.canal` says what they mean."""

    tracks: int
    missing: str
    late: str
    methods: str
    pings: int
    noise: str
    detection: tuple[float, float] | None
    drift: float
    receivers: Path | None
    folder: Path | None
    interval: tuple[float, float] | None
    interval_stable: tuple[float, float] | None
    schedules: Path | None
    peer: Path | None
    draws: int
    seed: int


def run(options: CanalOptions, out: Path, *, workers: int, quiet: bool) -> str:
    """Run the study and return its tables.

    Raises
    ------
    InputError
        If an option cannot be, or cannot be beside another.
    """
    settings = Settings(
        _design(options),
        options.seed,
        options.draws,
        options.receivers,
        options.folder,
        _schedule(options),
        () if options.schedules is None else read_schedules(options.schedules),
    )
    peer = None if options.peer is None else read_peer(options.peer)
    methods = tuple(m.strip() for m in options.methods.split(",") if m.strip())
    found = run_canal(settings, _cases(options), methods, out, workers=workers, quiet=quiet)
    own = options.folder is None and options.detection is None
    return report(found, peer, own)


def _cases(options: CanalOptions) -> tuple[Address, ...]:
    if options.folder is not None:
        return folder_cases(options.folder)
    return own_cases(
        options.tracks, _shares(options.missing, "missing"), _shares(options.late, "late")
    )


def _shares(text: str, name: str) -> tuple[float, ...]:
    try:
        shares = tuple(dict.fromkeys(float(part) for part in text.split(",") if part.strip()))
    except ValueError:
        shares = ()
    if not shares:
        raise InputError(f"--{name} '{text}' is no list of shares", mend="such as 0,0.3,0.5")
    return shares


def _design(options: CanalOptions) -> CanalDesign:
    p0, scale = options.detection or (1.0, float("inf"))
    if options.drift and options.detection is None:
        raise InputError("--drift has no detection range to drift", mend="give --detection")
    try:
        sd = 0.0 if options.noise == "poisson" else 1e-3 * float(options.noise)
    except ValueError:
        raise InputError(f"--noise '{options.noise}' is neither ms nor poisson") from None
    kind = "poisson" if options.noise == "poisson" else "gaussian"
    return CanalDesign(
        n_pings=options.pings,
        noise=kind,
        sd=sd,
        p0=p0,
        scale=scale,
        drift_sd=options.drift,
    )


def _schedule(options: CanalOptions) -> Schedule:
    given = options.interval or options.interval_stable or options.schedules
    if given and options.folder is None:
        raise InputError("burst intervals are told of a folder's files", mend="give --folder")
    if options.interval and options.interval_stable:
        raise InputError("the interval is either random or stable", mend="leave one out")
    if options.interval:
        return Schedule("random", *options.interval)
    if options.interval_stable:
        return Schedule("stable", *options.interval_stable)
    return Schedule()
