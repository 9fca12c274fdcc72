"""The functions that read: a file, or a dataframe in place of one, to a container."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes, Schedule
    from maloc.data.detections import Detections
    from maloc.data.events import Events
    from maloc.data.positions import Positions
    from maloc.data.receivers import Receivers
    from maloc.data.tags import Tags
    from maloc.readers._how import Clock
    from maloc.readers._text import Table

__all__ = [
    "read_detections",
    "read_events",
    "read_positions",
    "read_receivers",
    "read_tags",
    "read_toa",
]


def read_detections(
    *paths: str | Path | Any,
    format: str | None = None,
    tz: str | None = None,
    clock: Clock | None = None,
) -> Detections:
    """Read detections from one or more files.

    CSV, Parquet or SQLite, plain, gzip'd or in a zip archive; exports of the same receivers may
    overlap.

    Parameters
    ----------
    *paths : str or Path
        Files; each one's format is found by its header. Receiver events of VUE may be among them.
        Or one dataframe in any of the layouts.
    format : str, optional
        Insist on a format: "vue", "vdat", "innovasea", "thelma", "lotek", "lotek-mdy",
        "lotek-dmy", "lotek-jsats", "kaltoa", "otn", "glatos", "etn", "plain" or "atlas".
    tz : str, optional
        Zone of local times, such as "Europe/Copenhagen" or "Etc/GMT-1"; files that say UTC do
        not need it.
    clock : {"device", "corrected", "linear"}, optional
        Of exports that hold the device's and a corrected time: the device's, the corrected one
        (and an error where it is lacking), or the device's corrected along lines between the
        comparisons of clocks that the logs hold. Default: the corrected one where there is one.

    Returns
    -------
    Detections
        In the order of the files; everything skipped or odd is in its `report`. Sensor values
        that say their unit are in ``extra["depth"]`` (m) and ``extra["temperature"]`` (C).

    Raises
    ------
    InputError
        If a file cannot be read or recognised, or a value in it is wrong: with file, line, column.
    """
    from maloc.data.tags import sensor_values
    from maloc.errors import InputError
    from maloc.readers._how import CLOCKS, How
    from maloc.readers._merge import merge, on_asked_clock, under_one_name
    from maloc.readers._recognise import read_files, recognise

    if not paths:
        raise InputError("no file of detections given")
    if clock not in (None, *CLOCKS):
        raise InputError(f"clock '{clock}' is not one of {', '.join(CLOCKS)}")
    if not isinstance(paths[0], (str, Path)):
        return recognise(_frame(*paths), format).read(How(tz, clock))
    found = read_files(paths, format, How(tz, clock))
    out = on_asked_clock(merge(found.detections), found.references, clock)
    return sensor_values(under_one_name(out))


def read_events(*paths: str | Path, tz: str | None = None) -> Events:
    """Read what receivers logged beside detections: VUE's events, Fathom/VDAT's other records.

    Parameters
    ----------
    *paths : str or Path
        Files.
    tz : str, optional
        Zone of local times.

    Returns
    -------
    Events
        In the order of the files.

    Raises
    ------
    InputError
        If a file holds no events.
    """
    from maloc.data.events import Events
    from maloc.errors import InputError
    from maloc.readers import vdat, vue_events
    from maloc.readers._files import load_all
    from maloc.readers._how import How
    from maloc.readers._text import table_of

    parts = []
    for file in (f for path in paths for f in load_all(path)):
        if vdat.sniff(file.data):
            parts.append(vdat.read_events(vdat.open_log(file)))
            continue
        table = table_of(file)
        if not vue_events.matches(table):
            raise table.error("no receiver events (VUE's events, or a Fathom/VDAT log)")
        parts.append(vue_events.read(table, How(tz)))
    if not parts:
        raise InputError("no file of receiver events given")
    return Events.concat(parts)


def read_tags(path: str | Path) -> Tags:
    """Read the table of tags, one row a code (CSV, Parquet).

    Parameters
    ----------
    path : str or Path
        The file. Columns: `tag` (code, with its code space there or in `codespace`), optional
        `animal` (codes of one animal make one track), `sensor` (depth, temperature), `slope`,
        `intercept` (value = slope * number + intercept), `min_delay`, `max_delay` (s), `start`,
        `end` (UTC); aliases are read.

    Returns
    -------
    Tags

    Raises
    ------
    InputError
        If a column or a value is missing or wrong, or a code is there twice.
    """
    from maloc.readers._text import read_table
    from maloc.readers.tags import read

    return read(read_table(path))


def read_positions(path: str | Path, crs: str | None = None, tz: str | None = None) -> Positions:
    """Read positions that others found, to compare tracks with.

    Parameters
    ----------
    path : str or Path
        VPS positions, ATLAS localizations, Movebank events, yaps's GPS table.
    crs : str, optional
        Frame, such as "EPSG:32617", to project longitude and latitude to.
    tz : str, optional
        Zone of times that name none; UTC when not given.

    Returns
    -------
    Positions

    Raises
    ------
    InputError
        If the header is none of these, or a value cannot be read.
    """
    from maloc.readers._how import How
    from maloc.readers._text import read_table
    from maloc.readers.positions import read

    found = read(read_table(path), How(tz))
    return found if crs is None else found.in_frame(crs)


def read_receivers(
    path: str | Path | Any, crs: str | None = None, position_sd: float | None = None
) -> Receivers:
    """Read the table of receivers, one row a deployment (CSV, Parquet, a sheet of a workbook).

    Parameters
    ----------
    path : str, Path or dataframe
        The file. Columns: `receiver` (serial or name), `x`, `y` (m) or `longitude`, `latitude`
        (degrees), optional `depth` (m, down), `sync_tag`, `start`, `end` (UTC), `sd` (m, of the
        place's error on each axis); aliases are read, and the deployment sheets of OTN, GLATOS,
        ETN and VPS projects.
    crs : str, optional
        Frame, such as "EPSG:32617": of x, y as they are, or to project longitude and latitude to
        (default: the UTM zone of the array's centre).
    position_sd : float, optional
        Standard deviation of the places' errors, m, where the table states none.

    Returns
    -------
    Receivers
        In the order of the table.

    Raises
    ------
    InputError
        If a column or a coordinate is missing, an sd is negative or missing, or deployments are
        impossible.
    """
    from maloc.readers._files import load, load_all
    from maloc.readers._text import table_of
    from maloc.readers.receivers import matches, receivers_from_table

    if not isinstance(path, (str, Path)):
        return receivers_from_table(_frame(path), crs, position_sd)
    files = load_all(path)
    if len(files) > 1:  # the sheet of a workbook, the member of an archive, that is one
        tables = [t for t in map(table_of, files) if matches(t)]
        if len(tables) == 1:
            return receivers_from_table(tables[0], crs, position_sd)
    return receivers_from_table(table_of(load(path)), crs, position_sd)


def read_toa(
    path: str | Path | Any,
    receivers: Receivers,
    *,
    ignore_columns: tuple[str, ...] | list[str] = (),
    sound_speed: float | None = None,
    schedule: Schedule | None = None,
    tag: object = None,
    origin: int | None = None,
) -> ArrivalTimes:
    """Read a matrix of arrival times, one row a ping and one column a receiver.

    Parameters
    ----------
    path : str, Path or dataframe
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
    origin : int, optional
        ns since 1970 UTC from which the seconds count; found where they are Unix seconds.

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
    from maloc.readers._text import read_table
    from maloc.readers.toa import toa_from_table

    return toa_from_table(
        read_table(path) if isinstance(path, (str, Path)) else _frame(path),
        receivers,
        ignore_columns=tuple(ignore_columns),
        sound_speed=sound_speed,
        schedule=schedule or Unknown(),
        tag=tag,
        origin=origin,
    )


def _frame(data: Any) -> Table:
    """A dataframe of any library as a table."""
    from maloc.data._arrays import frame
    from maloc.readers._text import from_frame

    return from_frame("dataframe", frame(data))
