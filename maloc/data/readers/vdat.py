"""Fathom Connect and VDAT CSV: jagged records, columns named record type by record type.

``NAME_DESC`` lines name the columns of the records ``NAME``; order and number differ between
versions (1.0 and 2.0), so columns are found by name. Detections are DET, DET_SENS and DET_HTI.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from maloc.data.detections import Detections
from maloc.data.events import ClockReferences, Events
from maloc.data.readers import _clock, innovasea
from maloc.data.readers._columns import plain
from maloc.data.readers._files import File
from maloc.data.readers._how import How
from maloc.data.readers._lines import read_lines
from maloc.data.readers._text import Table, normal
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

__all__ = ["MAGIC", "NAME", "TITLE", "read_detections", "read_events", "sniff"]

NAME = "vdat"
TITLE = "Fathom/VDAT CSV (VEMCO DATA LOG; DET, CLOCK_REF, ... records)"
MAGIC = b"VEMCO DATA LOG"
DETECTIONS = ("DET", "DET_SENS", "DET_HTI")
_FILE = ("VEMCO DATA LOG", "RECORD TYPE", "DATA_SOURCE_FILE")  # about the file, not the receiver


def sniff(data: bytes) -> bool:
    """Say whether a file begins as such a log."""
    return data[:64].removeprefix(b"\xef\xbb\xbf").lstrip(b'"').startswith(MAGIC)


class _Log(NamedTuple):
    """A file's records: one table a record type (and a description of its columns)."""

    version: str
    tables: list[tuple[str, Table]]
    strange: dict[str, int]  # record types without a description, and how many there are


def read_detections(file: File, how: How) -> Detections:
    """Read the detections of a log.

    Times are those of the column `Time`, corrected when the log was made, where it is filled, and
    `Device Time (UTC)` elsewhere; `how.clock` chooses one of them.

    Raises
    ------
    InputError
        If the log has no detection records at all, or a value in them cannot be read.
    """
    log = _open(file)
    parts = []
    # a detection may be there again with its sensor's value: that one comes first and is kept
    for kind in reversed(DETECTIONS):
        for name, table in log.tables:
            if name == kind and innovasea.matches(table):
                parts.append(innovasea.read(table, how, f"Fathom/VDAT CSV {log.version}"))
            elif name == kind:
                log.strange[name] = log.strange.get(name, 0) + len(table)
    other: dict[str, int] = {}
    for name, table in log.tables:
        if name not in (*DETECTIONS, *_FILE) and len(table):
            other[name] = other.get(name, 0) + len(table)
    notes = []
    if other:
        listed = ", ".join(f"{k} ({n})" for k, n in other.items())
        notes.append(
            Note(
                "info", f"records that are no detections: {listed}", sum(other.values()), file.name
            )
        )
    if log.strange:
        listed = ", ".join(f"{k} ({n})" for k, n in log.strange.items())
        text = f"records of types that are not known, passed over: {listed}"
        notes.append(Note("info", text, sum(log.strange.values()), file.name))
    if not parts:
        none = np.empty(0, "U1")
        text = "no detections in the log"
        notes.append(Note("warning", text, 0, file.name))
        report = ReadReport(f"Fathom/VDAT CSV {log.version}", (file.name,), 0, tuple(notes))
        return Detections(np.empty(0, np.int64), none, none, {}, report)
    whole = _in_time_order(Detections.concat(parts, "record type"))
    report = whole.report
    return Detections(whole.time, whole.receiver, whole.tag, whole.extra, report.add(*notes))


def _in_time_order(d: Detections) -> Detections:
    if (np.diff(d.time) >= 0).all():
        return d
    return d.take(np.argsort(d.time, kind="stable"))


def _open(file: File) -> _Log:
    data, notes = normal(*file)
    if not data.endswith(b"\n"):
        data += b"\n"
    lines = data.split(b"\n")
    version, tables, strange = "", [], {}
    for first, last in _sections(lines):
        head = lines[first].decode().split(",")
        version = version or (head[1].strip() if len(head) > 1 else "")
        for name, table, known in _records(file.name, lines, first, last, notes):
            notes = []
            if known:
                tables.append((name, table))
            else:
                strange[name] = strange.get(name, 0) + len(table)
    if not tables and not strange:
        raise InputError("a Fathom/VDAT log without records", file=file.name)
    return _Log(version, tables, strange)


