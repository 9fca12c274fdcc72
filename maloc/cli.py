"""The command line: parse, call, write. Heavy imports happen inside the commands."""

from __future__ import annotations

import functools
import gc
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from maloc.errors import FitError, InputError

__all__ = ["app", "main"]

BAD_INPUT, FAILED_FIT = 2, 1


class OneLineGroup(TyperGroup):
    """Commands whose every failure is one line on stderr and an exit code."""

    def main(self, *args: Any, standalone_mode: bool = True, **kwargs: Any) -> Any:
        """Run, and turn usage errors into one line and exit code 2."""
        try:
            code = super().main(*args, standalone_mode=False, **kwargs)
        except Exception as problem:
            text = getattr(problem, "format_message", None)
            if text is None:
                raise
            context = getattr(problem, "ctx", None)
            name = context.command_path if context is not None else "maloc"
            code = _fail(f"{text().rstrip('.')} (see {name} --help)", BAD_INPUT)
        if standalone_mode:
            sys.exit(code if isinstance(code, int) else 0)
        return code


def _fail(text: object, code: int) -> int:
    print(f"maloc: error: {' '.join(str(text).split())}", file=sys.stderr)
    return code


def _explained(command: Callable) -> Callable:
    """Wrap a command so that explained failures are one line and an exit code."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except InputError as problem:
            raise typer.Exit(_fail(problem, BAD_INPUT)) from None
        except FitError as problem:
            raise typer.Exit(_fail(problem, FAILED_FIT)) from None

    return run


app = typer.Typer(
    cls=OneLineGroup,
    add_completion=False,
    pretty_exceptions_enable=False,
    invoke_without_command=True,
    help="Where tagged animals were: tracks with honest uncertainty from acoustic receivers.",
)

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier output folder.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same input and seed, same output.")]
Crs = Annotated[
    str | None,
    typer.Option("--crs", help="Frame of the receivers' x, y (EPSG:n), or the one to project to."),
]

Format = Annotated[
    str | None,
    typer.Option("--format", metavar="NAME", help="Format of the detections: vue, vdat, otn, ..."),
]
Zone = Annotated[
    str | None, typer.Option("--tz", metavar="ZONE", help="Zone of local times: Europe/Copenhagen.")
]
Clock = Annotated[
    Literal["device", "corrected", "linear"] | None,
    typer.Option("--clock", help="Which of an export's two times; linear corrects the device's."),
]
TagTable = Annotated[
    Path | None,
    typer.Option("--tag-table", help="Table of codes: animals, sensors, burst limits, receivers."),
]


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version.")] = False,
) -> None:
    if version:
        from maloc import __version__

        typer.echo(f"maloc {__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
@_explained
def check(
    files: Annotated[
        list[Path],
        typer.Argument(help="Files of detections, events, receivers, tags, positions, or TOA."),
    ],
    receivers: Annotated[Path | None, typer.Option(help="The table of receivers.")] = None,
    format: Format = None,
    tz: Zone = None,
    clock: Clock = None,
) -> None:
    """Say what files hold: format, span, tags, receivers, and every problem found.

    Exit code 0 when nothing stands in the way, 2 when an error does.
    """
    from maloc.data.check import check as check_files

    found = check_files(files, receivers, tz, format=format, clock=clock)
    typer.echo(str(found))
    if not found.ok:
        first = found.errors[0]
        more = f" (and {len(found.errors) - 1} more)" if len(found.errors) > 1 else ""
        raise typer.Exit(_fail(f"{first}{more}".removeprefix("error: "), BAD_INPUT))


@app.command()
@_explained
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write.")],
    scenario: Annotated[Literal["canal", "grid", "line"], typer.Option(help="Array.")] = "grid",
    pings: Annotated[int, typer.Option(min=1, help="Pings of the animal's tag.")] = 250,
    interval: Annotated[
        tuple[float, float], typer.Option(metavar="MIN MAX", help="Burst interval, s.")
    ] = (20.6, 36.6),
    missing: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of arrivals that nobody heard.")
    ] = 0.3,
    late: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of arrivals by a reflected path.")
    ] = 0.06,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate an array: detections.csv, receivers.csv, truth.csv, toa.csv.

    Detections are raw, on drifting clocks; toa.csv has the same on the true clock.
    """
    from maloc._folder import check_free

    check_free(out, force)
    import numpy as np

    from maloc.data import Schedule
    from maloc.simulate import Hearing
    from maloc.simulate import simulate as simulate_study

    study = simulate_study(
        np.random.default_rng(seed),
        scenario,
        pings,
        schedule=Schedule("random", *interval),
        hearing=Hearing(p_na=missing, p_mp=late),
    )
    study.write(out, force)
    if not quiet:
        typer.echo(f"{study!r}\nwritten to {out}")


