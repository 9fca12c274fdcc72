"""The commands `maloc track` and `maloc points`: their options, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from maloc.cli.errors import explained
from maloc.cli.options import (
    Clock,
    Crs,
    Detections,
    Force,
    Format,
    IgnoreColumns,
    Out,
    Quiet,
    ReceiverSd,
    ReceiverTable,
    Reference,
    Scheduler,
    Seed,
    SpeedSd,
    Tags,
    TagTable,
    Toa,
    Workers,
    Zone,
)

__all__ = ["points", "track"]


@explained
def track(
    receivers: ReceiverTable,
    out: Out,
    detections: Detections = None,
    toa: Toa = None,
    tag: Tags = None,
    sync: Annotated[
        str,
        typer.Option(metavar="auto|none|SYNC.nc", help="How clocks are brought together."),
    ] = "auto",
    reference: Reference = None,
    model: Annotated[
        Literal["toa", "detections", "joint"],
        typer.Option(help="Arrival times, which receivers heard each ping, or both at once."),
    ] = "toa",
    movement: Annotated[
        Literal["ctcrw", "rw", "ou"],
        typer.Option(help="Correlated or plain random walk, or around a home range (ou)."),
    ] = "ctcrw",
    error: Annotated[
        Literal["auto", "ddetect", "multipath", "gaussian", "student"],
        typer.Option(help="Law of arrival errors; auto: ddetect or multipath, by evidence."),
    ] = "auto",
    receiver_errors: Annotated[
        Literal["auto", "estimated", "exact"],
        typer.Option(help="Receivers' places and lateness (--model toa); auto: if arrivals tell."),
    ] = "auto",
    detection: Annotated[
        Literal["halfnormal", "logistic", "hazard"],
        typer.Option(help="Detection by distance (not --model toa)."),
    ] = "halfnormal",
    loss: Annotated[
        bool,
        typer.Option(help="Pings may be lost to all receivers at once (not --model toa)."),
    ] = True,
    dispersion: Annotated[
        bool,
        typer.Option("--dispersion", help="Some pings are heard badly by all (not --model toa)."),
    ] = False,
    receiver_effects: Annotated[
        bool,
        typer.Option("--receiver-effects", help="Some receivers hear badly (not --model toa)."),
    ] = False,
    interval: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MIN MAX", help="Random burst interval, s."),
    ] = None,
    interval_stable: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MEAN SD", help="Stable burst interval, s."),
    ] = None,
    schedule: Annotated[
        Path | None,
        typer.Option(help="File of the tag's sequence of burst intervals, s (--model joint)."),
    ] = None,
    water: Annotated[
        Path | None,
        typer.Option(
            help="GeoJSON or raster of the water: none is on land (not --model detections)."
        ),
    ] = None,
    depth: Annotated[
        str,
        typer.Option(
            metavar="flat|sensor|3d|M",
            help="Flat tracks; with depth as sensed, or to be found; at M m (not detections).",
        ),
    ] = "flat",
    depth_sd: Annotated[
        float, typer.Option(metavar="M", help="Error (sd) of the tag's depth sensor, m.")
    ] = 1.0,
    bottom: Annotated[
        str | None,
        typer.Option(metavar="M|DEM.tif", help="Depth of the water, m, or a file of elevations."),
    ] = None,
    sound_speed: Annotated[
        str | None,
        typer.Option(
            metavar="C|estimated|drifting|TABLE.csv",
            help="Sound speed, m/s (drifting: joint), or the water's state in time or by depth.",
        ),
    ] = None,
    sound_speed_sd: SpeedSd = None,
    receiver_sd: ReceiverSd = None,
    method: Annotated[
        Literal["laplace", "nuts", "hmc", "svi"],
        typer.Option(help="How the posterior is found (svi: not --model toa)."),
    ] = "laplace",
    start: Annotated[
        Literal["annealed", "pmc"],
        typer.Option(help="pmc: begin from single pings' positions too, the better start wins."),
    ] = "annealed",
    ignore_columns: IgnoreColumns = "",
    crs: Crs = None,
    format: Format = None,
    tz: Zone = None,
    clock: Clock = None,
    tag_table: TagTable = None,
    draws: Annotated[int, typer.Option(min=1, help="Posterior draws a chain.")] = 1000,
    chains: Annotated[int, typer.Option(min=2, help="Chains of a sampler.")] = 2,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Estimate tracks: positions of every ping with their uncertainty.

    Writes track.csv, arrivals.csv, parameters.csv, posterior.nc, map.png, diagnostics.png,
    summary.json; for several tags tags.csv, how each fared; where missed pings are summed out
    (--model detections or joint, with an interval), missed.csv too. --model detections needs
    neither synchronised clocks nor fractions of a second.
    """
    from maloc.runs.options import TrackOptions
    from maloc.runs.reading import Reading
    from maloc.runs.track import run_track

    options = TrackOptions(
        detections=tuple(detections or ()),
        toa=toa,
        receivers=receivers,
        reading=Reading(format, tz, clock, tag_table),
        tags=tuple(tag or ()),
        sync=sync,
        reference=reference,
        model=model,
        movement=movement,
        detection=detection,
        loss=loss,
        dispersion=dispersion,
        receiver_effects=receiver_effects,
        error=error,
        receiver_errors=receiver_errors,
        interval=interval,
        interval_stable=interval_stable,
        schedule_file=schedule,
        water=water,
        depth=depth,
        depth_sd=depth_sd,
        bottom=bottom,
        sound_speed=sound_speed,
        sound_speed_sd=sound_speed_sd,
        receiver_sd=receiver_sd,
        method=method,
        start=start,
        ignore_columns=_listed(ignore_columns),
        crs=crs,
        draws=draws,
        chains=chains,
        seed=seed,
    )
    spread = {"workers": workers, "scheduler": scheduler}
    lines = run_track(options, out, **spread, force=force, quiet=quiet)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


