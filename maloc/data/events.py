"""What receivers log beside detections, and the clock corrections that follow from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.data import _arrays
from maloc.data._time import NS, duration, iso
from maloc.data.report import Note, ReadReport

if TYPE_CHECKING:
    from maloc.data.detections import Detections

__all__ = ["ClockReferences", "Events", "correct_clocks"]


@dataclass(frozen=True, repr=False, eq=False)
class ClockReferences:
    """Moments at which a receiver's clock was compared with another, such as the PC's.

    Parameters
    ----------
    receiver : array (K,) of str
        Serial or name.
    time : array (K,) of int64
        What the receiver's clock showed, ns since 1970.
    behind : array (K,) of float64
        How much later it was by the other clock, s.
    source : array (K,) of str
        On what occasion, as the file has it.
    fresh : array (K,) of bool
        Where the clock had just been set, so that nothing earlier belongs to the same run of it.
    """

    receiver: np.ndarray
    time: np.ndarray
    behind: np.ndarray
    source: np.ndarray
    fresh: np.ndarray

    def __post_init__(self) -> None:
        time = _arrays.times(self.time, "time")
        n = len(time)
        object.__setattr__(self, "time", time)
        for name in ("receiver", "source"):
            object.__setattr__(self, name, _arrays.text(getattr(self, name), name, n))
        object.__setattr__(self, "behind", _arrays.floats(self.behind, "behind", (n,), finite=True))
        object.__setattr__(self, "fresh", np.asarray(self.fresh, bool))

    def __len__(self) -> int:
        return len(self.time)

    @staticmethod
    def concat(parts: Sequence[ClockReferences]) -> ClockReferences:
        """Join tables; what is there twice is kept once."""
        names = ("receiver", "time", "behind", "source", "fresh")
        empty = ([np.empty(0, t)] for t in ("U1", np.int64, float, "U1", bool))
        columns = [
            np.concatenate([*none, *(getattr(p, n) for p in parts)])
            for n, none in zip(names, empty, strict=True)
        ]
        seen = dict.fromkeys(zip(*(c.tolist() for c in columns), strict=True))
        rows = list(seen)
        return ClockReferences(
            np.array([r[0] for r in rows], str),
            np.array([r[1] for r in rows], np.int64),
            np.array([r[2] for r in rows], float),
            np.array([r[3] for r in rows], str),
            np.array([r[4] for r in rows], bool),
        )

    def describe(self) -> list[str]:
        """One line a receiver: how far its clock was off, and when."""
        out = []
        for name in np.unique(self.receiver):
            rows = np.flatnonzero(self.receiver == name)
            rows = rows[np.argsort(self.time[rows], kind="stable")]
            said = [
                f"{self.behind[i]:+.3g} s {str(self.source[i]).lower()} {iso(int(self.time[i]), 0)}"
                for i in rows[[0, -1] if len(rows) > 1 else [0]]
            ]
            more = f" ({len(rows)} comparisons)" if len(rows) > 2 else ""
            out.append(f"clock of {name} to be corrected by {', then '.join(said)}{more}")
        return out


class _Run(NamedTuple):
    """One receiver's clock between two settings of it: references in time order."""

    start: int
    time: np.ndarray
    behind: np.ndarray


def correct_clocks(detections: Detections, references: ClockReferences) -> Detections:
    """Correct device times along straight lines between comparisons of clocks.

    Before the first and after the last comparison of a run the nearest line goes on. A clock that
    was set begins a new run; a run of one comparison is shifted as a whole. Detections from before
    a clock was first compared, or of a receiver without comparisons, stay as they are, with a
    warning.

    Parameters
    ----------
    detections : Detections
        On the receivers' own clocks.
    references : ClockReferences
        Comparisons.

    Returns
    -------
    Detections
        In the same order, notes added to its report.
    """
    time = detections.time.copy()
    done = np.zeros(len(time), bool)
    for name in detections.receivers:
        mine = np.flatnonzero(detections.receiver == name)
        runs = _runs(references, name)
        ends = [r.start for r in runs[1:]] + [np.iinfo(np.int64).max] * bool(runs)
        for run, end in zip(runs, ends, strict=True):
            rows = mine[(time[mine] >= run.start) & (detections.time[mine] < end) & ~done[mine]]
            shift = _lines(detections.time[rows], run)
            time[rows] = detections.time[rows] + np.rint(shift * NS).astype(np.int64)
            done[rows] = True
    notes = []
    if done.any():
        moved = (time[done] - detections.time[done]) / NS
        text = (
            f"{int(done.sum())} detections corrected along lines between comparisons of clocks, "
            f"by {moved.min():+.3g} to {moved.max():+.3g} s"
        )
        notes.append(Note("info", text, int(done.sum())))
    for name in np.unique(detections.receiver[~done]):
        n = int((detections.receiver[~done] == name).sum())
        text = f"{n} detections of {name} have no comparison of clocks: device times kept"
        notes.append(Note("warning", text, n))
    return replace(detections, time=time, report=detections.report.add(*notes))


