"""The commands below `maloc study`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from maloc.cli.errors import OneLineGroup, explained
from maloc.cli.options import Quiet, Seed

__all__ = ["studies"]

studies = typer.Typer(
    cls=OneLineGroup, pretty_exceptions_enable=False, help="Repeat published simulation studies."
)


@studies.command("hostetter-royle")
@explained
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
    from maloc.simulate.hostetter_royle import Design
    from maloc.studies.hostetter_royle.study import Settings, run_study
    from maloc.studies.hostetter_royle.tables import report

    design = Design(tags=tags, side=side, duration=duration)
    settings = Settings(design, seed, draws, method=method)
    chosen = tuple(m.strip() for m in models.split(",") if m.strip())
    found = run_study(settings, datasets, out, models=chosen, workers=workers, quiet=quiet)
    typer.echo(report(found))


@studies.command("canal")
@explained
def canal(
    tracks: Annotated[int, typer.Option(min=1, help="Simulated tracks, each in every cell.")] = 2,
    missing: Annotated[
        str, typer.Option(metavar="P,P", help="Shares of missing arrivals.")
    ] = "0,0.5",
    late: Annotated[str, typer.Option(metavar="P,P", help="Shares of late arrivals.")] = "0,0.15",
    methods: Annotated[
        str,
        typer.Option(
            metavar="A,B",
            help="Of toa, yaps, nuts, hmc, joint, toa-known, pmc, consensus, ls, de, ek-toa, and "
            "the classical chain after ls or de: ls-three, ls-rts, ...",
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
    from maloc.studies.canal.run import CanalOptions, run

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