@explained
def points(
    receivers: ReceiverTable,
    out: Out,
    detections: Detections = None,
    toa: Toa = None,
    tag: Tags = None,
    method: Annotated[
        Literal["closed-form", "consensus", "cluster", "least-squares", "pmc", "dm-pmc"],
        typer.Option(help="How a ping is located."),
    ] = "consensus",
    sigma: Annotated[
        float | None, typer.Option(help="Standard deviation of arrivals, m; estimated if none.")
    ] = None,
    depth: Annotated[
        str,
        typer.Option(
            metavar="auto|flat|sensor|3d|M|DEM.tif",
            help="The tag's depth: as sensed, at the receivers', to be found, m, or on the ground.",
        ),
    ] = "auto",
    above: Annotated[
        float, typer.Option(metavar="M", help="Height above the ground of DEM.tif, m.")
    ] = 0.0,
    region: Annotated[
        Path | None, typer.Option(help="Corners of a polygon that the tag cannot have left.")
    ] = None,
    resolve: Annotated[
        bool, typer.Option("--resolve", help="Of two places, the one that other pings tell.")
    ] = False,
    sync: Annotated[
        str,
        typer.Option(metavar="auto|none|beacons|SYNC.nc", help="How clocks are brought together."),
    ] = "auto",
    beacon_window: Annotated[
        float, typer.Option(metavar="S", help="--sync beacons: sync tags' pings this near in time.")
    ] = 60.0,
    reference: Reference = None,
    sound_speed: Annotated[
        str | None,
        typer.Option(metavar="C|TABLE.csv", help="Sound speed, m/s, or the water's state."),
    ] = None,
    ignore_columns: IgnoreColumns = "",
    crs: Crs = None,
    format: Format = None,
    tz: Zone = None,
    clock: Clock = None,
    tag_table: TagTable = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Locate every ping by itself, without a model of movement.

    Writes points.csv, arrivals.csv, map.png, summary.json.
    """
    from maloc.runs.options import TrackOptions
    from maloc.runs.points import PointsOptions, run_points
    from maloc.runs.reading import Reading

    source = TrackOptions(
        detections=tuple(detections or ()),
        toa=toa,
        receivers=receivers,
        reading=Reading(format, tz, clock, tag_table),
        tags=tuple(tag or ()),
        sync=sync,
        reference=reference,
        sound_speed=sound_speed,
        ignore_columns=_listed(ignore_columns),
        crs=crs,
        seed=seed,
    )
    asked = PointsOptions(source, method, sigma, depth, above, region, resolve, beacon_window)
    lines = run_points(asked, out, force=force, quiet=quiet)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


def _listed(text: str) -> tuple[str, ...]:
    return tuple(c.strip() for c in text.split(",") if c.strip())
