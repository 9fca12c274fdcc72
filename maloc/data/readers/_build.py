"""From a cleaned table to Detections: what every format does alike, each step counted."""

from __future__ import annotations

import numpy as np
import polars as pl

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.data.readers._text import Table
from maloc.data.report import Note, ReadReport

WHOLE_SECONDS = (
    "times are whole seconds only: useless for sync and positions by arrival times (1 s = 1500 m), "
    "fine for who heard what (maloc track --model detections); VUE and Fathom write whole seconds "
    "unless 'millisecond time precision' is ticked at export"
)


def whole_seconds(time: np.ndarray) -> bool:
    """Say whether times (ns) were written without fractions; below three one cannot tell."""
    return len(time) > 2 and bool((time % NS == 0).all())


def clean(table: Table, required: list[int]) -> Table:
    """Drop blank rows, pasted second headers and incomplete rows; each kind is noted with lines.

    Raises
    ------
    InputError
        If no row is complete, or a second header with other columns is in the middle.
    """
    n = len(table)
    if not n:
        return table
    blank = np.ones(n, bool)
    for k in range(len(table.cells)):
        blank &= table.text(k).is_null().to_numpy()
    again = _headers(table)
    cut = np.zeros(n, bool)
    cut[-1] = table.cut_last and not again[-1]
    missing = np.zeros(n, bool)
    for k in required:
        missing |= table.text(k).is_null().to_numpy()
    bad = (missing | cut) & ~again & ~blank
    notes = []
    if again.any():
        count = int(again.sum())
        text = f"{count} repeated header line{'s' * (count != 1)} skipped ({lines(table, again)})"
        notes.append(table.note("info", text, count, int(table.line[again][0])))
    if bad.any():
        count = int(bad.sum())
        if count == int((~again & ~blank).sum()) and count > 1:
            names = ", ".join(table.columns[k] for k in required)
            raise table.error(f"no row has all of {names}", int(np.flatnonzero(bad)[0]))
        text = f"{count} incomplete row{'s' * (count != 1)} left out ({lines(table, bad)})"
        notes.append(table.note("warning", text, count, int(table.line[bad][0])))
    return table.rows(~(again | bad | blank), *notes)


def _headers(table: Table) -> np.ndarray:
    if table.typed:
        return np.zeros(len(table), bool)
    named = next((k for k, c in enumerate(table.columns) if c), 0)
    like = (table.cells[named] == table.columns[named]).to_numpy()
    for i in np.flatnonzero(like):
        row = [c[int(i)].strip("\"'") for c in table.cells]
        if row != [c.strip("\"'") for c in table.columns]:
            raise table.error(
                "another header with other columns", int(i), mend="split the file there"
            )
    return like


def lines(table: Table, where: np.ndarray, most: int = 5) -> str:
    """Return "line 22" or "lines 3, 9, 12, ..."."""
    found = table.line[where]
    word = "row" if table.typed else "line"
    listed = ", ".join(map(str, found[:most])) + (", ..." if len(found) > most else "")
    return f"{word}{'s' * (len(found) != 1)} {listed}"


def detections(
    table: Table,
    format: str,
    time: np.ndarray,
    receiver: pl.Series,
    tag: pl.Series,
    extra: dict[str, np.ndarray],
) -> Detections:
    """Return Detections with exact duplicates removed and whole-second times pointed out."""
    notes = list(table.notes)
    for column, ids in (("receiver", receiver), ("tag", tag)):
        damaged = ids.str.contains(r"^\d(?:\.\d+)?[eE]\+\d+$").fill_null(False)
        if damaged.any():
            i = int(damaged.arg_true()[0])
            raise table.error(
                f"{column} id '{ids[i]}' lost digits (re-saved by Excel?)",
                i,
                column,
                "export again",
            )
    if len(table):
        cells = pl.DataFrame([c.alias(str(k)) for k, c in enumerate(table.cells)])
        first = cells.select(pl.struct(pl.all()).is_first_distinct()).to_series().to_numpy()
        if gone := int((~first).sum()):
            text = f"{gone} exact duplicate{'s' * (gone != 1)} removed"
            notes.append(table.note("info", text, gone, int(table.line[~first][0])))
        keep = pl.Series(first)
        time, receiver, tag = time[first], receiver.filter(keep), tag.filter(keep)
        extra = {name: values[first] for name, values in extra.items()}
    else:
        notes.append(table.note("warning", "no detections, only a header", 0))
    if whole_seconds(time):
        notes.append(table.note("warning", WHOLE_SECONDS, len(time)))
    report = ReadReport(format, (table.file,), len(time), tuple(notes))
    who, which = (np.asarray(s.to_list(), dtype=str) for s in (receiver, tag))
    return Detections(time, who, which, extra, report)


def extras(table: Table, columns: dict[str, int], missing: tuple[str, ...] = ()) -> dict:
    """Return optional columns that hold anything: numbers where all are numbers, else text."""
    out = {}
    for name, k in columns.items():
        values = table.text(k)
        if missing:
            values = pl.select(pl.when(~values.is_in(list(missing))).then(values)).to_series()
        if values.null_count() == len(values):
            continue
        if values.cast(pl.Float64, strict=False).null_count() == values.null_count() or (
            table.delimiter != "," and values.drop_nulls().str.contains(r"^[+-]?\d+,\d+$").all()
        ):
            out[name] = table.numbers(k, missing)
        else:
            out[name] = values.to_numpy().astype(object)
    return out


def merge_notes(table: Table, *notes: Note) -> Table:
    """Return the table with further notes."""
    return table.rows(np.ones(len(table), bool), *notes)
