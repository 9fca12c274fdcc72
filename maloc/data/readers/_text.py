"""Files as tables of text: bytes, encodings, delimiters and line numbers, but no meaning yet."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from maloc.data.report import Note
from maloc.errors import InputError

MISSING = ("", "NA", "N/A", "NaN", "nan", "NAN", "NaT", "null", "NULL", "None")
DELIMITERS = (",", ";", "\t", "|")


@dataclass(frozen=True, eq=False)
class Table:
    """One header and its rows; every cell is text (null = missing) unless the file was typed."""

    file: str
    columns: tuple[str, ...]
    cells: tuple[pl.Series, ...]
    line: np.ndarray  # line of the file of each row, 1 = first
    delimiter: str = ","
    notes: tuple[Note, ...] = ()
    cut_last: bool = False  # the last line has no end and fewer fields than any other
    typed: bool = field(default=False)

    def __len__(self) -> int:
        return len(self.line)

    def rows(self, keep: np.ndarray, *notes: Note) -> Table:
        """Return the rows where `keep` is true, with further notes."""
        mask = pl.Series(keep)
        cells = tuple(c.filter(mask) for c in self.cells)
        more = (*self.notes, *notes)
        return Table(
            self.file, self.columns, cells, self.line[keep], self.delimiter, more, False, self.typed
        )

    def error(
        self, problem: str, i: int | None = None, column: str | None = None, mend: str | None = None
    ) -> InputError:
        """Return an InputError that names this file and the line of row `i`."""
        row = None if i is None else int(self.line[i])
        return InputError(problem, file=self.file, row=row, column=column, mend=mend)

    def note(self, level: str, text: str, count: int = 1, row: int | None = None) -> Note:
        """Return a note about this file."""
        return Note(level, text, count, self.file, row)

    def text(self, k: int) -> pl.Series:
        """Column `k` as text, missing values null."""
        cell = self.cells[k]
        if cell.dtype != pl.String:
            if cell.dtype.is_float() and (cell.drop_nulls() % 1 == 0).all():
                cell = cell.cast(pl.Int64, strict=False)
            cell = cell.cast(pl.String)
        return pl.select(pl.when(~cell.is_in(list(MISSING))).then(cell)).to_series()

    def numbers(self, k: int, missing: tuple[str, ...] = ()) -> np.ndarray:
        """Column `k` as float64, missing values NaN; anything that is no number is an error."""
        cell = self.cells[k]
        if cell.dtype.is_numeric():
            out = cell.cast(pl.Float64).fill_null(np.nan).to_numpy()
            return self._finite(out, k)
        cell = self.text(k)
        if missing:
            cell = pl.select(pl.when(~cell.is_in(list(missing))).then(cell)).to_series()
        if self.delimiter != "," and cell.str.contains(",", literal=True).any():
            self._one_decimal_mark(cell, k)
            cell = cell.str.replace(",", ".", literal=True)
        out = cell.cast(pl.Float64, strict=False)
        bad = (out.is_null() & cell.is_not_null()).arg_true()
        if len(bad):
            i = int(bad[0])
            raise self.error(f"'{cell[i]}' is not a number", i, self.columns[k])
        return self._finite(out.fill_null(np.nan).to_numpy(), k)

    def _finite(self, out: np.ndarray, k: int) -> np.ndarray:
        bad = np.flatnonzero(np.isinf(out))
        if len(bad):
            raise self.error("a number is infinite", int(bad[0]), self.columns[k])
        return out

    def _one_decimal_mark(self, cell: pl.Series, k: int) -> None:
        both = cell.str.contains(".", literal=True).fill_null(False)
        if both.any():
            i = int(both.arg_true()[0])
            raise self.error(
                f"'{cell[i]}': decimal commas and decimal points in one column",
                i,
                self.columns[k],
                "write every number with a point",
            )


def load(path: str | Path) -> tuple[str, bytes]:
    """Return the name of a file and its bytes, unzipped when it is gzip'd.

    Raises
    ------
    InputError
        If it is missing, empty, or a broken archive.
    """
    path = Path(path)
    name = str(path)
    try:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
    except FileNotFoundError:
        raise InputError("no such file", file=name) from None
    except IsADirectoryError:
        raise InputError("is a folder, a file is expected", file=name) from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as e:
        raise InputError(f"broken gzip file ({e})", file=name) from None
    except OSError as e:
        raise InputError(f"cannot be read ({e.strerror or e})", file=name) from None
    if not data.strip(b" \t\r\n\xef\xbb\xbf\x00"):
        raise InputError("empty file", file=name)
    return name, data


def decode(name: str, data: bytes) -> tuple[str, list[Note]]:
    """Return the text and what was noted about its encoding; a binary file is refused."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            return data.decode("utf-16").lstrip("\ufeff"), []
        except UnicodeDecodeError:
            raise InputError("starts as UTF-16 text but is not", file=name) from None
    if b"\x00" in data:
        if name.lower().endswith((".vrl", ".vdat")):
            raise InputError(
                "binary VRL, export to CSV with Fathom/VUE first (no reader for it)", file=name
            )
        kind = "an Excel workbook or zip archive" if data[:2] == b"PK" else "a binary file"
        raise InputError(f"{kind}, not a table", file=name, mend="export it as CSV")
    if data[:2] == b"PK":
        raise InputError("an Excel workbook or zip archive", file=name, mend="export it as CSV")
    try:
        return data.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        pass
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        raise InputError(
            "neither UTF-8 nor Windows-1252 text", file=name, mend="save it as UTF-8"
        ) from None
    return text, [Note("info", "not UTF-8: read as Windows-1252", 1, name)]


