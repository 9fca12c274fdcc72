"""What `maloc points` does, from options to a finished folder."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError
from maloc.export import output
from maloc.export.folder import check_free, output_folder
from maloc.runs.load import Source, load
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.sound import with_sound

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import ArrivalTimes, Receivers
    from maloc.points import Points

__all__ = ["PointsOptions", "run_points"]

PNG = {"dpi": 110, "pil_kwargs": {"compress_level": 1}}
FAR = "disagrees with the position"
BY_BEACONS = "consensus", "cluster", "closed-form"


@dataclass(frozen=True)
class PointsOptions:
    """Everything that `maloc points` was asked for; written into summary.json."""

    source: TrackOptions
    method: str = "consensus"
    sigma: float | None = None
    depth: str = "auto"
    above: float = 0.0
    region: Path | None = None
    resolve: bool = False
    beacon_window: float = 60.0
    how: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.sigma is not None and not self.sigma > 0:
            raise InputError(f"--sigma must be positive, got {self.sigma:g}")
        if self.source.sound_speed == "estimated":
            raise InputError("single pings do not tell the sound speed; give m/s")
        if self.source.sync == "beacons" and self.method not in BY_BEACONS:
            raise InputError(f"--sync beacons goes with --method {', '.join(BY_BEACONS)}")
        if not self.beacon_window > 0:
            raise InputError(f"--beacon-window must be positive, got {self.beacon_window:g}")

    def place(self) -> Any:
        """The depth as `maloc.points.locate` takes it."""
        from maloc.points.altitude import PLACES, read_terrain

        if self.depth in PLACES:
            return self.depth
        try:
            return float(self.depth)
        except ValueError:
            pass
        if not Path(self.depth).exists():
            raise InputError(
                f"--depth {self.depth} is none of {', '.join(PLACES)}, a number or a file"
            )
        if self.source.sync == "beacons":
            raise InputError("--sync beacons knows no terrain; give the depth in metres")
        return read_terrain(self.depth, self.above)

    def record(self) -> dict[str, Any]:
        """The options as plain values."""
        own = {k: v for k, v in asdict(self).items() if k not in ("source", "how")}
        used = ("detections", "toa", "receivers", "tags", "sync", "reference", "sound_speed")
        given = self.source.record()
        return {k: given[k] for k in (*used, "ignore_columns", "crs", "seed")} | own | self.how


def run_points(
    options: PointsOptions, out: Path, *, force: bool = False, quiet: bool = False
) -> list[str]:
    """Do all of `maloc points`; nothing is written unless everything worked.

    Returns
    -------
    list of str
        One line a tag: what was found.

    Raises
    ------
    InputError
        Bad input, or `out` is taken.
    """
    check_free(out, force)
    place = options.place()
    log = Log(quiet)
    with log.listening():
        source = with_sound(load(options.source, log), options.source, log)
        log.release()
        with log.stage("engine start"):
            import maloc.points as engine
        how: dict[str, Any] = {"depth": place} | options.how
        if options.sigma is not None:
            how["sigma"] = options.sigma
        if options.region is not None:
            how["region"] = engine.read_region(options.region, source.receivers.crs)
        if options.method in ("pmc", "dm-pmc"):
            how["seed"] = options.source.seed
        with log.stage("locate"):
            found = [_locate(toa, source, options, how) for toa in source.toas]
            if options.resolve:
                found = [engine.resolve(p) for p in found]
        with output_folder(out, force) as folder:
            _write(folder, found, source, options, log)
    return [_line(p) for p in found]


def _locate(
    toa: ArrivalTimes, source: Source, options: PointsOptions, how: dict[str, Any]
) -> Points:
    from maloc.points import locate, locate_by_beacons

    method: Any = options.method
    if options.source.sync != "beacons":
        return locate(toa, method, **how)
    near = {"window": options.beacon_window, "multiple": True}
    return locate_by_beacons(toa, source.beacons, method, **near, **how)


def _line(points: Points) -> str:
    located = points.located
    sd = points.sd[located]
    sd = sd[np.isfinite(sd).all(axis=1)]
    middle = f"{np.median(sd):.2f} m" if len(sd) else "unknown"
    return (
        f"{points.tag or 'points'}: {int(located.sum())} of {len(points)} pings located, "
        f"{int((points.ambiguous & located).sum())} ambiguous, median sd {middle}"
    )


def _write(
    folder: Path, found: list[Points], source: Source, options: PointsOptions, log: Log
) -> None:
    import polars as pl

    with log.stage("tables"):
        pairs = list(zip(found, source.toas, strict=True))
        tables = {
            "points": [points_table(p, t, source.receivers) for p, t in pairs],
            "arrivals": [arrivals_table(p, t, one_clock=not source.beacons) for p, t in pairs],
        }
        for name, parts in tables.items():
            output.write_table(pl.concat(parts, how="diagonal_relaxed"), folder / f"{name}.csv")
    with log.stage("figures"):
        from matplotlib.figure import Figure

        from maloc.plots._points import points as draw

        figure = Figure(figsize=(8.0, 7.5), layout="constrained")
        ax = figure.add_subplot()
        for i, p in enumerate(found):
            draw(p, source.receivers if i == 0 else None, number=i, ax=ax)
        figure.savefig(folder / "map.png", **PNG)
    output.write_json(_summary(found, source, options, log), folder / "summary.json")


def points_table(points: Points, toa: ArrivalTimes, receivers: Receivers) -> pl.DataFrame:
    """Return points.csv of one tag: one row a ping, located or not.

    Parameters
    ----------
    points : Points
    toa : ArrivalTimes
        What they were found from.
    receivers : Receivers
        Give longitude and latitude where their frame is known.
    """
    import polars as pl
    import polars.selectors as cs

    start = 0 if toa.origin is None else toa.origin
    known = np.isfinite(points.emission)
    moment = start + np.rint(np.where(known, points.emission, 0.0) * NS).astype(np.int64)
    text = np.datetime_as_string(moment.astype("datetime64[ns]"), "us")
    dated = known & (toa.origin is not None)
    table = points.to_frame().drop("time")
    columns = [
        pl.Series("tag", [points.tag] * len(points), pl.String),
        pl.Series("time", [f"{s}Z" if k else None for s, k in zip(text, dated, strict=True)]),
        pl.Series("t", start / NS + points.emission),
        *(table[c] for c in table.columns if c not in ("why", "ping")),
        pl.Series("n_receivers", toa.n_heard),
        table["ping"],
    ]
    if receivers.crs is not None:
        lonlat = receivers.lonlat(points.position[:, 0], points.position[:, 1])
        columns += [pl.Series(n, v) for n, v in zip(("longitude", "latitude"), lonlat, strict=True)]
    precise = cs.by_name("t", "longitude", "latitude", require_all=False)
    return pl.DataFrame([*columns, table["why"]]).with_columns((cs.float() - precise).round(4))


def arrivals_table(points: Points, toa: ArrivalTimes, *, one_clock: bool = True) -> pl.DataFrame:
    """Return arrivals.csv of one tag, columns as of `maloc track`; residuals in s.

    p_direct is what population Monte Carlo says; other methods leave it empty. `used`: the arrival
    agrees with the position. Where clocks are apart there are no residuals.
    """
    import polars as pl

    row, column = np.nonzero(toa.heard)
    d = points.position.shape[1]
    place = toa.receivers.xy[column]
    square = ((points.position[row, :2] - place) ** 2).sum(axis=1)
    if d == 3:
        square = square + (points.position[row, 2] - np.asarray(toa.receivers.depth)[column]) ** 2
    late = toa.toa[row, column] - points.emission[row] - np.sqrt(square) / toa.sound_speed[row]
    used = points.inlier[row, column]
    located = points.located[row]
    reflected = points.extra.get("p_reflected")
    direct = None if reflected is None else 1 - reflected[row, column]
    aside = toa.set_aside
    nothing = [None] * len(aside)
    start = 0.0 if toa.origin is None else toa.origin / NS
    why = np.where(used, "", np.where(located, FAR, points.why[row]))
    detection = None if toa.detection is None else toa.detection[row, column]
    columns: dict[str, tuple[list, Any]] = {
        "ping": (toa.ping[row].tolist() + nothing, pl.Int64),
        "receiver": (
            np.asarray(toa.receivers.labels, str)[column].tolist() + aside.receiver.tolist(),
            pl.String,
        ),
        "residual": ((late.tolist() if one_clock else [None] * len(row)) + nothing, pl.Float64),
        "p_direct": (
            ([None] * len(row) if direct is None else direct.tolist()) + nothing,
            pl.Float64,
        ),
        "used": (used.tolist() + [False] * len(aside), pl.Boolean),
        "why": (why.tolist() + aside.why.tolist(), pl.String),
        "tag": ([toa.tag] * (len(row) + len(aside)), pl.String),
        "t": ((start + np.concatenate([toa.toa[row, column], aside.time])).tolist(), pl.Float64),
        "detection": (
            ([None] * len(row) if detection is None else [None if i < 0 else i for i in detection])
            + aside.detection.tolist(),
            pl.Int64,
        ),
    }
    return pl.DataFrame([pl.Series(k, *columns[k]) for k in output.ARRIVALS])


def _summary(
    found: list[Points], source: Source, options: PointsOptions, log: Log
) -> dict[str, Any]:
    tags = {}
    for points, toa in zip(found, source.toas, strict=True):
        tags[toa.tag or "points"] = {
            "pings": len(points),
            "located": int(points.located.sum()),
            "ambiguous": int((points.ambiguous & points.located).sum()),
            "not_located": output.counts(points.why[~points.located]),
            "arrivals": int(toa.heard.sum()),
            "arrivals_agreeing": int(points.inlier.sum()),
            "set_aside": output.counts(toa.set_aside.why),
            "sigma": points.sigma,
            "sound_speed": float(np.mean(toa.sound_speed)),
            "notes": [str(n) for n in toa.report.notes],
        }
    return {
        "command": "points",
        "versions": output.versions(),
        "seed": options.source.seed,
        "options": options.record(),
        "read": {
            "receivers": len(source.receivers),
            "detections": None if source.detections is None else len(source.detections),
        },
        "sync": None if source.sync is None else output.sync_record(source.sync),
        "tags": tags,
        "skipped_tags": source.skipped,
        "warnings": log.warnings,
        "notices": log.notices,
        "seconds": log.seconds,
    }
