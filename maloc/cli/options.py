"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

__all__ = [
    "Clock",
    "Crs",
    "Detections",
    "Force",
    "Format",
    "IgnoreColumns",
    "Out",
    "Quiet",
    "ReceiverSd",
    "ReceiverTable",
    "Reference",
    "Scheduler",
    "Seed",
    "SpeedSd",
    "TagTable",
    "Tags",
    "Toa",
    "Workers",
    "Zone",
]

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

ReceiverTable = Annotated[Path, typer.Option("--receivers", help="The table of receivers.")]
ReceiverSd = Annotated[
    float | None,
    typer.Option(
        "--receiver-sd",
        metavar="M",
        help="Error (sd) of receivers' places, m, if the table has none.",
    ),
]
SpeedSd = Annotated[
    str | None,
    typer.Option(
        "--sound-speed-sd",
        metavar="S|exact",
        help="Error (sd) of the sound speed given, m/s; by default 3, or as a table has it.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Folder to write.")]
Detections = Annotated[
    list[Path] | None, typer.Argument(help="Files of detections (or give --toa).")
]
Toa = Annotated[Path | None, typer.Option("--toa", help="Matrix of arrival times, one row a ping.")]
Tags = Annotated[
    list[str] | None,
    typer.Option(
        "--tag",
        help="Tag; several times for several; all: every one but sync tags, as if none is given.",
    ),
]
Reference = Annotated[
    str | None, typer.Option("--reference", help="Receiver whose clock is the common time.")
]
IgnoreColumns = Annotated[
    str,
    typer.Option("--ignore-columns", metavar="A,B", help="Columns of the TOA matrix left alone."),
]
Workers = Annotated[
    int,
    typer.Option("--workers", min=1, help="Processes for several tags (needs maloc[parallel])."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler, in place of --workers."),
]