@app.command()
@_explained
def sync(
    detections: Annotated[list[Path], typer.Argument(help="Files of raw detections.")],
    receivers: Annotated[Path, typer.Option(help="The table of receivers, with sync tags.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    reference: Annotated[
        str | None, typer.Option(help="Receiver whose clock is the common time.")
    ] = None,
    sound_speed: Annotated[
        float | None, typer.Option(min=1300, max=1700, help="m/s; estimated when left out.")
    ] = None,
    crs: Crs = None,
    format: Format = None,
    tz: Zone = None,
    clock: Clock = None,
    tag_table: TagTable = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Synchronise the receivers' clocks by their sync tags.

    Writes sync.nc, detections_synced.parquet, receivers_fitted.csv, residuals.csv, figures and
    summary.json.
    """
    from maloc._reading import Reading
    from maloc._run import run_sync

    reading = Reading(format, tz, clock, tag_table)
    how: dict[str, Any] = {"reading": reading, "force": force, "quiet": quiet}
    found = run_sync(detections, receivers, out, reference, sound_speed, crs, seed, **how)
    if not quiet:
        typer.echo(f"{found.summary()}\nwritten to {out}")


@app.command()
@_explained
def track(
    receivers: Annotated[Path, typer.Option(help="The table of receivers.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    detections: Annotated[
        list[Path] | None, typer.Argument(help="Files of detections (or give --toa).")
    ] = None,
    toa: Annotated[
        Path | None, typer.Option(help="Matrix of arrival times, one row a ping.")
    ] = None,
    tag: Annotated[
        list[str] | None,
        typer.Option(help="Tag to track; several times for several; all but sync tags if none."),
    ] = None,
    sync: Annotated[
        str,
        typer.Option(metavar="auto|none|SYNC.nc", help="How clocks are brought together."),
    ] = "auto",
    reference: Annotated[
        str | None, typer.Option(help="Receiver whose clock is the common time.")
    ] = None,
    model: Annotated[
        Literal["toa", "detections", "joint"],
        typer.Option(help="Arrival times, which receivers heard each ping, or both at once."),
    ] = "toa",
    movement: Annotated[
        Literal["ctcrw", "rw", "ou"],
        typer.Option(help="Correlated or plain random walk, or around a home range (ou)."),
    ] = "ctcrw",
    error: Annotated[
        Literal["ddetect", "gaussian", "student"], typer.Option(help="Law of arrival errors.")
    ] = "ddetect",
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
            help="GeoJSON of the water: animals are not on land (not --model detections)."
        ),
    ] = None,
    sound_speed: Annotated[
        str | None,
        typer.Option(metavar="C|estimated|drifting", help="Sound speed, m/s (drifting: joint)."),
    ] = None,
    method: Annotated[
        Literal["laplace", "nuts", "hmc", "svi"],
        typer.Option(help="How the posterior is found (svi: not --model toa)."),
    ] = "laplace",
    start: Annotated[
        Literal["annealed", "pmc"],
        typer.Option(help="pmc: begin from single pings' positions too, the better start wins."),
    ] = "annealed",
    ignore_columns: Annotated[
        str, typer.Option(metavar="A,B", help="Columns of the TOA matrix to leave alone.")
    ] = "",
    crs: Crs = None,
    format: Format = None,
    tz: Zone = None,
    clock: Clock = None,
    tag_table: TagTable = None,
    draws: Annotated[int, typer.Option(min=1, help="Posterior draws a chain.")] = 1000,
    chains: Annotated[int, typer.Option(min=2, help="Chains of a sampler.")] = 2,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Estimate tracks: positions of every ping with their uncertainty.

    Writes track.csv, arrivals.csv, parameters.csv, posterior.nc, map.png, diagnostics.png,
    summary.json; where missed pings are summed out (--model detections or joint, with an interval),
    missed.csv too. --model detections needs neither synchronised clocks nor fractions of a second.
    """
    from maloc._load import TrackOptions
    from maloc._reading import Reading
    from maloc._run import run_track

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
        interval=interval,
        interval_stable=interval_stable,
        schedule_file=schedule,
        water=water,
        sound_speed=sound_speed,
        method=method,
        start=start,
        ignore_columns=tuple(c.strip() for c in ignore_columns.split(",") if c.strip()),
        crs=crs,
        draws=draws,
        chains=chains,
        seed=seed,
    )
    lines = run_track(options, out, force=force, quiet=quiet)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


studies = typer.Typer(
    cls=OneLineGroup, pretty_exceptions_enable=False, help="Repeat published simulation studies."
)
app.add_typer(studies, name="study")


@studies.command("hostetter-royle")
@_explained
def hostetter_royle(
    datasets: Annotated[int, typer.Option(min=1, help="Simulated data sets.")] = 2,
    workers: Annotated[int, typer.Option(min=1, help="Processes, of one thread each.")] = 1,
    models: Annotated[
        str, typer.Option(metavar="A,B", help="Models to fit; all four if not given.")
    ] = "independent,detection_only,known_interval,unknown_interval",
    draws: Annotated[int, typer.Option(min=50, help="Draws of each of two chains.")] = 300,
    method: Annotated[
        Literal["auto", "nuts", "hmc"],
        typer.Option(help="Sampler; auto: hmc, but nuts for the independent model."),
    ] = "auto",
    out: Annotated[Path, typer.Option(help="Folder of the results; gone on with.")] = Path(
        "hostetter-royle"
    ),
    tags: Annotated[int, typer.Option(min=1, help="Tags in a data set.")] = 25,
    side: Annotated[int, typer.Option(min=2, help="Receivers along a side of the array.")] = 10,
    duration: Annotated[float, typer.Option(min=10, help="Length of a data set.")] = 150.0,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Simulate and fit as Hostetter & Royle (2020), and print their Tables 1 and 2 beside ours.

    Results lie in --out, one Parquet file a data set and model; what is there is not done again.
    """
    from maloc._study import Settings, run_study
    from maloc._study_tables import report
    from maloc.simulate.hostetter_royle import Design

    design = Design(tags=tags, side=side, duration=duration)
    settings = Settings(design, seed, draws, method=method)
    chosen = tuple(m.strip() for m in models.split(",") if m.strip())
    found = run_study(settings, datasets, out, models=chosen, workers=workers, quiet=quiet)
    typer.echo(report(found))


@studies.command("canal")
@_explained
def canal(
    tracks: Annotated[int, typer.Option(min=1, help="Simulated tracks, each in every cell.")] = 2,
    missing: Annotated[
        str, typer.Option(metavar="P,P", help="Shares of missing arrivals.")
    ] = "0,0.5",
    late: Annotated[str, typer.Option(metavar="P,P", help="Shares of late arrivals.")] = "0,0.15",
    methods: Annotated[
        str,
        typer.Option(
            metavar="A,B", help="Of toa, nuts, hmc, joint, toa-known, pmc, consensus, de."
        ),
    ] = "toa",
    pings: Annotated[int, typer.Option(min=2, help="Pings of a track.")] = 250,
    noise: Annotated[
        str,
        typer.Option(metavar="MS|poisson", help="Arrival errors: their sd, or +-Poisson(1) ms."),
    ] = "0.3",
    detection: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="P0 M", help="Half-normal detection: chance at 0 m, scale."),
    ] = None,
    drift: Annotated[
        float, typer.Option(min=0, help="Standard deviation of the log of that scale in time.")
    ] = 0.0,
    receivers: Annotated[
        Path | None, typer.Option(help="Table of the array, if not the built-in one.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Fit the files in it (toa_..., x, y) instead.")
    ] = None,
    interval: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MIN MAX", help="Random burst interval of those files, s."),
    ] = None,
    interval_stable: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="MEAN SD", help="Stable burst interval of those files, s."),
    ] = None,
    schedules: Annotated[
        Path | None, typer.Option(help="Their intervals one by one: file, kind, lo, hi.")
    ] = None,
    peer: Annotated[
        Path | None, typer.Option(help="Another program's results: file, mean (m).")
    ] = None,
    draws: Annotated[int, typer.Option(min=50, help="Draws of each of two chains.")] = 1000,
    workers: Annotated[int, typer.Option(min=1, help="Processes, of one thread each.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of the results; gone on with.")] = Path("canal"),
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Tracks in a canal with missing and late arrivals, by several methods side by side.

    Prints errors, coverage and calibration a method and cell, with the thesis's Table C.1, or a
    peer's errors on the same files, beside. Results lie in --out, one Parquet file a case and
    method; what is there is not done again.
    """
    from maloc._canal_run import CanalOptions, run

    options = CanalOptions(
        tracks=tracks,
        missing=missing,
        late=late,
        methods=methods,
        pings=pings,
        noise=noise,
        detection=detection,
        drift=drift,
        receivers=receivers,
        folder=folder,
        interval=interval,
        interval_stable=interval_stable,
        schedules=schedules,
        peer=peer,
        draws=draws,
        seed=seed,
    )
    typer.echo(run(options, out, workers=workers, quiet=quiet))


@app.command()
@_explained
def points(
    receivers: Annotated[Path, typer.Option(help="The table of receivers.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    detections: Annotated[
        list[Path] | None, typer.Argument(help="Files of detections (or give --toa).")
    ] = None,
    toa: Annotated[
        Path | None, typer.Option(help="Matrix of arrival times, one row a ping.")
    ] = None,
    tag: Annotated[
        list[str] | None,
        typer.Option(help="Tag; several times for several; all but sync tags if none."),
    ] = None,
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
    reference: Annotated[
        str | None, typer.Option(help="Receiver whose clock is the common time.")
    ] = None,
    sound_speed: Annotated[str | None, typer.Option(metavar="C", help="Sound speed, m/s.")] = None,
    ignore_columns: Annotated[
        str, typer.Option(metavar="A,B", help="Columns of the TOA matrix to leave alone.")
    ] = "",
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
    from maloc._load import TrackOptions
    from maloc._points_run import PointsOptions, run_points
    from maloc._reading import Reading

    source = TrackOptions(
        detections=tuple(detections or ()),
        toa=toa,
        receivers=receivers,
        reading=Reading(format, tz, clock, tag_table),
        tags=tuple(tag or ()),
        sync=sync,
        reference=reference,
        sound_speed=sound_speed,
        ignore_columns=tuple(c.strip() for c in ignore_columns.split(",") if c.strip()),
        crs=crs,
        seed=seed,
    )
    asked = PointsOptions(source, method, sigma, depth, above, region, resolve, beacon_window)
    lines = run_points(asked, out, force=force, quiet=quiet)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


@app.command()
@_explained
def predict(
    run: Annotated[Path, typer.Argument(help="Folder that maloc track wrote.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    every: Annotated[float, typer.Option(metavar="S", help="Seconds from one time to the next.")],
    before: Annotated[
        float, typer.Option(metavar="S", help="How long before a tag's first ping to begin, s.")
    ] = 0.0,
    after: Annotated[
        float, typer.Option(metavar="S", help="How long after its last ping to end, s.")
    ] = 0.0,
    draws: Annotated[int, typer.Option(min=0, help="Whole tracks to write; 0 for none.")] = 100,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Predict tracks at regular times, by the movement model between the pings.

    Writes predicted.csv, draws.parquet (whole tracks), summary.json.
    """
    from maloc._predict_run import run_predict

    how: dict[str, Any] = {"draws": draws, "seed": seed, "force": force, "quiet": quiet}
    lines = run_predict(run, out, every, around=(before, after), **how)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


@app.command()
@_explained
def export(
    run: Annotated[Path, typer.Argument(help="Folder that maloc track or maloc predict wrote.")],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="csv, parquet, geojson, ellipses, geoparquet, gpx, movebank, crawl, imputations, "
            "netcdf or zarr.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="File to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier file.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a finished run as other programs read it."""
    from maloc._export_file import export_file

    line = export_file(run, to, out, force=force)
    if not quiet:
        typer.echo(line)


def main() -> None:
    """Entry point of the command `maloc`."""
    # tracing a model makes millions of short-lived objects; looking at them less often saves a
    # tenth of the time of a short run
    gc.set_threshold(100_000, 20, 20)
    try:
        app(prog_name="maloc")
    finally:
        gc.freeze()  # the interpreter's last look at them would take half a second
