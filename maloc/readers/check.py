"""What a set of files is and every problem in it, before any work is done on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS, duration, iso
from maloc.data.arrivals import ArrivalTimes
from maloc.data.detections import Detections
from maloc.data.events import ClockReferences, Events
from maloc.data.grouping import toa_matrix
from maloc.data.receivers import Receivers
from maloc.data.report import Note
from maloc.data.tags import Tags
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.readers._files import File
    from maloc.readers._how import Clock, How

__all__ = ["CheckReport", "FileCheck", "check"]

MOST = 12  # names listed in a line


@dataclass(frozen=True)
class FileCheck:
    """One file: what it is, what is in it, and what is wrong with it.

    Parameters
    ----------
    file : str
        Its name.
    format : str
        What it was recognised as, "" if it could not be read.
    summary : tuple of str
        Contents in words, one line each.
    notes : tuple of Note
        What was skipped, odd or wrong.
    """

    file: str
    format: str
    summary: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()

    def __str__(self) -> str:
        head = f"{self.file}: {self.format or 'not read'}"
        return "\n".join([head, *(f"  {s}" for s in self.summary), *_said(self.notes, self.file)])


@dataclass(frozen=True)
class CheckReport:
    """What `check` found; `str` of it is what `maloc check` prints.

    Parameters
    ----------
    files : tuple of FileCheck
        One a file, in the order given.
    problems : tuple of Note
        What shows only when files are taken together.
    """

    files: tuple[FileCheck, ...] = ()
    problems: tuple[Note, ...] = ()

    @property
    def notes(self) -> tuple[Note, ...]:
        """Every note, of each file and of all together."""
        return tuple(n for f in self.files for n in f.notes) + self.problems

    @property
    def errors(self) -> tuple[Note, ...]:
        """Notes of level "error"."""
        return tuple(n for n in self.notes if n.level == "error")

    @property
    def warnings(self) -> tuple[Note, ...]:
        """Notes of level "warning"."""
        return tuple(n for n in self.notes if n.level == "warning")

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not self.errors

    def __str__(self) -> str:
        parts = [str(f) for f in self.files]
        if self.problems:
            parts.append("\n".join(["together:", *_said(self.problems, None)]))
        e, w = len(self.errors), len(self.warnings)
        verdict = f"{e} error{'s' * (e != 1)}, {w} warning{'s' * (w != 1)}"
        return "\n".join([*parts, verdict if e or w else "no problems found"])


def _said(notes: Sequence[Note], file: str | None) -> list[str]:
    return [f"  {n.level}: {n.text}" if n.file in (None, file) else f"  {n}" for n in notes]


def check(
    paths: str | Path | Sequence[str | Path],
    receivers: str | Path | Receivers | None = None,
    tz: str | None = None,
    *,
    format: str | None = None,
    clock: Clock | None = None,
) -> CheckReport:
    """Read files of any known kind and report what they are and every problem found.

    Parameters
    ----------
    paths : path or sequence of paths
        Detections, receiver events, receivers and tags tables, positions, TOA matrices, in any
        order.
    receivers : path or Receivers, optional
        The receivers table, if it is not among `paths`.
    tz : str, optional
        Zone of local times.
    format, clock : str, optional
        Of the detections, as for `maloc.read_detections`.

    Returns
    -------
    CheckReport
        Unreadable files are errors in it; nothing is raised for them.
    """
    from maloc.readers._how import How

    paths = [paths] if isinstance(paths, str | Path) else list(paths)
    if isinstance(receivers, str | Path):
        paths, receivers = [*paths, receivers], None
    study = _Study(How(tz, clock), format, receivers)
    checks: list[FileCheck | None] = []
    waiting = []
    for path in paths:
        for name, file in _files(path):
            found = study.look(name, file)
            if found is None:
                waiting.append((len(checks), file))
            checks.append(found)
    for i, file in waiting:
        checks[i] = _of_matrix(file, study.receivers)
    return CheckReport(tuple(c for c in checks if c is not None), tuple(study.problems()))


def _files(path: str | Path) -> list[tuple[str, File | InputError]]:
    from maloc.readers._files import load_all

    try:
        found = load_all(path)
    except InputError as e:
        return [(str(path), e)]
    return [(f.name, f) for f in found]


@dataclass
class _Study:
    """What the files hold together, gathered file by file."""

    how: How
    format: str | None
    receivers: Receivers | None
    tags: Tags | None = None
    detections: list[Detections] = field(default_factory=list)
    references: list[ClockReferences] = field(default_factory=list)

    def look(self, name: str, file: File | InputError) -> FileCheck | None:
        """Check one file; None for a TOA matrix, which waits for the receivers."""
        from maloc.readers._recognise import open_file

        try:
            if isinstance(file, InputError):
                raise file
            found = open_file(file)
            if found.kind == "detections" and self.format is not None:
                found = open_file(file, self.format)
            if found.kind == "toa":
                return None
            data = found.read(self.how)
            if found.references is not None:
                self.references.append(found.references())
        except InputError as e:
            return FileCheck(name, "", (), (_as_note(e, name),))
        if isinstance(data, Receivers):
            self.receivers = data
            return FileCheck(name, found.title, _of_receivers(data), data.report.notes)
        if isinstance(data, Detections):
            self.detections.append(data)
            return FileCheck(name, data.report.format, _of_detections(data), data.report.notes)
        if isinstance(data, Events):
            self.references.append(data.references)
            kinds = f"{_counts(data.kind)}"
            return FileCheck(name, found.title, (_plainly(data), kinds), data.report.notes)
        if isinstance(data, Tags):
            self.tags = data
        return FileCheck(name, found.title, (_plainly(data),), data.report.notes)

    def problems(self) -> list[Note]:
        """What shows only when files are taken together."""
        if not self.detections:
            return []
        from maloc.readers._merge import merge, on_asked_clock, under_one_name

        references = ClockReferences.concat(self.references)
        try:
            together = merge(self.detections)
            together = on_asked_clock(under_one_name(together), references, self.how.clock)
        except InputError as e:
            return [Note("error", str(e), 1)]
        known = {n for d in self.detections for n in d.report.notes}
        notes = [*(n for n in together.report.notes if n not in known), *_odd(together)]
        limits = {} if self.tags is None else {
            t: found for t in together.tags if (found := self.tags.limits(t))
        }  # fmt: skip
        notes += _screened(together, self.receivers, limits)
        if self.receivers is not None:
            try:
                array = self.receivers if self.tags is None else self.tags.beside(self.receivers)
            except InputError as e:
                return [*notes, Note("error", str(e), 1)]
            notes += _together(together, array)
        return notes


def _plainly(data: Any) -> str:
    """A container's repr without its name and its count of warnings."""
    text = repr(data).removesuffix(data.report.flag)
    return text.partition(": ")[2] or text


