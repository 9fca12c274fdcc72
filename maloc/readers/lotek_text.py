"""Lotek's WHS text file: blocks of settings, then detections in columns of fixed width."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import polars as pl

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.errors import InputError
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._files import File
from maloc.readers._how import How
from maloc.readers._text import Table, normal
from maloc.readers.vue import serial_number

__all__ = ["FORMATS", "Order"]

_BLOCK = b"Decoded Tag Data:"
_ROW = re.compile(
    r"^\s*(\d{1,2})/(\d{1,2})/(\d{4}|\d{2})\s+(\d{2}:\d{2}:\d{2})\s+(0?\.\d+)\s+(\d+)\s*(.*)$"
)
_COLUMNS = ("Date", "TOA", "Tag ID", "Type", "Value", "Power")


class Order(NamedTuple):
    """The format, with the order in which a date is written; "" = found from the dates."""

    NAME: str
    order: str

    @property
    def TITLE(self) -> str:  # noqa: N802 - as in the other formats
        """Name for messages."""
        order = f", dates {'/'.join(self.order)}" if self.order else ""
        return f"Lotek WHS text file (Decoded Tag Data){order}"

    def sniff(self, data: bytes) -> bool:
        """Say whether the block of detections is announced near the start."""
        return _BLOCK in data[:20_000]

    def read_detections(self, file: File, how: How) -> Detections:
        """Read the block of detections.

        TOA is the fraction of the second of each time; the file's GMT correction is taken off.

        Raises
        ------
        InputError
            If day and month cannot be told apart, the zone is said neither by the file nor by the
            caller, or a row cannot be read.
        """
        data, notes = normal(*file)
        text = data.decode()
        settings = dict(re.findall(r"^\s*([A-Z][A-Za-z ]+?):[ \t]*(\S.*?)\s*$", text, re.MULTILINE))
        serial = settings.get("Serial Number")
        if serial is None:
            raise InputError("no 'Serial Number:' in the file", file=file.name)
        rows, line, strange = _rows(file.name, text)
        if strange:
            notes.append(_left_out(file.name, strange))
        order = self.order or _order(file.name, rows, line)
        stamps = [_stamp(r, order) for r in rows]
        columns = [stamps, *([r[k] for r in rows] for k in range(4, 9))]
        table = Table(
            file.name,
            _COLUMNS,
            tuple(pl.Series(c, dtype=pl.String) for c in columns),
            np.array(line, np.int64),
            notes=tuple(notes),
        )
        time, _ = _clock.stamps(table, 0, *_zone(table, settings, how))
        fraction, _ = _clock.seconds(table, 1)
        shift = _correction(table, settings) if "GMT Correction" in settings else 0
        extra = _build.extras(table, {"sensor_type": 3, "sensor": 4, "power": 5})
        if beacon := settings.get("Beacon ID"):
            text = f"the receiver's own sync tag (beacon) is {beacon}"
            table = _build.merge_notes(table, table.note("info", text))
        names = Ids([serial_number(serial)], np.zeros(len(table), np.int64))
        extra["model"] = np.array([serial.rpartition("-")[0] or None] * len(table), object)
        time = time - shift + fraction
        return _build.detections(table, self.TITLE, time, names, Ids.of(table.text(2)), extra)


def _rows(name: str, text: str) -> tuple[list[tuple[str, ...]], list[int], list[int]]:
    """Rows of the block as text (month, day, year, time, TOA, tag, type, value, power)."""
    rows, line, strange, inside = [], [], [], False
    for number, each in enumerate(text.split("\n"), 1):
        if each.strip().endswith(":") and not _ROW.match(each):
            inside = each.strip() == _BLOCK.decode()
        elif inside and (found := _ROW.match(each)):
            kind, value, power = _rest(found[7].split())
            if power is None:
                strange.append(number)
                continue
            rows.append((*found.group(1, 2, 3, 4, 5, 6), kind, value, power))
            line.append(number)
        elif inside and each.strip() and not each.lstrip().startswith(("Date", "=")):
            strange.append(number)
    return rows, line, strange


def _rest(words: list[str]) -> tuple[str, str, str | None]:
    """Type, value and power, of which the first two may be blank."""
    if len(words) == 3:
        return words[0], words[1], words[2]
    if len(words) == 2:
        return (words[0], "", words[1]) if words[0].isalpha() else ("", words[0], words[1])
    return "", "", words[0] if len(words) == 1 else None


def _left_out(name: str, lines: list[int]):
    from maloc.data.report import Note

    listed = ", ".join(map(str, lines[:5])) + (", ..." if len(lines) > 5 else "")
    text = f"{len(lines)} rows that cannot be read left out (lines {listed})"
    return Note("warning", text, len(lines), name, lines[0])


def _order(name: str, rows: list[tuple[str, ...]], line: list[int]) -> str:
    """Say whether dates are month/day or day/month: one of them is above 12 somewhere."""
    first, second = (any(int(r[k]) > 12 for r in rows) for k in (0, 1))
    if first and second:
        i = next(i for i, r in enumerate(rows) if int(r[0]) > 12)
        raise InputError("dates in two orders of day and month", file=name, row=line[i])
    if rows and not first and not second:
        raise InputError(
            "day and month cannot be told apart in any date",
            file=name,
            row=line[0],
            mend="say --format lotek-mdy (month/day/year) or --format lotek-dmy",
        )
    return "dmy" if first else "mdy"


def _stamp(row: tuple[str, ...], order: str) -> str:
    day, month = (row[0], row[1]) if order == "dmy" else (row[1], row[0])
    year = row[2] if len(row[2]) == 4 else f"20{row[2]}"
    return f"{year}-{int(month):02d}-{int(day):02d} {row[3]}"


def _zone(table: Table, settings: dict[str, str], how: How) -> tuple[str]:
    if "GMT Correction" in settings:
        return ("UTC",)
    if how.tz is None:
        raise table.error(
            "the file has no GMT correction, so that the zone of its times is not known",
            mend="say it with --tz UTC or --tz Europe/Copenhagen (tz= in Python)",
        )
    return (how.tz,)


def _correction(table: Table, settings: dict[str, str]) -> int:
    """Nanoseconds that the file's times are ahead of UTC."""
    said = settings["GMT Correction"]
    found = re.fullmatch(r"([+-]?)(\d{1,2}):(\d{2})", said)
    if found is None:
        raise table.error(f"GMT Correction '{said}' is not hours:minutes")
    size = (int(found[2]) * 60 + int(found[3])) * 60 * NS
    return -size if found[1] == "-" else size


FORMATS = (Order("lotek", ""), Order("lotek-mdy", "mdy"), Order("lotek-dmy", "dmy"))
