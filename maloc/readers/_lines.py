"""Delimited text by columns: polars reads the cells, NumPy counts fields where it matters."""

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
    long : dict of int to list of str
        Rows with more fields than the header, and what stands beyond it.
    cut : bool
        Whether the last line has no end and fewer fields than any other.
    """

    header: list[str]
    cells: list[pl.Series]
    line: np.ndarray
    long: dict[int, list[str]]
    cut: bool


def read_lines(name: str, data: bytes, first: int, delimiter: str) -> Lines:
    """Read UTF-8 text whose first line is the header and line `first` (0 = first) of the file.

    Raises
    ------
    InputError
        If quotes are broken.
    """
    quoted = b'"' in data
    if quoted and not _even(data):
        return _slow(name, data, first, delimiter)
    try:
        return _fast(data, first, delimiter, quoted)
    except pl.exceptions.PolarsError:
        return _slow(name, data, first, delimiter)


def _ends(data: bytes) -> np.ndarray:
    """Where each line ends: positions of newlines, and of the end where the last has none."""
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == _NEWLINE)
    return ends if data.endswith(b"\n") else np.append(ends, len(data))


def _even(data: bytes) -> bool:
    """Whether each line has an even number of quotes, so that no field holds a line's end."""
    quotes = np.flatnonzero(np.frombuffer(data, np.uint8) == _QUOTE)
    return not (np.searchsorted(quotes, _ends(data)) % 2).any()


def _count(data: bytes, delimiter: str, quoted: bool) -> np.ndarray:
    """Fields of each line; delimiters inside quotes do not count."""
    raw = np.frombuffer(data, np.uint8)
    marks = np.flatnonzero(raw == ord(delimiter))
    if quoted:
        quotes = np.flatnonzero(raw == _QUOTE)
        marks = marks[np.searchsorted(quotes, marks) % 2 == 0]
    return np.diff(np.searchsorted(marks, _ends(data)), prepend=0) + 1


def _fast(data: bytes, first: int, delimiter: str, quoted: bool) -> Lines:
    how = {
        "has_header": False,  # read as a row, it says how many columns there are
        "infer_schema": False,
        "separator": delimiter,
        "quote_char": '"' if quoted else None,
    }
    fields = None
    try:
        table = pl.read_csv(io.BytesIO(data), **how)
    except pl.exceptions.PolarsError:  # rows longer than the header, or something worse
        table = pl.read_csv(io.BytesIO(data), **how, truncate_ragged_lines=True)
        fields = _count(data, delimiter, quoted)
    bare = _no_padding(data, delimiter, table.to_series(0))
    cells = [_filled(c if bare else c.str.strip_chars()) for c in table.iter_columns()]
    header = [c[0].strip() for c in cells]
    blank = cells[0] == ""
    if fields is None and (blank.any() or not data.endswith(b"\n") or len(header) == 1):
        fields = _count(data, delimiter, quoted)
    if fields is None:
        line = np.arange(first + 2, first + 1 + len(table))
        return Lines(header, [c.slice(1) for c in cells], line, {}, False)
    if len(table) != len(fields) or table.width != fields[0]:
        raise pl.exceptions.ComputeError("lines are counted otherwise")
    full = (fields > 1) | ~blank.to_numpy()
    full[0] = False
    line, fields = np.flatnonzero(full) + first + 1, fields[full]
    cells = [c.filter(pl.Series(full)) for c in cells]
    n, long = len(header), {}
    if len(rows := np.flatnonzero(fields > n)):
        lines = data.split(b"\n")
        for i in map(int, rows):
            text = lines[line[i] - first - 1].decode()
            long[i] = next(csv.reader([text], delimiter=delimiter))[n:]
    return Lines(header, cells, line, long, _cut(data.endswith(b"\n"), fields, n))


def _no_padding(data: bytes, delimiter: str, column: pl.Series) -> bool:
    """Whether no cell below the header begins or ends with white space."""
    if not data.isascii():
        return False
    if not any(mark in data for mark in (b"\t", b"\x0b", b"\x0c", b"\r")):
        spaces, body = data.count(b" ", data.find(b"\n") + 1), column.slice(1)
        if not spaces:
            return True
        # a date and time in the first column has one inside, and there are no others
        inside = body.str.slice(10, 1) == " "
        if spaces == len(body) and not body.null_count() and inside.all():
            return bool((body.str.len_bytes() > 11).all())
    raw = np.frombuffer(data, np.uint8)
    space = np.flatnonzero((raw == ord(" ")) | ((raw < ord(" ")) & (raw != _NEWLINE)))
    edge = np.zeros(256, bool)
    edge[[ord(delimiter), _NEWLINE, _QUOTE]] = True
    edge[9:14] = edge[32] = True
    first_or_last = len(space) and (space[0] == 0 or space[-1] == len(raw) - 1)
    return not first_or_last and not (edge[raw[space - 1]] | edge[raw[space + 1]]).any()


def _filled(cell: pl.Series) -> pl.Series:
    """Text with "" for missing."""
    n = cell.null_count()
    if n == len(cell):
        return pl.Series(cell.name, [""]).new_from_index(0, n)
    return cell.fill_null("") if n else cell


def _cut(ended: bool, fields: np.ndarray, n: int) -> bool:
    if ended or not len(fields):
        return False
    if len(fields) == 1:
        return int(fields[0]) < min(n, 3)
    return bool(fields[-1] < fields[:-1].min())


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
    n = len(header)
    columns = zip(*((r + [""] * n)[:n] for r in rows), strict=True) if rows else [()] * n
    cells = [pl.Series(list(c), dtype=pl.String) for c in columns]
    long = {i: r[n:] for i, r in enumerate(rows) if len(r) > n}
    fields = np.array([len(r) for r in rows], np.int64)
    line = np.array(line[1:], np.int64)
    return Lines(header, cells, line, long, _cut(data.endswith(b"\n"), fields, n))
