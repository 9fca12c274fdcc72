"""Readers: one file a format, found by the header."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes, Schedule
    from maloc.data.detections import Detections
    from maloc.data.receivers import Receivers

__all__ = ["read_detections", "read_receivers", "read_toa"]


def read_detections(
    *paths: str | Path, format: str | None = None, tz: str | None = None
) -> Detections:
    """Read detections from one or more files (CSV, gzip'd CSV, Parquet, SQLite).

    Parameters
    ----------
    *paths : str or Path
        Files; each one's format is found by its header.
    format : {"vue", "thelma", "kaltoa", "plain", "atlas"}, optional
        Insist on a format.
    tz : str, optional
        Zone of local times, such as "Europe/Copenhagen" or "Etc/GMT-1"; files that say UTC do
        not need it.

    Returns
    -------
    Detections
        In the order of the files; everything skipped or odd is in its `report`.

    Raises
    ------
    InputError
        If a file cannot be read or recognised, or a value in it is wrong: with file, line, column.
    """
    from maloc.data.detections import Detections
    from maloc.data.readers._recognise import read_file
    from maloc.errors import InputError

    if not paths:
        raise InputError("no file of detections given")
    return Detections.concat([read_file(p, format, tz) for p in paths])


def read_receivers(path: str | Path, crs: str | None = None) -> Receivers:
    """Read the table of receivers, one row a deployment (CSV, gzip'd CSV, Parquet).

    Parameters
    ----------
    path : str or Path
        The file. Columns: `receiver` (serial or name), `x`, `y` (m) or `longitude`, `latitude`
        (degrees), optional `depth` (m, down), `sync_tag`, `start`, `end` (UTC); aliases are read.
    crs : str, optional
        Frame, such as "EPSG:32617": of x, y as they are, or to project longitude and latitude to
        (default: the UTM zone of the array's centre).

    Returns
    -------
    Receivers
        In the order of the table.

    Raises
    ------
    InputError
        If a column or a coordinate is missing, or deployments are impossible.
    """
    from maloc.data.readers._text import read_table
    from maloc.data.readers.receivers import receivers_from_table

    return receivers_from_table(read_table(path), crs=crs)


def read_toa(
    path: str | Path,
    receivers: Receivers,
    *,
    ignore_columns: tuple[str, ...] | list[str] = (),
    sound_speed: float | None = None,
    schedule: Schedule | None = None,
    tag: object = None,
) -> ArrivalTimes:
    """Read a matrix of arrival times, one row a ping and one column a receiver.

    Parameters
    ----------
    path : str or Path
        The file (CSV, gzip'd CSV, Parquet). Columns named as in the receivers table (a prefix
        `toa_` is accepted), seconds on one clock, blank = not heard; optional `ping`, `tag`,
        `sound_speed` or `ss` (m/s), `depth` (m).
    receivers : Receivers
        The array; columns are matched by name, never by position.
    ignore_columns : sequence of str
        Columns to leave alone.
    sound_speed : float, optional
        m/s; goes before a column. 1500, with a warning, when neither is there.
    schedule : Schedule, optional
        What is known of the burst interval.
    tag : str, optional
        Which tag, where the file holds several.

    Returns
    -------
    ArrivalTimes
        Columns in the order of the receivers table; pings that nobody heard are kept.

    Raises
    ------
    InputError
        If a column is neither a receiver nor known, a value is no number, or the pings are not in
        time order or duplicated.
    """
    from maloc.data.arrivals import Schedule as Unknown
    from maloc.data.readers._text import read_table
    from maloc.data.readers.toa import toa_from_table

    return toa_from_table(
        read_table(path),
        receivers,
        ignore_columns=tuple(ignore_columns),
        sound_speed=sound_speed,
        schedule=schedule or Unknown(),
        tag=tag,
    )
