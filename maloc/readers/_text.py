"""Files as tables of text: bytes, encodings, delimiters and line numbers, but no meaning yet."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from maloc.data.report import Note
from maloc.errors import InputError
from maloc.readers._files import File, load
from maloc.readers._lines import read_lines

MISSING = ("", "NA", "N/A", "NaN", "nan", "NAN", "NaT", "null", "NULL", "None")
DELIMITERS = (",", ";", "\t", "|")
TITLE_LINES = 8
BOM = b"\xef\xbb\xbf"
# sheets with a title above the header: OTN's deployments, stations of a VPS project
_SHEET = re.compile(r"\bINS_SERIAL_NO\b|\bDevice Depth\b", re.IGNORECASE)


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
    head: int = 1  # line of the header
    _text: dict[int, pl.Series] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.line)

    def rows(self, keep: np.ndarray, *notes: Note) -> Table:
        """Return the rows where `keep` is true, with further notes."""
        more = (*self.notes, *notes)
        cut = self.cut_last and bool(keep[-1])
        if keep.all():
            return replace(self, notes=more)
        mask = pl.Series(keep)
        cells = tuple(c.filter(mask) for c in self.cells)
        line = self.line[keep]
        return replace(self, cells=cells, line=line, notes=more, cut_last=cut, _text={})

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
        if k not in self._text:
            cell = self.cells[k]
            if cell.dtype != pl.String:
                if cell.dtype.is_float() and (cell.drop_nulls() % 1 == 0).all():
                    cell = cell.cast(pl.Int64, strict=False)
                cell = cell.cast(pl.String)
            self._text[k] = without(cell, MISSING)
        return self._text[k]

    def empty(self, k: int) -> bool:
        """Whether every value of column `k` is missing."""
        return self.text(k).null_count() == len(self)

    def numbers(self, k: int, missing: tuple[str, ...] = ()) -> np.ndarray:
        """Column `k` as float64, missing values NaN; anything that is no number is an error."""
        cell = self.cells[k]
        if cell.dtype.is_numeric():
            out = cell.cast(pl.Float64).fill_null(np.nan).to_numpy()
            return self._finite(out, k)
        cell = self.text(k)
        cell = without(cell, missing)
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


def without(cell: pl.Series, missing: tuple[str, ...]) -> pl.Series:
    """Text with these words as null; words are short, so only short values are looked up."""
    if not missing:
        return cell
    short = cell.str.len_bytes() <= max(map(len, missing))
    if not short.any():
        return cell
    if (cell == "").all() and "" in missing:
        return pl.Series(cell.name, [None], dtype=pl.String).new_from_index(0, len(cell))
    gone = short & cell.is_in(list(missing))
    return pl.select(pl.when(~gone).then(cell)).to_series()


def decode(name: str, data: bytes) -> tuple[bytes, list[Note]]:
    """Return text as UTF-8 and what was noted about its encoding; a binary file is refused."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            return data.decode("utf-16").encode(), []
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
        if not data.isascii():
            data.decode()
        return data, []
    except UnicodeDecodeError:
        pass
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        raise InputError(
            "neither UTF-8 nor Windows-1252 text", file=name, mend="save it as UTF-8"
        ) from None
    return text.encode(), [Note("info", "not UTF-8: read as Windows-1252", 1, name)]


def split(name: str, data: bytes) -> Table:
    """Return the table in the bytes of a delimited text file.

    Rows may be shorter than the header (padded with missing values). A row with more filled
    fields than the header is an error: its values could not be trusted to be in their columns.
    """
    data, notes = normal(name, data)
    return split_text(name, data, notes)


def normal(name: str, data: bytes) -> tuple[bytes, list[Note]]:
    """Return text as UTF-8 without byte-order marks, lines ending in a newline alone."""
    data, notes = decode(name, data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
        data = re.sub(rb"\r+\n?", b"\n", data) if b"\r" in data else data
    return (data.replace(BOM, b"") if BOM in data else data), notes


def sections(name: str, data: bytes) -> list[Table]:
    """Return the tables of a file into which exports with different headers were pasted.

    A line that begins with the name of the first column, and is not the header again, begins
    another one.
    """
    data, notes = normal(name, data)
    first, start, head = _header(name, data)
    delimiter = max(DELIMITERS, key=head.count)
    word = head.split(delimiter)[0]
    again = b"\n" + (word + delimiter).encode()
    cuts, at = [], data.find(again, start + 1) if word.strip() else -1
    while at >= 0:
        end = data.find(b"\n", at + 1)
        line = data[at + 1 : len(data) if end < 0 else end].decode()
        last = data[cuts[-1] :].split(b"\n", 1)[0].decode() if cuts else head
        if line.rstrip() != last.rstrip():
            cuts.append(at + 1)
        at = data.find(again, at + 1)
    out = []
    for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True):
        out.append(split_text(name, data[a:b], notes, data.count(b"\n", 0, a)))
        notes = []
    return out


def split_text(name: str, data: bytes, notes: list[Note], above: int = 0) -> Table:
    """Return the table in normal text, which has `above` lines above it; see `split`."""
    first, start, head = _header(name, data)
    first += above
    delimiter = max(DELIMITERS, key=lambda d: (head.count(d), -DELIMITERS.index(d)))
    if delimiter != ",":
        word = {";": "semicolon", "\t": "tab", "|": "bar"}[delimiter]
        notes = [*notes, Note("info", f"{word}-delimited", 1, name)]
    found = read_lines(name, data[start:] if start else data, first, delimiter)
    n = len(found.header)
    for i, extra in found.long.items():
        if any(v.strip() for v in extra):
            raise InputError(
                f"{n + len(extra)} fields under {n} column names (delimiter '{delimiter}')",
                file=name,
                row=int(found.line[i]),
                mend="quote text that holds the delimiter, and write numbers with a decimal point",
            )
    names = tuple(
        h.strip().strip("\"'").strip() if i else h.strip() for i, h in enumerate(found.header)
    )
    cells = tuple(found.cells)
    return Table(name, names, cells, found.line, delimiter, tuple(notes), found.cut, head=first + 1)


def _header(name: str, data: bytes) -> tuple[int, int, str]:
    """Return the header's line (0 = first), where it begins (bytes), and its text.

    It is the first line that is neither blank nor a comment, but in a sheet with a title above
    its table the line that names the columns.
    """
    position, i, first = 0, 0, None
    while position < len(data) and (first is None or i - first[0] < TITLE_LINES):
        end = data.find(b"\n", position)
        end = len(data) if end < 0 else end
        text = data[position:end].decode()
        if text.strip() and not text.startswith("#"):
            if _SHEET.search(text):
                return i, position, text
            first = first or (i, position, text)
        position, i = end + 1, i + 1
    if first is None:
        raise InputError("empty file", file=name)
    return first


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
    return table_of(load(path))


def table_of(file: File) -> Table:
    """Return the table in an unpacked file; see `read_table`."""
    name, data = file
    if data[:4] == b"PAR1":
        try:
            df = pl.read_parquet(io.BytesIO(data))
        except Exception as e:  # polars raises several kinds on a broken file
            raise InputError(f"broken Parquet file ({e})", file=name) from None
        return from_frame(name, df)
    return split(name, data)


def tables_of(file: File) -> list[Table]:
    """Return the table of a file, or the tables where several exports were pasted together."""
    if file.data[:4] == b"PAR1":
        return [table_of(file)]
    return sections(*file)
