"""Which format a file is, by its header; files known to be something else are refused by name."""

from __future__ import annotations

from pathlib import Path

from maloc.data.detections import Detections
from maloc.data.readers import atlas, kaltoa, plain, thelma, vue
from maloc.data.readers._text import Table, from_frame, load, read_table
from maloc.errors import InputError

FORMATS = (vue, thelma, kaltoa, plain)
NAMES = (*(f.NAME for f in FORMATS), atlas.NAME)


def known_formats() -> str:
    """Return the formats that are read, in words."""
    return "; ".join([*(f.TITLE for f in FORMATS), atlas.TITLE])


def recognise(table: Table, format: str | None = None):
    """Return the reader module of a table.

    Raises
    ------
    InputError
        If the header fits no format (it is listed, with the formats known).
    """
    if format is not None:
        chosen = next((f for f in FORMATS if f.NAME == format), None)
        if chosen is None or not chosen.matches(table):
            names = ", ".join(NAMES)
            why = f"the header does not fit format '{format}'" if chosen else "unknown format"
            raise table.error(f"{why} (formats: {names}); {_header(table)}")
        return chosen
    if vue.is_events(table):
        raise table.error(
            "VUE receiver events, not detections", mend="give the detections export of VUE"
        )
    for f in FORMATS:
        if f.matches(table):
            return f
    raise table.error(f"unknown header, {_header(table)}; formats known: {known_formats()}")


def _header(table: Table) -> str:
    return "header found: " + ", ".join(c or "(no name)" for c in table.columns[:40])


def read_file(path: str | Path, format: str | None = None, tz: str | None = None) -> Detections:
    """Read one file of detections in any known format."""
    if format is not None and format not in NAMES:
        raise InputError(f"format '{format}' is not one of {', '.join(NAMES)}")
    name, data = load(path)
    if data.startswith(atlas.MAGIC):
        return atlas.read_file(path)
    if format == atlas.NAME:
        raise InputError("not an SQLite file", file=name)
    table = read_table(path)
    return recognise(table, format).read(table, tz)


def read_frame(df, name: str = "dataframe", tz: str | None = None) -> Detections:
    """Read detections from a polars DataFrame in any known layout."""
    table = from_frame(name, df)
    return recognise(table).read(table, tz)
