"""Fathom Connect and VDAT CSV: jagged records, columns named record type by record type.

``NAME_DESC`` lines name the columns of the records ``NAME``; order and number differ between
versions (1.0 and 2.0), so columns are found by name. Detections are DET, DET_SENS and DET_HTI.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import polars as pl

from maloc.data.detections import Detections
from maloc.data.events import ClockReferences, Events
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError
from maloc.readers import _clock, innovasea
from maloc.readers._columns import plain
from maloc.readers._files import File
from maloc.readers._how import How
from maloc.readers._lines import read_lines
from maloc.readers._text import Table, normal

__all__ = [
    "MAGIC",
    "NAME",
    "TITLE",
    "Log",
    "open_log",
    "read_detections",
    "read_events",
    "read_references",
    "sniff",
]

NAME = "vdat"
TITLE = "Fathom/VDAT CSV (VEMCO DATA LOG; DET, CLOCK_REF, ... records)"
MAGIC = b"VEMCO DATA LOG"
DETECTIONS = ("DET", "DET_SENS", "DET_HTI")
_CLOCKS = ("CLOCK_REF", "CLOCK_SET")
_COMMON = ("device_time_utc", "time", "time_offset_h", "time_correction_s", "model",
           "serial_number")  # fmt: skip
_FILE = ("VEMCO DATA LOG", "RECORD TYPE", "DATA_SOURCE_FILE")  # about the file, not the receiver


def sniff(data: bytes) -> bool:
    """Say whether a file begins as such a log."""
    return data[:64].removeprefix(b"\xef\xbb\xbf").lstrip(b'"').startswith(MAGIC)


class Log(NamedTuple):
    """A file's records: one table a record type and a description of its columns."""

    file: str
    version: str
    tables: list[tuple[str, Table]]
    strange: dict[str, int]  # record types without a description, and how many there are


def read_detections(log: Log, how: How) -> Detections:
    """Read the detections of a log.

    Times are those of the column `Time`, corrected when the log was made, where it is filled, and
    `Device Time (UTC)` elsewhere; `how.clock` chooses one of them.

    Raises
    ------
    InputError
        If the log has no detection records at all, or a value in them cannot be read.
    """
    strange = dict(log.strange)
    parts = []
    # a detection may be there again with its sensor's value: that one comes first and is kept
    for kind in reversed(DETECTIONS):
        for name, table in log.tables:
            if name == kind and innovasea.matches(table):
                parts.append(innovasea.read(table, how, f"Fathom/VDAT CSV {log.version}"))
            elif name == kind:
                strange[name] = strange.get(name, 0) + len(table)
    other: dict[str, int] = {}
    for name, table in log.tables:
        if name not in (*DETECTIONS, *_FILE) and len(table):
            other[name] = other.get(name, 0) + len(table)
    notes = []
    if other:
        listed = ", ".join(f"{k} ({n})" for k, n in other.items())
        notes.append(
            Note("info", f"records that are no detections: {listed}", sum(other.values()), log.file)
        )
    if strange:
        listed = ", ".join(f"{k} ({n})" for k, n in strange.items())
        text = f"records of types that are not known, passed over: {listed}"
        notes.append(Note("info", text, sum(strange.values()), log.file))
    if not parts:
        none = np.empty(0, "U1")
        text = "no detections in the log"
        notes.append(Note("warning", text, 0, log.file))
        report = ReadReport(f"Fathom/VDAT CSV {log.version}", (log.file,), 0, tuple(notes))
        return Detections(np.empty(0, np.int64), none, none, {}, report)
    whole = _in_time_order(Detections.concat(parts, "record type"))
    report = whole.report
    return Detections(whole.time, whole.receiver, whole.tag, whole.extra, report.add(*notes))


def _in_time_order(d: Detections) -> Detections:
    if (np.diff(d.time) >= 0).all():
        return d
    return d.take(np.argsort(d.time, kind="stable"))


def open_log(file: File) -> Log:
    """Sort a log's lines by record type.

    Raises
    ------
    InputError
        If it has no records, or one has more fields than its description.
    """
    data, notes = normal(*file)
    lines = pl.read_csv(
        io.BytesIO(data), has_header=False, infer_schema=False, separator="\x1f", quote_char=None,
        truncate_ragged_lines=True,
    ).to_series()  # fmt: skip
    kind = lines.str.extract(r'^[" ]*([^,"]*)').str.strip_chars().fill_null("")
    starts = (kind == MAGIC.decode()).arg_true().to_list()
    if not starts:
        raise InputError(
            "a Fathom/VDAT log whose fields are not separated by commas (re-saved by Excel?)",
            file=file.name,
            mend="export it again",
        )
    head = str(lines[starts[0]]).split(",")
    version = head[1].strip('" ') if len(head) > 1 else ""
    tables, strange = [], {}
    for first, last in zip(starts, [*starts[1:], len(lines)], strict=True):
        for name, table, known in _records(file.name, lines, kind, first, last):
            if known:
                tables.append((name, replace(table, notes=tuple(notes))))
                notes = []
            else:
                strange[name] = strange.get(name, 0) + len(table)
    if not tables and not strange:
        raise InputError("a Fathom/VDAT log without records", file=file.name)
    return Log(file.name, version, tables, strange)