def _sections(lines: list[bytes]) -> Iterator[tuple[int, int]]:
    """Yield where each of the logs pasted into a file begins and ends."""
    starts = [i for i, s in enumerate(lines) if s.lstrip(b'"').startswith(MAGIC)]
    yield from zip(starts, [*starts[1:], len(lines)], strict=True)


def _records(
    name: str, lines: list[bytes], first: int, last: int, notes: list[Note]
) -> Iterator[tuple[str, Table, bool]]:
    rows: dict[str, list[int]] = {}
    header: dict[str, bytes] = {}
    for i in range(first + 1, last):
        kind = lines[i].partition(b",")[0].strip(b'" \t').decode()
        if kind.endswith("_DESC"):
            header[kind.removesuffix("_DESC")] = lines[i]
            rows.setdefault(kind.removesuffix("_DESC"), [])
        elif kind:
            rows.setdefault(kind, []).append(i)
    for kind, at in rows.items():
        if kind in _FILE or (kind not in header and not at):
            continue
        known = kind in header
        head = header.get(kind, b"RECORD")
        found = read_lines(name, b"\n".join([head, *(lines[i] for i in at)]) + b"\n", 0, ",")
        line = np.asarray(at, np.int64)[found.line - 2] + 1 if at else found.line
        table = Table(name, tuple(found.header), tuple(found.cells), line, ",", tuple(notes))
        for i, extra in found.long.items():
            if known and any(v.strip() for v in extra):
                n = len(found.header)
                raise InputError(
                    f"{n + len(extra)} fields in a {kind} record of {n} columns",
                    file=name,
                    row=int(line[i]),
                )
        yield kind, table, known


def read_events(file: File) -> Events:
    """Read everything in a log that is no detection: one event a filled field of a record."""
    log = _open(file)
    columns: list[list] = [[], [], [], [], []]
    references = []
    for kind, table in log.tables:
        simple = [plain(c) for c in table.columns]
        if kind in (*DETECTIONS, *_FILE) or not {"device_time_utc", "serial_number"} <= set(simple):
            continue
        who = table.text(simple.index("serial_number"))
        time, known = _clock.stamps(table, simple.index("device_time_utc"), "UTC", coarse=True)
        known &= who.is_not_null().to_numpy()
        if kind in ("CLOCK_REF", "CLOCK_SET"):
            references.append(_references(kind, table.rows(known), time[known]))
        skipped = ("device_time_utc", "time", "time_offset_h", "time_correction_s", "model",
                   "serial_number")  # fmt: skip
        for k, c in enumerate(simple):
            if not k or c in skipped or table.empty(k):
                continue
            name, _, unit = table.columns[k].rstrip(")").partition(" (")
            filled = known & table.text(k).is_not_null().to_numpy()
            n = int(filled.sum())
            rows = table.rows(filled)
            columns[0] += time[filled].tolist()
            columns[1] += rows.text(simple.index("serial_number")).to_list()
            columns[2] += [_kind(kind, name)] * n
            columns[3] += rows.text(k).to_list()
            columns[4] += [unit] * n
    order = np.argsort(np.array(columns[0], np.int64), kind="stable")
    time = np.array(columns[0], np.int64)[order]
    receiver, what, value, unit = (
        np.array(c, str)[order] if c else np.empty(0, "U1") for c in columns[1:]
    )
    report = ReadReport(f"Fathom/VDAT CSV {log.version}", (file.name,), len(time))
    return Events(time, receiver, what, value, unit, ClockReferences.concat(references), report)


def _kind(record: str, field: str) -> str:
    return f"Temperature, {field.lower()}" if record == "TEMP" else f"{record} {field}"


def _references(kind: str, table: Table, time: np.ndarray) -> ClockReferences:
    """CLOCK_REF: how far off the clock was. CLOCK_SET: the same, and right from then on."""
    simple = [plain(c) for c in table.columns]
    column = "external_difference_s" if kind == "CLOCK_REF" else "prior_difference_s"
    if column not in simple:
        return ClockReferences.concat([])
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
