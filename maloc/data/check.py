"""What a set of files is and every problem in it, before any work is done on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maloc.data import _pings
from maloc.data._time import NS, duration, iso
from maloc.data.arrivals import ArrivalTimes
from maloc.data.detections import Detections
from maloc.data.grouping import ECHO_S, toa_matrix
from maloc.data.receivers import Receivers
from maloc.data.report import Note
from maloc.errors import InputError

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
) -> CheckReport:
    """Read files of any known kind and report what they are and every problem found.

    Parameters
    ----------
    paths : path or sequence of paths
        Detections, receivers tables, TOA matrices, in any order.
    receivers : path or Receivers, optional
        The receivers table, if it is not among `paths`.
    tz : str, optional
        Zone of local times.

    Returns
    -------
    CheckReport
        Unreadable files are errors in it; nothing is raised for them.
    """
    paths = [paths] if isinstance(paths, str | Path) else list(paths)
    if isinstance(receivers, str | Path):
        paths, receivers = [*paths, receivers], None
    found: dict[int, FileCheck] = {}
    detections: list[Detections] = []
    waiting = []
    for i, path in enumerate(paths):
        try:
            kind, data = _open(path, tz)
        except InputError as e:
            found[i] = FileCheck(str(path), "", (), (_as_note(e, str(path)),))
            continue
        if kind == "toa":
            waiting.append((i, path))
        elif isinstance(data, Receivers):
            receivers = data
            found[i] = FileCheck(str(path), kind, _of_receivers(data), data.report.notes)
        elif isinstance(data, Detections):
            detections.append(data)
            notes = (*data.report.notes, *_odd(data))
            found[i] = FileCheck(str(path), kind, _of_detections(data), notes)
        else:
            found[i] = FileCheck(str(path), kind)
    for i, path in waiting:
        found[i] = _of_matrix(path, receivers)
    problems = _together(Detections.concat(detections), receivers) if detections else []
    return CheckReport(tuple(found[i] for i in sorted(found)), tuple(problems))


def _open(path: str | Path, tz: str | None) -> tuple[str, Any]:
    from maloc.data.readers import _recognise, atlas, toa, vue
    from maloc.data.readers import receivers as table_of_receivers
    from maloc.data.readers._text import load, read_table

    if load(path)[1].startswith(atlas.MAGIC):
        data = atlas.read_file(path)
        return data.report.format, data
    table = read_table(path)
    if vue.is_events(table):
        return "VUE receiver events CSV (clock checks and diagnostics, no detections)", None
    is_detections = any(f.matches(table) for f in _recognise.FORMATS)
    if not is_detections and toa.matches(table):
        return "toa", None
    if not is_detections and table_of_receivers.matches(table):
        return "receivers table", table_of_receivers.receivers_from_table(table)
    data = _recognise.recognise(table).read(table, tz)
    return data.report.format, data


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


def _of_matrix(path: str | Path, receivers: Receivers | None) -> FileCheck:
    from maloc.data.readers import read_toa

    kind, name = "TOA matrix", str(path)
    if receivers is None:
        note = Note("warning", "give the receivers table too, to check its columns", 1, name)
        return FileCheck(name, kind, (), (note,))
    try:
        a: ArrivalTimes = read_toa(path, receivers)
    except InputError as e:
        return FileCheck(name, kind, (), (_as_note(e, name),))
    text = repr(a).removeprefix("ArrivalTimes: ").removesuffix(a.report.flag)
    return FileCheck(name, kind, (text,), a.report.notes)


def _odd(d: Detections) -> list[Note]:
    """What a single file of detections shows by itself."""
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
    if len(d):
        _, tag = np.unique(d.tag, return_inverse=True)
        _, receiver = np.unique(d.receiver, return_inverse=True)
        order = np.argsort(d.time, kind="stable")
        t = (d.time[order] - d.time.min()) / NS
        key = (tag * (receiver.max() + 1) + receiver)[order]
        n = int((_pings.echoes(t, key, ECHO_S) >= 0).sum())
        if n:
            text = f"{n} second detections of a ping within {ECHO_S:g} s at one receiver (echoes)"
            notes.append(Note("info", text, n))
    return notes


def _together(d: Detections, r: Receivers | None) -> list[Note]:
    notes = [n for n in d.report.notes if "more than one file" in n.text]
    if r is None:
        return notes
    deployment = r.deployment_of(d.receiver, d.time)
    for name in d.receivers:
        mine = d.receiver == name
        n = int((deployment[mine] < 0).sum())
        if not r.knows(name):
            text = f"receiver {name} ({n} detections) is not in the receivers table: takes no part"
            notes.append(Note("warning", text, n))
        elif n:
            text = f"{n} detections of {name} are outside any deployment of it: they take no part"
            notes.append(Note("warning", text, n))
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
