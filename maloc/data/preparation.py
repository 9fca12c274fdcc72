"""Raw detections before any clock is known: echoes, impossible repeats, deployments, odd clocks.

Everything here looks at one receiver at a time, so that it holds whatever its clock shows. Nothing
is removed: each detection gets its reason, and what is kept is a choice of the caller.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from maloc.data import _pings
from maloc.data._screen import TOO_SOON, screen
from maloc.data._time import NS, duration, iso
from maloc.data.detections import Detections
from maloc.data.grouping import ECHO_S
from maloc.data.receivers import Receivers
from maloc.data.report import Note

__all__ = ["Prepared", "clock_notes", "prepare"]

LONE = 30  # mean burst intervals without another detection: the usual false-detection filter
UNSET = 946_684_800 * NS  # 2000-01-01; receivers' clocks start before it when they are not set


@dataclass(frozen=True, repr=False, eq=False)
class Prepared:
    """What each detection is, and why some should not be used.

    Parameters
    ----------
    detections : Detections
        As read.
    why : array (N,) of str
        Why a detection is to be set aside, "" = nothing speaks against it.
    echo_of : array (N,) of int64
        Row of the detection that this one repeats, -1 = none.
    lone : array (N,) of bool
        No other detection of the tag within 30 mean burst intervals: perhaps false. Only where
        the limits of the interval are known; not a reason to set it aside.
    notes : tuple of Note
        Counts of all this.
    """

    detections: Detections
    why: np.ndarray
    echo_of: np.ndarray
    lone: np.ndarray
    notes: tuple[Note, ...] = field(default=())

    @property
    def too_soon(self) -> np.ndarray:
        """Where (N,) a detection is too near another at its receiver to be a ping."""
        return np.char.endswith(self.why, TOO_SOON)

    @property
    def kept(self) -> Detections:
        """The detections that nothing speaks against, notes in their report."""
        kept = self.detections.select(mask=self.why == "")
        report = kept.report.add(*self.notes)
        return Detections(kept.time, kept.receiver, kept.tag, kept.extra, report)


def prepare(
    detections: Detections,
    receivers: Receivers | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> Prepared:
    """Sort out what a receiver's own times show to be no new ping of a tag.

    - A second detection of a tag within .5 s (less for burst intervals below 1 s) at one receiver
      is an echo of the first (they come 20 to 200 ms later).
    - Two detections at one receiver closer than the shortest burst interval cannot both be right,
      unless another receiver heard both (tags ping faster when they are switched on). Set aside
      is what no other receiver heard, and of that what leaves most (`maloc.data._screen`).
    - Detections outside any deployment of their receiver, or of a receiver not in the table.

    Parameters
    ----------
    detections : Detections
        On the receivers' own clocks.
    receivers : Receivers, optional
        The array; deployments are not looked at without it.
    limits : mapping of str to (float, float), optional
        Shortest and longest burst interval (s) of tags. The lower one screens: a maker's delay
        *between* pings is shorter than the interval and does no harm.

    Returns
    -------
    Prepared
    """
    n = len(detections)
    why = np.full(n, "", dtype=object)
    echo_of, lone = np.full(n, -1, np.int64), np.zeros(n, bool)
    notes: list[Note] = []
    if receivers is not None:
        _deployments(detections, receivers, why, notes)
    limits = limits or {}
    heard: dict[str, list[tuple[str, np.ndarray]]] = {}  # first detections, by tag
    for tag, receiver, rows in _trains(detections, why):
        shortest, _ = limits.get(tag, (0.0, 0.0))
        time = (detections.time[rows] - detections.time[rows[0]]) / NS
        window = min(ECHO_S, shortest / 2) if shortest > 0 else ECHO_S
        head = _pings.echoes(time, np.zeros(len(time), np.int64), window)
        echo = np.flatnonzero(head >= 0)
        echo_of[rows[echo]] = rows[head[echo]]
        for i in echo:
            why[rows[i]] = f"echo, {1000 * (time[i] - time[head[i]]):.0f} ms after the first"
        if shortest > 0:
            heard.setdefault(tag, []).append((receiver, rows[head < 0]))
    for tag, trains in heard.items():
        notes += screen(detections.time, tag, trains, limits[tag], why)
    if limits:
        _lone(detections, why, limits, lone)
    notes += _counts(why, lone)
    return Prepared(detections, why.astype(str), echo_of, lone, tuple(notes))


def _deployments(
    detections: Detections, receivers: Receivers, why: np.ndarray, notes: list[Note]
) -> None:
    deployment = receivers.deployment_of(detections.receiver, detections.time)
    for name in detections.receivers:
        mine = detections.receiver == name
        n = int((deployment[mine] < 0).sum())
        if not receivers.knows(name):
            why[mine] = f"receiver {name} is not in the table"
            text = f"receiver {name} ({n} detections) is not in the receivers table: takes no part"
            notes.append(Note("warning", text, n))
        elif n:
            why[mine & (deployment < 0)] = f"outside any deployment of {name}"
            text = f"{n} detections of {name} are outside any deployment of it: they take no part"
            notes.append(Note("warning", text, n))


def _trains(detections: Detections, why: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yield tag, receiver and rows in time order, where a receiver heard a tag more than once."""
    tags, tag = np.unique(detections.tag, return_inverse=True)
    names, who = np.unique(detections.receiver, return_inverse=True)
    rows = np.flatnonzero(why == "")
    key = tag[rows] * max(len(names), 1) + who[rows]
    order = np.lexsort((detections.time[rows], key))
    rows, key = rows[order], key[order]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(key)) + 1, [len(rows)]])
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if b - a > 1:
            t, r = divmod(int(key[a]), len(names))
            yield str(tags[t]), str(names[r]), rows[a:b]


