"""Delimited text by columns: polars reads the cells, NumPy counts the fields of every line."""

from __future__ import annotations

import csv
import io
from typing import NamedTuple

import numpy as np
import polars as pl

from maloc.errors import InputError

__all__ = ["Lines", "read_lines"]

_NEWLINE, _QUOTE = 10, 34


class Lines(NamedTuple):
    """The rows under a header, blank lines left out.

    Parameters
    ----------
    header : list of str
        The cells of the header.
    cells : list of Series of text
        One a column of the header; "" where a row is too short.
    line : array (N,) of int64
        Line of the file, 1 = first.
    fields : array (N,) of int64
        How many fields the row has.
    beyond : list of list of str
        What stands beyond the header's columns, of the rows in `long`.
    long : array of int64
        Rows with more fields than the header.
    """

    header: list[str]
    cells: list[pl.Series]
    line: np.ndarray
    fields: np.ndarray
    beyond: list[list[str]]
    long: np.ndarray


def read_lines(name: str, data: bytes, first: int, delimiter: str) -> Lines:
    """Read UTF-8 text, newlines alone between its lines; its header is line `first` (0 = first).

    Raises
    ------
    InputError
        If quotes are broken.
    """
    ends = _ends(data)
    start = 0 if not first else int(ends[first - 1]) + 1
    quoted = b'"' in data[start:]
    if quoted and not _even(data, ends[first:], start):
        return _slow(name, data[start:], first, delimiter)
    fields = _count(data, ends[first:], start, delimiter, quoted)
    try:
        return _fast(data[start:], first, delimiter, fields, quoted)
    except pl.exceptions.PolarsError:
        return _slow(name, data[start:], first, delimiter)


def _ends(data: bytes) -> np.ndarray:
    """Where each line ends: positions of newlines, and of the end where the last has none."""
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == _NEWLINE)
    return ends if data.endswith(b"\n") else np.append(ends, len(data))


def _even(data: bytes, ends: np.ndarray, start: int) -> bool:
    """Whether each line has an even number of quotes, so that no field holds a line's end."""
    quotes = np.flatnonzero(np.frombuffer(data, np.uint8)[start:] == _QUOTE) + start
    return not (np.searchsorted(quotes, ends) % 2).any()


def _count(data: bytes, ends: np.ndarray, start: int, delimiter: str, quoted: bool) -> np.ndarray:
    """Fields of each line; delimiters inside quotes do not count."""
    raw = np.frombuffer(data, np.uint8)
    marks = np.flatnonzero(raw[start:] == ord(delimiter)) + start
    if quoted:
        quotes = np.flatnonzero(raw == _QUOTE)
        marks = marks[np.searchsorted(quotes, marks) % 2 == 0]
    return np.diff(np.searchsorted(marks, ends), prepend=0) + 1


def _fast(data: bytes, first: int, delimiter: str, fields: np.ndarray, quoted: bool) -> Lines:
    n = int(fields[0])
    table = pl.read_csv(
        io.BytesIO(data),
        has_header=False,  # the header is read as a row, and says how many columns there are
        infer_schema=False,
        separator=delimiter,
        quote_char='"' if quoted else None,
        truncate_ragged_lines=True,
    )
    if len(table) != len(fields) or table.width != n:
        raise pl.exceptions.ComputeError("lines are counted otherwise")
    cells = [c.str.strip_chars().fill_null("") for c in table.iter_columns()]
    header = [c[0] for c in cells]
    full = fields > 1
    if not full.all():
        full |= (cells[0] != "").to_numpy()
    full[0] = False
    line = np.flatnonzero(full) + first + 1
    keep = pl.Series(full)
    long = np.flatnonzero(fields[full] > n)
    beyond = []
    if len(long):
        lines = data.split(b"\n")
        rows = (lines[i - first - 1].decode() for i in line[long])
        beyond = [next(csv.reader([row], delimiter=delimiter))[n:] for row in rows]
    if full[1:].all():
        cells = [c.slice(1) for c in cells]
    else:
        cells = [c.filter(keep) for c in cells]
    return Lines(header, cells, line, fields[full], beyond, long)


def _slow(name: str, data: bytes, first: int, delimiter: str) -> Lines:
    """Fields that hold line ends, or broken quotes: row by row."""
    reader = csv.reader(io.StringIO(data.decode()), delimiter=delimiter, strict=True)
    rows, line, before = [], [], 0
    try:
        for row in reader:
            if row and (len(row) > 1 or row[0].strip()):
                rows.append([v.strip() for v in row])
                line.append(first + before + 1)
            before = reader.line_num
    except csv.Error as e:
        raise InputError(f"broken quotes ({e})", file=name, row=first + before + 1) from None
    header, rows = rows[0], rows[1:]
    fields = np.array([len(r) for r in rows], np.int64)
    n = len(header)
    columns = zip(*((r + [""] * n)[:n] for r in rows), strict=True) if rows else [()] * n
    cells = [pl.Series(list(c), dtype=pl.String) for c in columns]
    long = np.flatnonzero(fields > n)
    beyond = [rows[i][n:] for i in long]
    return Lines(header, cells, np.array(line[1:], np.int64), fields, beyond, long)