def _screened(d: Detections, r: Receivers | None, limits: dict) -> list[Note]:
    from maloc.data.preparation import clock_notes, prepare

    return [*prepare(d, r, limits).notes, *clock_notes(d)]


def _as_note(error: InputError, file: str) -> Note:
    text = str(error).removeprefix(f"{file}: ").removeprefix(f"{file}, ")
    return Note("error", text, 1, file, error.row)


def _counts(values: np.ndarray) -> str:
    names, counts = np.unique(values, return_counts=True)
    order = np.lexsort((names, -counts))[:MOST]
    listed = ", ".join(f"{names[i]} ({counts[i]})" for i in order)
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    return listed + more


def _of_detections(d: Detections) -> tuple[str, ...]:
    if d.span is None:
        return ("0 detections",)
    first, last = d.span
    return (
        f"{len(d)} detections, {iso(first)} to {iso(last)} UTC ({duration((last - first) / NS)})",
        f"{len(d.tags)} tag{'s' * (len(d.tags) != 1)}: {_counts(d.tag)}",
        f"{len(d.receivers)} receiver{'s' * (len(d.receivers) != 1)}: {_counts(d.receiver)}",
    )


def _of_receivers(r: Receivers) -> tuple[str, ...]:
    names = ", ".join(r.names[:MOST]) + (", ..." if len(r.names) > MOST else "")
    return (repr(r).removeprefix("Receivers: ").removesuffix(r.report.flag), names)


def _of_matrix(file: Any, receivers: Receivers | None) -> FileCheck:
    from maloc.readers._text import table_of
    from maloc.readers.toa import toa_from_table

    kind, name = "TOA matrix", file.name
    if receivers is None:
        note = Note("warning", "give the receivers table too, to check its columns", 1, name)
        return FileCheck(name, kind, (), (note,))
    try:
        a: ArrivalTimes = toa_from_table(table_of(file), receivers)
    except InputError as e:
        return FileCheck(name, kind, (), (_as_note(e, name),))
    text = repr(a).removeprefix("ArrivalTimes: ").removesuffix(a.report.flag)
    return FileCheck(name, kind, (text,), a.report.notes)


def _odd(d: Detections) -> list[Note]:
    """What detections show by themselves."""
    notes = []
    if len(d.receivers) == 1:
        text = f"1 receiver ({d.receivers[0]}): no synchronisation and no positions from this alone"
        notes.append(Note("warning", text))
    numbers: dict[str, list[str]] = {}
    for t in d.tags:
        numbers.setdefault(t.rsplit("-", 1)[-1], []).append(t)
    for number, tags in numbers.items():
        if len(tags) > 1:
            text = f"number {number} is used by {len(tags)} transmitters: {', '.join(tags)}"
            notes.append(Note("info", f"{text}; give the full id", len(tags)))
    return notes


def _together(d: Detections, r: Receivers) -> list[Note]:
    notes = []
    deployment = r.deployment_of(d.receiver, d.time)
    heard = np.unique(deployment[deployment >= 0])
    silent = [r.labels[i] for i in range(len(r)) if i not in heard]
    if silent and len(d):
        text = f"in the receivers table but never heard anything: {', '.join(silent)}"
        notes.append(Note("info", f"{text} (they count as listening)", len(silent)))
    return notes + _sync_tags(d, r) + _clocks(d, r)


def _sync_tags(d: Detections, r: Receivers) -> list[Note]:
    notes = []
    for tag in dict.fromkeys(map(str, r.sync_tag[r.sync_tag != ""])):
        try:
            d.find_tag(tag)
        except InputError:
            text = f"sync tag {tag} of the receivers table is not among the detections"
            notes.append(Note("warning", text))
    return notes


def _clocks(d: Detections, r: Receivers) -> list[Note]:
    """Group the three commonest tags, to see whether the clocks can be on one time."""
    names, counts = np.unique(d.tag, return_counts=True)
    for i in np.argsort(-counts, kind="stable")[:3]:
        try:
            toa_matrix(d, r, str(names[i]), sound_speed=1500.0)
        except InputError as e:
            if "unsynchronised" in e.problem:
                return [
                    Note(
                        "warning", f"{e.problem}; run maloc sync before positions by arrival times"
                    )
                ]
    return []
