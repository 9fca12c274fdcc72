"""One tag's detections on their way into pings: placed, sorted, and set aside with a reason."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from maloc.data import _pings
from maloc.data.arrivals import SetAside
from maloc.data.detections import Detections
from maloc.data.receivers import Receivers
from maloc.data.report import Note

__all__ = ["Sorting"]


@dataclass
class Sorting:
    """The detections of one tag on their way into pings; `keep` shrinks as some are set aside."""

    detections: Detections
    receivers: Receivers
    tag: str
    rows: np.ndarray
    time: np.ndarray
    column: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    ping: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    aside: list[tuple[np.ndarray, np.ndarray, list[str]]] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    def drop(self, gone: np.ndarray, why: list[str], summary: str, level: str = "info") -> None:
        """Set the detections where `gone` is true aside, each with its reason."""
        count = int(gone.sum())
        if not count:
            return
        self.aside.append((self.rows[gone], self.time[gone], why))
        self.notes.append(Note(level, f"{count} {summary}", count))
        for name in ("rows", "time", "column", "ping"):
            values = getattr(self, name)
            if len(values) == len(gone):
                setattr(self, name, values[~gone])

    def place(self) -> None:
        """Find each detection's deployment, sort by time, set aside what has none."""
        order = np.argsort(self.time, kind="stable")
        self.rows, self.time = self.rows[order], self.time[order]
        names = self.detections.receiver[self.rows]
        column = self.receivers.deployment_of(names, self.detections.time[self.rows])
        self.column = column
        for name in np.unique(names[column < 0]):
            gone = (self.detections.receiver[self.rows] == name) & (self.column < 0)
            if self.receivers.knows(str(name)):
                why, s = f"outside any deployment of {name}", "dropped as outside any deployment of"
            else:
                why, s = f"receiver {name} is not in the table", "of a receiver not in the table:"
            self.drop(gone, [why] * int(gone.sum()), f"detections {s} {name}", "warning")

    def drop_echoes(self, window: float) -> None:
        """Keep the first of several detections within `window` s at one receiver."""
        head = _pings.echoes(self.time, self.column, window)
        gone = head >= 0
        ms = 1000 * (self.time[gone] - self.time[head[gone]])
        why = [f"echo, {m:.0f} ms after the first" for m in ms]
        self.drop(gone, why, f"echoes (second detections within {window:g} s at one receiver)")

    def drop_impossible(self, travel: np.ndarray, shortest: float, slack: float) -> None:
        """Set aside lone detections too near a well-heard ping for another emission."""
        size = np.bincount(self.ping)
        lone = np.flatnonzero(size[self.ping] == 1)
        firm = np.flatnonzero(size[self.ping] > 1)
        gone, why = np.zeros(len(self.time), bool), []
        if not len(firm):
            return
        reach = shortest + float(travel.max())
        for i in lone:
            a, b = np.searchsorted(self.time[firm], self.time[i] + np.array([-reach, reach]))
            near = firm[a:b]
            apart = np.abs(self.time[near] - self.time[i])
            apart = apart + travel[self.column[near], self.column[i]] + slack
            if len(apart) and apart.min() < shortest:
                gone[i] = True
                n = size[self.ping[near[apart.argmin()]]]
                gap = float(np.abs(self.time[near] - self.time[i]).min())
                why.append(f"alone, {gap:.3f} s from a ping that {n} receivers heard")
        self.drop(gone, why, "lone detections nearer to a ping than the burst interval allows")
        self.ping = np.unique(self.ping, return_inverse=True)[1]

    def set_aside(self) -> SetAside:
        """What was set aside so far, in time order."""
        rows = np.concatenate([a[0] for a in self.aside] or [np.empty(0, np.int64)])
        times = np.concatenate([a[1] for a in self.aside] or [np.empty(0)])
        order = np.argsort(times, kind="stable")
        why = np.array([w for a in self.aside for w in a[2]], dtype=str)
        return SetAside(
            self.detections.receiver[rows][order], times[order], rows[order], why[order]
        )