def _records(
    name: str, lines: pl.Series, kind: pl.Series, first: int, last: int
) -> Iterator[tuple[str, Table, bool]]:
    """Yield each record type of one log, its table, and whether its columns are described."""
    lines, kind = lines[first:last], kind[first:last]
    names = kind.unique(maintain_order=True).to_list()
    for what in dict.fromkeys(n.removesuffix("_DESC") for n in names if n):
        if what in _FILE:
            continue
        described = (kind == f"{what}_DESC").arg_true()
        at = (kind == what).arg_true().to_numpy()
        head = lines[int(described[-1])] if len(described) else "RECORD"
        text = head.encode() + b"\n"
        if len(at):
            text += lines.gather(at).str.join("\n")[0].encode() + b"\n"
        found = read_lines(name, text, 0, ",")
        line = first + at[found.line - 2] + 1 if len(at) else found.line
        table = Table(name, tuple(found.header), tuple(found.cells), line)
        for i, extra in found.long.items():
            if len(described) and any(v.strip() for v in extra):
                n = len(found.header)
                raise InputError(
                    f"{n + len(extra)} fields in a {what} record of {n} columns",
                    file=name,
                    row=int(line[i]),
                )
        yield what, table, bool(len(described))


def read_references(log: Log) -> ClockReferences:
    """Return the comparisons of clocks in a log."""
    return ClockReferences.concat(
        [_references(kind, table) for kind, table in log.tables if kind in _CLOCKS]
    )


def _placed(table: Table) -> tuple[Table, np.ndarray, list[str]] | None:
    """A record type's rows that say when and at which receiver, and when (ns); None if none can."""
    simple = [plain(c) for c in table.columns]
    if not {"device_time_utc", "serial_number"} <= set(simple):
        return None
    time, known = _clock.stamps(table, simple.index("device_time_utc"), "UTC", coarse=True)
    known = known & table.text(simple.index("serial_number")).is_not_null().to_numpy()
    return table.rows(known), time[known], simple


def read_events(log: Log) -> Events:
    """Read everything in a log that is no detection: one event a filled field of a record."""
    columns: list[list] = [[], [], [], [], []]
    for kind, table in log.tables:
        placed = None if kind in DETECTIONS else _placed(table)
        if placed is None:
            continue
        table, time, simple = placed
        for k, c in enumerate(simple):
            if not k or c in _COMMON or table.empty(k):
                continue
            name, _, unit = table.columns[k].rstrip(")").partition(" (")
            filled = table.text(k).is_not_null().to_numpy()
            rows = table.rows(filled)
            columns[0] += time[filled].tolist()
            columns[1] += rows.text(simple.index("serial_number")).to_list()
            columns[2] += [_kind(kind, name)] * len(rows)
            columns[3] += rows.text(k).to_list()
            columns[4] += [unit] * len(rows)
    order = np.argsort(np.array(columns[0], np.int64), kind="stable")
    time = np.array(columns[0], np.int64)[order]
    receiver, what, value, unit = (
        np.array(c, str)[order] if c else np.empty(0, "U1") for c in columns[1:]
    )
    report = ReadReport(f"Fathom/VDAT CSV {log.version}", (log.file,), len(time))
    return Events(time, receiver, what, value, unit, read_references(log), report)


def _kind(record: str, field: str) -> str:
    return f"Temperature, {field.lower()}" if record == "TEMP" else f"{record} {field}"


def _references(kind: str, table: Table) -> ClockReferences:
    """CLOCK_REF: how far off the clock was. CLOCK_SET: the same, and right from then on."""
    placed = _placed(table)
    column = "external_difference_s" if kind == "CLOCK_REF" else "prior_difference_s"
    if placed is None or column not in placed[2]:
        return ClockReferences.concat([])
    table, time, simple = placed
    behind = table.numbers(simple.index(column))
    who = np.asarray(table.text(simple.index("serial_number")).to_list(), str)
    said = table.text(simple.index("source")) if "source" in simple else None
    source = np.asarray([""] * len(table) if said is None else said.fill_null("").to_list(), str)
    known = np.isfinite(behind)
    who, source, behind, at = who[known], source[known], behind[known], time[known]
    if kind == "CLOCK_REF":
        fresh = np.array([s.upper().startswith("INIT") for s in source], bool)
        return ClockReferences(who, at, behind, source, fresh)
    before = at
    if "prior_device_time_utc" in simple:
        prior, there = _clock.stamps(
            table, simple.index("prior_device_time_utc"), "UTC", coarse=True
        )
        before = np.where(there, prior, time)[known]
    old = ClockReferences(who, before, behind, source, np.zeros(len(who), bool))
    new = ClockReferences(who, at, np.zeros(len(who)), source, np.ones(len(who), bool))
    return ClockReferences.concat([old, new])