def _lone(
    detections: Detections,
    why: np.ndarray,
    limits: Mapping[str, tuple[float, float]],
    lone: np.ndarray,
) -> None:
    for tag, (lo, hi) in limits.items():
        rows = np.flatnonzero((detections.tag == tag) & (why == ""))
        rows = rows[np.argsort(detections.time[rows], kind="stable")]
        gap = np.diff(detections.time[rows]) / NS
        after, before = np.append(gap, np.inf), np.concatenate([[np.inf], gap])
        lone[rows] = np.minimum(after, before) > LONE * (lo + hi) / 2


def _counts(why: np.ndarray, lone: np.ndarray) -> list[Note]:
    notes = []
    echo = np.array([w.startswith("echo, ") for w in why], bool)
    soon = np.array([w.endswith(TOO_SOON) for w in why], bool)
    for mine, level, text in (
        (echo, "info", f"second detections of a ping within {ECHO_S:g} s at one receiver (echoes)"),
        (soon, "info", "detections too soon after another at their receiver: one of them is false"),
        (lone, "info", f"detections with no other of their tag within {LONE} burst intervals: "
         "perhaps false"),
    ):  # fmt: skip
        if n := int(mine.sum()):
            notes.append(Note(level, f"{n} {text}", n))
    return notes


def clock_notes(detections: Detections) -> list[Note]:
    """Point out receivers whose clock cannot be right, from the order and the span of times."""
    notes: list[Note] = []
    if not len(detections):
        return notes
    spans = {}
    for name in detections.receivers:
        time = detections.time[detections.receiver == name]
        early = time < UNSET
        if n := int(early.sum()):
            text = f"{n} detections of {name} are dated before 2000: its clock was not set"
            notes.append(Note("warning", text, n))
        step = np.diff(time)
        back = np.flatnonzero(step < -NS)
        if 0 < len(back) <= 0.05 * len(step):  # else the file is not in the order of time at all
            by, when = float(-step[back[0]]) / NS, iso(int(time[back[0]]))
            text = (
                f"times of {name} go back {len(back)} time{'s' * (len(back) != 1)} (first by "
                f"{duration(by)} after {when}): its clock was set back, or rows are out of order"
            )
            notes.append(Note("warning", text, len(back)))
        spans[name] = (int(time.min()), int(time.max()))
    if len(spans) > 2:
        for name, (first, last) in spans.items():
            other = [s for n, s in spans.items() if n != name]
            if last < min(s[0] for s in other) or first > max(s[1] for s in other):
                text = (
                    f"{name} heard tags only from {iso(first, 0)} to {iso(last, 0)}, when no other "
                    "receiver did: another deployment, or its clock is far off"
                )
                notes.append(Note("warning", text))
    return notes
