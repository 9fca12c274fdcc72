"""The command line: parse, call, write. Heavy imports happen inside the commands."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from maloc.cli.errors import BAD_INPUT, OneLineGroup, explained, fail
from maloc.cli.halves import halves
from maloc.cli.options import (
    Clock,
    Crs,
    Force,
    Format,
    Out,
    Quiet,
    ReceiverSd,
    Reference,
    Seed,
    SpeedSd,
    TagTable,
    Zone,
)
from maloc.cli.studies import studies
from maloc.cli.tracks import points, track

__all__ = ["app", "main"]

app = typer.Typer(
    cls=OneLineGroup,
    add_completion=False,
    pretty_exceptions_enable=False,
    invoke_without_command=True,
    help="Where tagged animals were: tracks with honest uncertainty from acoustic receivers.",
)
app.add_typer(studies, name="study")


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version.")] = False,
) -> None:
    if version:
        from maloc._package.version import __version__

        typer.echo(f"maloc {__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
@explained
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
    from maloc.readers.check import check as check_files

    found = check_files(files, receivers, tz, format=format, clock=clock)
    typer.echo(str(found))
    if not found.ok:
        first = found.errors[0]
        more = f" (and {len(found.errors) - 1} more)" if len(found.errors) > 1 else ""
        raise typer.Exit(fail(f"{first}{more}".removeprefix("error: "), BAD_INPUT))


@app.command()
@explained
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
    from maloc.export.folder import check_free

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
@explained
def sync(
    detections: Annotated[list[Path], typer.Argument(help="Files of raw detections.")],
    receivers: Annotated[Path, typer.Option(help="The table of receivers, with sync tags.")],
    out: Out,
    reference: Reference = None,
    sound_speed: Annotated[
        str | None,
        typer.Option(
            metavar="C|constant|TABLE.csv",
            help="m/s; estimated, as one number; of the water's state. Left out: it may vary.",
        ),
    ] = None,
    sound_speed_sd: SpeedSd = None,
    receiver_sd: ReceiverSd = None,
    anchors: Annotated[
        Path | None,
        typer.Option(
            metavar="TABLE.csv|EVENTS", help="Moments of known true time: receiver, recorded, true."
        ),
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
    from maloc.runs.reading import Reading
    from maloc.runs.sync import run_sync

    reading = Reading(format, tz, clock, tag_table)
    asked: dict[str, Any] = {"reference": reference, "sound_speed": sound_speed}
    asked |= {"sound_speed_sd": sound_speed_sd, "receiver_sd": receiver_sd}
    how: dict[str, Any] = {"anchors": anchors, "crs": crs, "seed": seed, "reading": reading}
    found = run_sync(detections, receivers, out, **asked, **how, force=force, quiet=quiet)
    if not quiet:
        typer.echo(f"{found.summary()}\nwritten to {out}")


app.command()(track)
app.command()(points)
app.command()(halves)


@app.command()
@explained
def predict(
    run: Annotated[Path, typer.Argument(help="Folder that maloc track wrote.")],
    out: Out,
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
    from maloc.runs.predict import run_predict

    how: dict[str, Any] = {"draws": draws, "seed": seed, "force": force, "quiet": quiet}
    lines = run_predict(run, out, every, around=(before, after), **how)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))


@app.command()
@explained
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
    from maloc.export.file import export_file

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