def _runs(references: ClockReferences, name: str) -> list[_Run]:
    rows = np.flatnonzero(references.receiver == name)
    rows = rows[np.argsort(references.time[rows], kind="stable")]
    runs: list[list[int]] = []
    for i in rows:
        if not runs or references.fresh[i]:
            runs.append([])
        runs[-1].append(int(i))
    out = []
    for r in runs:
        # comparisons are logged in whole seconds, cut or rounded
        start = references.time[r[0]] - NS if references.fresh[r[0]] else np.iinfo(np.int64).min
        out.append(_Run(int(start), references.time[r], references.behind[r]))
    return out


def _lines(time: np.ndarray, run: _Run) -> np.ndarray:
    """Seconds to add at `time` (N,): straight lines through a run's comparisons, and beyond."""
    t = (time - run.time[0]) / NS
    known, first = np.unique((run.time - run.time[0]) / NS, return_index=True)
    behind = run.behind[first]
    if len(known) == 1:
        return np.full(len(t), behind[0])
    k = np.clip(np.searchsorted(known, t, side="right") - 1, 0, len(known) - 2)
    slope = np.diff(behind) / np.diff(known)
    return behind[k] + slope[k] * (t - known[k])


@dataclass(frozen=True, repr=False, eq=False)
class Events:
    """A receiver's log: what happened when, exactly as the file has it.

    Parameters
    ----------
    time : array (N,) of int64
        ns since 1970 UTC on the receiver's own clock.
    receiver : array (N,) of str
        Serial or name.
    kind : array (N,) of str
        "PC Time", "Initialization", "Temperature", ... as in the file.
    value : array (N,) of str
        Number or text, "" = none.
    unit : array (N,) of str
        "" = none.
    references : ClockReferences
        The comparisons of clocks among the events.
    report : ReadReport
        What was read, and the notes made on the way.
    """

    time: np.ndarray
    receiver: np.ndarray
    kind: np.ndarray
    value: np.ndarray
    unit: np.ndarray
    references: ClockReferences = field(default_factory=lambda: ClockReferences.concat([]))
    report: ReadReport = field(default_factory=ReadReport)

    def __post_init__(self) -> None:
        time = _arrays.times(self.time, "time")
        object.__setattr__(self, "time", time)
        for name in ("receiver", "kind", "value", "unit"):
            object.__setattr__(self, name, _arrays.text(getattr(self, name), name, len(time)))

    def __len__(self) -> int:
        return len(self.time)

    @staticmethod
    def concat(parts: Sequence[Events]) -> Events:
        """Join logs, each as it is."""
        parts = list(parts)
        columns = {
            n: np.concatenate([getattr(p, n) for p in parts])
            for n in ("time", "receiver", "kind", "value", "unit")
        }
        references = ClockReferences.concat([p.references for p in parts])
        report = ReadReport.merge(p.report for p in parts)
        return Events(**columns, references=references, report=report)

    def measured(self, word: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a log of numbers, such as the temperature.

        Parameters
        ----------
        word : str
            Events whose kind holds it are taken, such as "temperature"; values that are no
            numbers are passed over.

        Returns
        -------
        time : array (M,) of int64
            ns since 1970 UTC.
        receiver : array (M,) of str
            Serial or name.
        value : array (M,) of float64
            In the unit of the file.
        """
        rows, values = [], []
        for i, (kind, value) in enumerate(zip(self.kind, self.value, strict=True)):
            if word.lower() in str(kind).lower():
                try:
                    values.append(float(value))
                except ValueError:
                    continue
                rows.append(i)
        return self.time[rows], self.receiver[rows], np.array(values, float)

    def __repr__(self) -> str:
        if not len(self):
            return "Events: none"
        kinds, names = np.unique(self.kind), np.unique(self.receiver)
        span = duration((int(self.time.max()) - int(self.time.min())) / NS)
        return (
            f"Events: {len(self)} of {len(kinds)} kinds at {len(names)} receivers in {span}, "
            f"{len(self.references)} comparisons of clocks{self.report.flag}"
        )
