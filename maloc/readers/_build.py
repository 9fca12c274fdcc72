"""From a cleaned table to Detections: what every format does alike, each step counted."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import polars as pl

from maloc.data import _arrays
from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.data.report import Note, ReadReport
from maloc.readers._text import Table, without

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
    if not len(table):
        return table
    table = _without_units(table, required[0])
    if not len(table):
        return table
    n, again = len(table), _headers(table)
    cut = np.zeros(n, bool)
    cut[-1] = table.cut_last and not again[-1]
    missing = np.zeros(n, bool)
    for k in required:
        missing |= table.text(k).is_null().to_numpy()
    if not (missing.any() or cut.any() or again.any()):
        return table
    blank = missing.copy()
    for k in range(len(table.cells)):
        blank &= table.text(k).is_null().to_numpy()
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


def _without_units(table: Table, k: int) -> Table:
    """Drop a line of units under the header (ERDDAP)."""
    if table.typed or str(table.cells[k][0]) not in ("UTC", "GMT"):
        return table
    keep = np.arange(len(table)) > 0
    return table.rows(keep, table.note("info", "line of units skipped", 1, int(table.line[0])))


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


class Ids(NamedTuple):
    """Text that repeats: the different names, and which one each row has (-1 = missing)."""

    names: list[str]
    code: np.ndarray

    @classmethod
    def of(cls, cell: pl.Series) -> Ids:
        """Find the different names in a column."""
        names = cell.drop_nulls().unique(maintain_order=True).to_list()
        numbers = range(len(names))
        code = cell.replace_strict(names, numbers, default=-1, return_dtype=pl.Int64)
        return cls(names, code.to_numpy())

    @classmethod
    def merged(cls, names: list[str], code: np.ndarray) -> Ids:
        """Give names that are the same one number."""
        number = {n: i for i, n in enumerate(dict.fromkeys(names))}
        if len(number) == len(names):
            return cls(names, code)
        return cls(list(number), np.array([*(number[n] for n in names), -1])[code])

    def to(self, change: Callable[[str], str]) -> Ids:
        """Change every name."""
        return Ids.merged([change(n) for n in self.names], self.code)

    def where(self, keep: np.ndarray) -> Ids:
        """Return the rows where `keep` is true."""
        return Ids(self.names, self.code[keep])

    def array(self) -> np.ndarray:
        """Return the name of each row (N,), text."""
        return np.array(self.names or [""], dtype=str)[self.code]

    def objects(self) -> np.ndarray:
        """Return the name of each row (N,), None where missing."""
        return np.array([*self.names, None], dtype=object)[self.code]

    def present(self) -> tuple[str, ...]:
        """The names that rows have, sorted."""
        there = np.bincount(self.code, minlength=len(self.names)) > 0
        return tuple(sorted(n for n, yes in zip(self.names, there, strict=True) if yes))

    def join(self, other: Ids, separator: str = "-") -> Ids:
        """Return "a-b" of two columns that have no missing values."""
        pair, code = np.unique(self.code * (len(other.names) + 1) + other.code, return_inverse=True)
        a, b = np.divmod(pair, len(other.names) + 1)
        joined = [f"{self.names[i]}{separator}{other.names[j]}" for i, j in zip(a, b, strict=True)]
        return Ids.merged(joined, code)


def detections(
    table: Table,
    format: str,
    time: np.ndarray,
    receiver: Ids,
    tag: Ids,
    extra: dict[str, np.ndarray],
    used: Iterable[int] | None = None,
) -> Detections:
    """Return Detections with duplicates removed and whole-second times pointed out.

    `used`: the columns that were read; others that hold anything are noted.
    """
    notes = list(table.notes)
    if used is not None:
        notes += unused(table, used)
    for column, ids in (("receiver", receiver), ("tag", tag)):
        for number, name in enumerate(ids.names):
            if re.match(r"^\d(?:\.\d+)?[eE]\+\d+$", name):
                raise table.error(
                    f"{column} id '{name}' lost digits (re-saved by Excel?)",
                    int(np.flatnonzero(ids.code == number)[0]),
                    column,
                    "export again",
                )
    if len(table):
        first = _arrays.first_of_each(time, receiver.code, tag.code)
        if not first.all():
            notes += _duplicates(table, first)
            time, receiver, tag = time[first], receiver.where(first), tag.where(first)
            extra = {name: values[first] for name, values in extra.items()}
    else:
        notes.append(table.note("warning", "no detections, only a header", 0))
    if whole_seconds(time):
        notes.append(table.note("warning", WHOLE_SECONDS, len(time)))
    report = ReadReport(format, (table.file,), len(time), tuple(notes))
    out = Detections(time, receiver.array(), tag.array(), extra, report)
    # known already: looking for them again among a million would take a third of a second each
    vars(out)["receivers"], vars(out)["tags"] = receiver.present(), tag.present()
    return out


def _duplicates(table: Table, first: np.ndarray) -> list[Note]:
    """Say how many detections are there again, and how many with other values beside them."""
    cells = pl.DataFrame([c.alias(str(k)) for k, c in enumerate(table.cells)])
    again = ~cells.select(pl.struct(pl.all()).is_first_distinct()).to_series().to_numpy()
    notes = []
    for gone, level, words in (
        (~first & again, "info", "exact duplicate{s} removed"),
        (~first & ~again, "warning", "detection{s} there again with other values in further "
         "columns: the first is kept"),
    ):  # fmt: skip
        if count := int(gone.sum()):
            text = f"{count} {words.format(s='s' * (count != 1))}"
            if level == "warning":
                text += f" ({lines(table, gone)})"
            notes.append(table.note(level, text, count, int(table.line[gone][0])))
    return notes


def unused(table: Table, used: Iterable[int]) -> list[Note]:
    """Name the columns that hold something and were not read."""
    used = set(used)
    rest = [
        c or f"(column {k + 1})"
        for k, c in enumerate(table.columns)
        if k not in used and len(table) and not table.empty(k)
    ]
    if not rest:
        return []
    listed = ", ".join(rest[:12]) + (", ..." if len(rest) > 12 else "")
    return [table.note("info", f"columns not used: {listed}", len(rest))]


def extras(table: Table, columns: dict[str, int], missing: tuple[str, ...] = ()) -> dict:
    """Return optional columns that hold anything: numbers where all are numbers, else text."""
    out = {}
    for name, k in columns.items():
        if table.empty(k):
            continue
        values = without(table.text(k), missing)
        if values.null_count() == len(values):
            continue
        if values.cast(pl.Float64, strict=False).null_count() == values.null_count() or (
            table.delimiter != "," and values.drop_nulls().str.contains(r"^[+-]?\d+,\d+$").all()
        ):
            out[name] = table.numbers(k, missing)
        else:
            out[name] = Ids.of(values).objects()
    return out


def merge_notes(table: Table, *notes: Note) -> Table:
    """Return the table with further notes."""
    return table.rows(np.ones(len(table), bool), *notes)
