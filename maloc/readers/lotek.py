"""Lotek's JSATS table (WHS4000): receiver, Excel date, fraction of the second, tag, power.

The words of its header were never seen, so that it is known by its contents: six columns, of which
the first names a receiver WHS..., and the second is a date as Excel counts it.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._how import How
from maloc.readers._text import Table
from maloc.readers.vue import serial_number

__all__ = ["NAME", "TITLE", "matches", "read"]

NAME = "lotek-jsats"
TITLE = "Lotek JSATS CSV (WHS4K receiver, Excel date, fraction of a second, tag, tag hex, power)"
_EPOCH_DAYS = 25569  # from 1899-12-30 to 1970-01-01
_RECEIVER = r"^WHS\d"


def matches(table: Table) -> bool:
    """Say whether the first row, or the header itself, looks like a detection."""
    if len(table.columns) != 6 or table.typed:
        return False
    first = pl.Series([*table.cells[0].head(1), table.columns[0]], dtype=pl.String)
    return bool(first.str.contains(_RECEIVER).any())


def read(table: Table, how: How) -> Detections:
    """Read a table of JSATS detections.

    The date is good to the second only: it is rounded, and the fraction is added to it.

    Raises
    ------
    InputError
        If `how.tz` is not given (dates are local times of whoever exported them), or a value
        cannot be read.
    """
    if how.tz is None:
        raise table.error(
            "its dates are local times, and the file does not say of which zone",
            mend="say it with --tz UTC or --tz Europe/Copenhagen (tz= in Python)",
        )
    if pl.Series([table.columns[0]]).str.contains(_RECEIVER).item():
        table = _with_first_row(table)
    table = _build.clean(table, [0, 1, 2, 3])
    days, fraction = table.numbers(1), _clock.seconds(table, 2)[0]
    local = np.rint((days - _EPOCH_DAYS) * 86400).astype(np.int64)
    bad = np.flatnonzero((local < 0) | (local >= _clock.LATEST_S))
    if len(bad):
        raise table.error("not a date as Excel counts days", int(bad[0]), table.columns[1])
    bad = np.flatnonzero((fraction < 0) | (fraction >= NS))
    if len(bad):
        raise table.error("not a fraction of a second", int(bad[0]), table.columns[2])
    nothing = pl.Series([None] * len(table), dtype=pl.String)
    utc = _clock.to_utc(table, local, nothing, np.ones(len(table), bool), 1, how.tz)
    full = Ids.of(table.text(0))
    extra = _build.extras(table, {"tag_hex": 4, "power": 5})
    extra["model"] = full.to(lambda name: name.rpartition("-")[0]).objects()
    time, tag = utc * NS + fraction, Ids.of(table.text(3))
    return _build.detections(table, TITLE, time, full.to(serial_number), tag, extra)


def _with_first_row(table: Table) -> Table:
    """A file without a header: what was taken for one is its first row."""
    cells = tuple(
        pl.concat([pl.Series([name], dtype=pl.String), cell.alias("")])
        for name, cell in zip(table.columns, table.cells, strict=True)
    )
    names = ("receiver", "date", "fraction", "tag", "tag hex", "power")
    line = np.concatenate([[1], table.line])
    return Table(table.file, names, cells, line, table.delimiter, table.notes, table.cut_last)
