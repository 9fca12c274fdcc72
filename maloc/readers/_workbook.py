"""Excel workbooks as CSV, a sheet a file, so that every reader takes them."""

from __future__ import annotations

import csv
import io
from datetime import datetime, time

from maloc.errors import InputError, needs

__all__ = ["sheets"]


def sheets(name: str, data: bytes) -> list[tuple[str, bytes]]:
    """Return (name/sheet, CSV) of every sheet of an .xlsx workbook that holds anything.

    Raises
    ------
    InputError
        If openpyxl is not installed, or the workbook cannot be read.
    """
    try:
        from openpyxl import load_workbook
    except ImportError as problem:
        without = {"file": name, "otherwise": "save the sheet as CSV"}
        raise needs("an Excel workbook", "openpyxl", "excel", problem, **without) from None
    try:
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        out = [(f"{name}/{sheet.title}", _csv(sheet.iter_rows(values_only=True))) for sheet in book]
    except Exception as e:  # openpyxl raises many kinds on a broken file
        raise InputError(f"broken Excel workbook ({e})", file=name) from None
    return [(sheet, text) for sheet, text in out if text.strip(b"\n,")]


def _csv(rows) -> bytes:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for row in rows:
        writer.writerow([_text(v) for v in row])
    return out.getvalue().encode()


def _text(value) -> str:
    """A cell as it would be written; whole numbers without ".0", dates in ISO 8601."""
    if value is None:
        return ""
    if isinstance(value, datetime):
        return value.isoformat(sep=" ")
    if isinstance(value, time):
        return value.isoformat()
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).replace("\n", " ").strip()
