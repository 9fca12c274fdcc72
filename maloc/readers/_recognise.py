"""Which format a file is, by its header; files known to be something else are refused by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from maloc.data.detections import Detections
from maloc.data.events import ClockReferences
from maloc.data.report import Note
from maloc.errors import InputError
from maloc.readers import (
    atlas,
    innovasea,
    kaltoa,
    lotek,
    lotek_text,
    networks,
    plain,
    thelma,
    vdat,
    vue,
    vue_events,
)
from maloc.readers import positions as of_positions
from maloc.readers import receivers as of_receivers
from maloc.readers import tags as of_tags
from maloc.readers._files import File, load_all
from maloc.readers._how import How
from maloc.readers._text import Table, from_frame, tables_of

__all__ = ["NAMES", "Found", "known_formats", "open_file", "read_files", "read_frame", "recognise"]


class Format(Protocol):
    """A format of detections with one header line: a module, or one of `networks`."""

    NAME: str
    TITLE: str
    matches: Callable[[Table], bool]
    read: Callable[[Table, How], Detections]


FORMATS: tuple[Any, ...] = (
    vue,
    innovasea,
    thelma,
    lotek,
    kaltoa,
    networks.OTN,
    networks.GLATOS,
    networks.ETN,
    plain,
)
WHOLE_FILES: tuple[Any, ...] = (
    vdat,
    *lotek_text.FORMATS,
    atlas,
)  # told by their first bytes, not by a header line
NAMES = tuple(f.NAME for f in (*FORMATS, *WHOLE_FILES))


class Found(NamedTuple):
    """A file that was recognised, and what is in it."""

    file: File
    kind: str  # "detections", "events", "receivers", "tags", "positions", "toa"
    title: str
    table: Table | None
    read: Callable[[How], Any]
    references: Callable[[], ClockReferences] | None = None  # of clocks, in a log of detections


def known_formats() -> str:
    """Return the formats of detections that are read, in words."""
    return "; ".join(f.TITLE for f in (*FORMATS, vdat, lotek_text.FORMATS[0], atlas))


def open_file(file: File, format: str | None = None) -> Found:
    """Find out what a file is.

    Parameters
    ----------
    file : File
        Its name and bytes.
    format : str, optional
        Insist on a format of detections.

    Raises
    ------
    InputError
        If the header fits nothing known (it is listed, with the formats known).
    """
    if vdat.sniff(file.data) and format in (None, vdat.NAME):
        log = vdat.open_log(file)
        return Found(
            file, "detections", vdat.TITLE, None, lambda how: vdat.read_detections(log, how),
            lambda: vdat.read_references(log),
        )  # fmt: skip
    for f in WHOLE_FILES:
        if f.sniff(file.data) and format in (None, f.NAME):
            return Found(
                file, "detections", f.TITLE, None, lambda how, f=f: f.read_detections(file, how)
            )
        if format == f.NAME:
            raise InputError(f"is not {f.TITLE}", file=file.name)
    tables = tables_of(file)
    found = [Found(file, *_of_table(t, format)) for t in tables]
    if len(found) == 1 or found[0].kind != "detections":
        return found[0]
    for f, table in zip(found, tables, strict=True):
        if f.kind != "detections":
            raise table.error(f"{f.title} pasted below detections", mend="split the file there")
    text = f"{len(found)} exports with different columns pasted together"
    note = tables[0].note("info", text, len(found), tables[1].head)

    def read(how: How) -> Detections:
        whole = Detections.concat([f.read(how) for f in found], "part of the file")
        return replace(whole, report=whole.report.add(note))

    return found[0]._replace(read=read)


def _of_table(table: Table, format: str | None) -> tuple[str, str, Table, Callable[[How], Any]]:
    if format is not None:
        chosen = next(f for f in FORMATS if f.NAME == format)
        if not chosen.matches(table):
            raise table.error(
                f"the header does not fit format '{format}' ({chosen.TITLE}); {_header(table)}"
            )
        return "detections", chosen.TITLE, table, lambda how: chosen.read(table, how)
    if vue_events.matches(table):
        return "events", vue_events.TITLE, table, lambda how: vue_events.read(table, how)
    if of_positions.matches(table):
        return (
            "positions",
            of_positions.title(table),
            table,
            lambda how: of_positions.read(table, how),
        )
    for f in FORMATS:
        if f.matches(table):
            return "detections", f.TITLE, table, lambda how, f=f: f.read(table, how)
    from maloc.readers import toa

    if toa.matches(table):
        return "toa", "TOA matrix", table, lambda how: table
    if of_receivers.matches(table):
        return (
            "receivers",
            "receivers table",
            table,
            lambda how: of_receivers.receivers_from_table(table),
        )
    if of_tags.matches(table):
        return "tags", "tags table", table, lambda how: of_tags.read(table)
    raise InputError(
        f"unknown header, {_header(table)}; formats known: {known_formats()}",
        file=table.file,
        row=table.head if table.head > 1 else None,
    )


def _header(table: Table) -> str:
    return "header found: " + ", ".join(c or "(no name)" for c in table.columns[:40])


class ReadFiles(NamedTuple):
    """Detections file by file, and the comparisons of clocks that came along."""

    detections: list[Detections]
    references: ClockReferences


def read_files(paths: Sequence[str | Path], format: str | None, how: How) -> ReadFiles:
    """Read files of detections in any known format, and events beside them.

    Raises
    ------
    InputError
        If a file is neither, or cannot be read.
    """
    if format is not None and format not in NAMES:
        raise InputError(f"format '{format}' is not one of {', '.join(NAMES)}")
    detections: list[Detections] = []
    references: list[ClockReferences] = []
    for path in paths:
        files = load_all(path)
        passed: list[str] = []
        before = len(detections)
        for file in files:
            try:
                found = open_file(file, format)
            except InputError:
                if len(files) == 1:
                    raise
                passed.append(file.name)
                continue
            if found.kind == "detections":
                detections.append(found.read(how))
                if found.references is not None:
                    references.append(found.references())
            elif found.kind == "events":
                references.append(found.read(how).references)
            elif len(files) == 1:
                raise InputError(
                    f"{found.title}, not detections", file=file.name, mend="give detections"
                )
            else:
                passed.append(file.name)
        if len(files) > 1 and len(detections) == before:
            raise InputError(f"none of its {len(files)} files holds detections", file=str(path))
        if passed:
            text = f"{len(passed)} files in {path} are no detections: {', '.join(passed[:8])}"
            last = detections[-1]
            report = last.report.add(Note("info", text, len(passed), str(path)))
            detections[-1] = Detections(last.time, last.receiver, last.tag, last.extra, report)
    if not detections:
        raise InputError(
            "receiver events, not detections",
            file=", ".join(map(str, paths)),
            mend="give the detections export too",
        )
    return ReadFiles(detections, ClockReferences.concat(references))


def read_frame(df, name: str = "dataframe", tz: str | None = None) -> Detections:
    """Read detections from a polars DataFrame in any known layout."""
    return recognise(from_frame(name, df)).read(How(tz))


def recognise(table: Table, format: str | None = None) -> Found:
    """Return what a table of detections is; see `open_file`.

    Raises
    ------
    InputError
        If it is not a table of detections.
    """
    kind, title, _, read = _of_table(table, format)
    if kind != "detections":
        raise table.error(f"{title}, not detections")
    return Found(File(table.file, b""), kind, title, table, read)