def split(name: str, data: bytes) -> Table:
    """Return the table in the bytes of a delimited text file.

    Rows may be shorter than the header (padded with missing values). A row with more filled
    fields than the header is an error: its values could not be trusted to be in their columns.
    """
    text, notes = decode(name, data)
    if text.startswith("VEMCO DATA LOG"):
        raise InputError(
            "Fathom/VDAT CSV of all record types, which is not read",
            file=name,
            mend="export the detections as CSV from Fathom Connect",
        )
    text = re.sub(r"\r+\n?", "\n", text) if "\r" in text else text
    text = text.replace("\ufeff", "") if "\ufeff" in text else text
    ended = text.endswith("\n")
    lines = text.split("\n")
    first = (
        next(i for i, s in enumerate(lines) if s.strip() and not s.startswith("#"))
        if any(s.strip() and not s.startswith("#") for s in lines)
        else None
    )
    if first is None:
        raise InputError("empty file", file=name)
    head = lines[first]
    delimiter = max(DELIMITERS, key=lambda d: (head.count(d), -DELIMITERS.index(d)))
    if delimiter != ",":
        word = {";": "semicolon", "\t": "tab", "|": "bar"}[delimiter]
        notes.append(Note("info", f"{word}-delimited", 1, name))
    if '"' in text:
        rows, line = _quoted(name, lines, first, delimiter)
        header, rows, line = rows[0], rows[1:], line[1:]
        fields = pl.Series([len(r) for r in rows], dtype=pl.Int64)
        parts = pl.Series(rows, dtype=pl.List(pl.String))
    else:
        header = head.split(delimiter)
        body = pl.Series(lines[first + 1 :], dtype=pl.String)
        full = body.str.strip_chars() != ""
        line = np.flatnonzero(full.to_numpy()) + first + 2
        parts = body.filter(full).str.split(delimiter)
        fields = parts.list.len().cast(pl.Int64)
    n = len(header)
    _refuse_long_rows(name, parts, fields, line, n, delimiter)
    cells = tuple(
        parts.list.get(k, null_on_oob=True).str.strip_chars().fill_null("") for k in range(n)
    )
    shorter = len(fields) > 1 and not ended and int(fields[-1]) < int(fields[:-1].min())  # pyright: ignore
    cut = bool(shorter) or (len(fields) == 1 and not ended and int(fields[0]) < min(n, 3))
    names = tuple(h.strip().strip("\"'").strip() if i else h.strip() for i, h in enumerate(header))
    return Table(name, names, cells, line, delimiter, tuple(notes), cut)


def _quoted(
    name: str, lines: list[str], first: int, delimiter: str
) -> tuple[list[list[str]], np.ndarray]:
    reader = csv.reader(
        io.StringIO("\n".join(lines[first:])), delimiter=delimiter, strict=True, doublequote=True
    )
    rows, line, before = [], [], 0
    try:
        for row in reader:
            if row and (len(row) > 1 or row[0].strip()):
                rows.append(row)
                line.append(first + before + 1)
            before = reader.line_num
    except csv.Error as e:
        raise InputError(f"broken quotes ({e})", file=name, row=first + before + 1) from None
    if not rows:
        raise InputError("empty file", file=name)
    return rows, np.asarray(line, dtype=np.int64)


def _refuse_long_rows(
    name: str, parts: pl.Series, fields: pl.Series, line: np.ndarray, n: int, delimiter: str
) -> None:
    long = (fields > n).arg_true()
    if not len(long):
        return
    for i in long:
        extra = parts[int(i)].to_list()[n:]
        if any(v.strip() for v in extra):
            mend = "quote text that holds the delimiter, and write numbers with a decimal point"
            raise InputError(
                f"{fields[int(i)]} fields under {n} column names (delimiter '{delimiter}')",
                file=name,
                row=int(line[int(i)]),
                mend=mend,
            )


def from_frame(name: str, df: pl.DataFrame) -> Table:
    """Return a table from a typed frame (Parquet, or a user's dataframe); text is stripped."""
    cells: list[Any] = []
    for c in df.columns:
        s = df[c]
        if s.dtype in (pl.Categorical, pl.Enum):
            s = s.cast(pl.String)
        if s.dtype == pl.String:
            s = s.str.strip_chars().fill_null("")
        elif s.dtype == pl.Null:
            s = pl.Series(c, [""] * len(s), dtype=pl.String)
        elif s.dtype == pl.Boolean or s.dtype.is_nested() or s.dtype == pl.Binary:
            s = s.cast(pl.String, strict=False).fill_null("") if s.dtype == pl.Boolean else None
            if s is None:
                raise InputError("a column of lists or bytes", file=name, column=c)
        cells.append(s)
    line = np.arange(1, len(df) + 1)
    return Table(name, tuple(map(str.strip, df.columns)), tuple(cells), line, typed=True)


def read_table(path: str | Path) -> Table:
    """Read a CSV (plain or gzip'd) or Parquet file as a table.

    Raises
    ------
    InputError
        If the file is missing, empty, binary, or not a table.
    """
    name, data = load(path)
    if data[:4] == b"PAR1":
        try:
            df = pl.read_parquet(io.BytesIO(data))
        except Exception as e:  # polars raises several kinds on a broken file
            raise InputError(f"broken Parquet file ({e})", file=name) from None
        return from_frame(name, df)
    return split(name, data)
