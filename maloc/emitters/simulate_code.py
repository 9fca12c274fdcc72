"""One code, one transmitter or two: raw detections with echoes, misses, false ones, collisions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from maloc.data import Detections, Receivers, Schedule
from maloc.errors import InputError
from maloc.simulate import Hearing, arrays
from maloc.simulate.animals import correlated_walk
from maloc.simulate.hearing import hear
from maloc.simulate.pings import burst_times

__all__ = ["CodeDesign", "CodeScene", "simulate_code"]

ORIGIN = 1_767_225_600_000_000_000  # 2026-01-01 00:00 UTC, ns: second 0
TAG = "A69-1602-1001"


@dataclass(frozen=True)
class CodeDesign:
    """What is simulated.

    Parameters
    ----------
    n_transmitters : int
        Animals whose tags have one code.
    hours : float
        How long they are there.
    schedule : Schedule
        Burst interval of each.
    hearing : Hearing
        Missing shares, late arrivals, noise and resolution.
    p_echo : float
        Share of detections that are repeated 20 to 200 ms later at the same receiver.
    false_rate : float
        False detections of the code at a receiver, 1/s.
    busy : float
        s in which a receiver that hears one tag cannot hear another.
    speed, turn : float
        Of the correlated random walk in the grid's square: mean speed, m/s, and the standard
        deviation of its change of heading in a second, radians.
    sound_speed : float
        m/s.

    Raises
    ------
    InputError
        If a number makes no sense.
    """

    n_transmitters: int = 2
    hours: float = 4.0
    schedule: Schedule = field(default_factory=lambda: Schedule("random", 60.0, 180.0))
    hearing: Hearing = field(default_factory=lambda: Hearing(scale=250.0))
    p_echo: float = 0.05
    false_rate: float = 1 / 3600
    busy: float = 3.0
    speed: float = 0.15
    turn: float = 0.135
    sound_speed: float = 1480.0

    def __post_init__(self) -> None:
        if self.n_transmitters < 1 or not self.hours > 0:
            raise InputError("a scene needs a transmitter and some time")
        if not (0 <= self.p_echo <= 1 and self.false_rate >= 0 and self.busy >= 0):
            raise InputError("p_echo is a share, false_rate and busy are not negative")


class CodeScene(NamedTuple):
    """Detections of one code and their truth.

    ``detections`` on true time; ``receivers``; ``time`` (s) and ``xy`` (m) of each transmitter's
    pings, arrays (P,) and (P, 2).
    """

    detections: Detections
    receivers: Receivers
    time: list[np.ndarray]
    xy: list[np.ndarray]


def simulate_code(rng: np.random.Generator, design: CodeDesign | None = None) -> CodeScene:
    """Draw detections of one code in a grid of sixteen receivers 100 m apart.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    design : CodeDesign, optional
        What is simulated.

    Returns
    -------
    CodeScene
        Animals start anywhere in the grid and stay in it.
    """
    design = CodeDesign() if design is None else design
    array = arrays.grid()
    r, seconds = len(array.xy), 3600 * design.hours
    (x0, y0), (x1, y1) = array.xy.min(0), array.xy.max(0)
    square = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    times, places, shown, column, sent = [], [], [], [], []
    for _ in range(design.n_transmitters):
        n = int(seconds / design.schedule.lo) + 2
        time = burst_times(rng, n, design.schedule)
        time = time[time < seconds]
        xy = correlated_walk(rng, time, square, design.speed, design.turn)
        speed = np.full(len(time), design.sound_speed)
        arrivals = hear(rng, time, xy, array.xy, speed, design.hearing)
        ping, at = np.nonzero(arrivals.heard)
        times.append(time)
        places.append(xy)
        shown.append(arrivals.observed(design.hearing.resolution)[ping, at])
        column.append(at)
        sent.append(np.full(len(at), len(sent)))
    shown, column, sent = (np.concatenate(a) for a in (shown, column, sent))
    kept = _collisions(shown, column, sent, design.busy)
    shown, column = shown[kept], column[kept]
    echo = rng.random(len(shown)) < design.p_echo
    later = shown[echo] + rng.uniform(0.02, 0.2, int(echo.sum()))
    false = rng.uniform(0.0, seconds, rng.poisson(design.false_rate * seconds * r))
    value = np.concatenate([shown, later, false])
    where = np.concatenate([column, column[echo], rng.integers(0, r, len(false))])
    order = np.argsort(value, kind="stable")
    ns = ORIGIN + np.round(1e9 * value[order]).astype(np.int64)
    detections = Detections(ns, np.array(array.name)[where[order]], np.full(len(ns), TAG))
    receivers = Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1])
    return CodeScene(detections, receivers, times, places)


def _collisions(time: np.ndarray, column: np.ndarray, sent: np.ndarray, busy: float) -> np.ndarray:
    """Which detections are left where a receiver busy with one tag is deaf to another."""
    order = np.lexsort((time, column))
    kept = np.ones(len(time), bool)
    for a, b in zip(order[:-1], order[1:], strict=True):
        soon = column[a] == column[b] and time[b] - time[a] < busy and sent[a] != sent[b]
        if soon and kept[a]:
            kept[b] = False
    return kept
