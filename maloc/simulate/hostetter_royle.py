"""The simulation study of Hostetter & Royle (2020): a square array, Brownian tags, random pings.

Lengths are receiver spacings and times burst intervals of 1 to 2; the package calls them metres
and seconds, which changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from maloc.data.arrivals import Schedule
from maloc.data.encounters import EncounterHistory
from maloc.data.receivers import Receivers
from maloc.errors import InputError

__all__ = ["Design", "SimulatedTag", "Study", "simulate_study"]

Model = Literal["independent", "detection_only", "known_interval", "unknown_interval"]
_AROUND = 5  # pings kept before the first and after the last heard one where all are known


@dataclass(frozen=True)
class Design:
    """What is simulated; the defaults are the paper's.

    Parameters
    ----------
    side : int
        Receivers along each side of the square.
    spacing : float
        Between neighbours, m; the first receiver stands at (`first`, `first`).
    first : float
        m.
    buffer : float
        Tags start anywhere up to this far outside the array, m.
    tags : int
        Number of tags.
    duration : float
        Pings are kept up to here, s.
    lo, hi : float
        Burst intervals are Uniform(lo, hi) s, the first ping Uniform(0, hi / 2) s after the start.
    p0, scale : float
        Half-normal detection p0 exp(-d^2 / (2 scale^2)), scale in m (the paper's sigma_det).
    sigma_step : float
        Brownian motion, m/s^.5 an axis (the paper's sigma_u).

    Raises
    ------
    InputError
        If a number is not positive, p0 above 1, or hi below lo.
    """

    side: int = 10
    spacing: float = 1.0
    first: float = 3.0
    buffer: float = 3.75
    tags: int = 25
    duration: float = 150.0
    lo: float = 1.0
    hi: float = 2.0
    p0: float = float(1 / (1 + np.exp(-0.25)))
    scale: float = 0.75
    sigma_step: float = 0.25

    def __post_init__(self) -> None:
        positive = ("side", "spacing", "tags", "duration", "lo", "hi", "p0", "scale", "sigma_step")
        for name in positive:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} is {value}, not a positive number")
        if self.p0 > 1 or self.hi < self.lo or self.buffer < 0:
            raise InputError("p0 is above 1, hi below lo, or the buffer below 0")

    @property
    def low(self) -> np.ndarray:
        """Lower corner of the state space (2,), m."""
        return np.full(2, self.first - self.buffer)

    @property
    def high(self) -> np.ndarray:
        """Upper corner of the state space (2,), m."""
        return np.full(2, self.first + (self.side - 1) * self.spacing + self.buffer)

    def receivers(self) -> Receivers:
        """The array, row by row."""
        x, y = np.meshgrid(*[self.first + self.spacing * np.arange(self.side)] * 2)
        names = [f"R{i + 1:03d}" for i in range(self.side**2)]
        return Receivers(np.array(names), x.ravel(), y.ravel())


@dataclass(frozen=True, eq=False)
class SimulatedTag:
    """Every ping of one tag.

    Attributes
    ----------
    name : str
    time : array (P,)
        s.
    position : array (P, 2)
        m.
    heard : array (P, R) of bool
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    heard: np.ndarray

    @property
    def was_heard(self) -> np.ndarray:
        """Pings that somebody heard, (P,) bool."""
        return self.heard.sum(axis=1) > 0


@dataclass(frozen=True, eq=False)
class Study:
    """One simulated data set: the tags that were heard at least once, with their truth."""

    design: Design
    receivers: Receivers
    tags: tuple[SimulatedTag, ...]

    def history(self, model: Model) -> EncounterHistory:
        """The data that one of the four models gets.

        Parameters
        ----------
        model : {"independent", "detection_only", "known_interval", "unknown_interval"}
            The first two: heard pings alone. Known interval: every ping from the fifth before the
            first heard one to the fifth after the last. Unknown interval: heard pings, the law of
            the burst interval, and when each tag was on.

        Raises
        ------
        InputError
            If no tag was heard, or there is no such model.
        """
        if not self.tags:
            raise InputError("no tag was heard in the simulated data set")
        if model in ("independent", "detection_only"):
            return self._history([t.was_heard for t in self.tags])
        if model == "known_interval":
            keep = [_around(t.was_heard) for t in self.tags]
            return self._history(keep, schedule=self._schedule, known=True)
        if model == "unknown_interval":
            n = len(self.tags)
            return self._history(
                [t.was_heard for t in self.tags],
                schedule=self._schedule,
                start=np.zeros(n),
                end=np.full(n, self.design.duration),
                first_at_start=True,
            )
        raise InputError(f"there is no model '{model}' in this study")

    @property
    def _schedule(self) -> Schedule:
        return Schedule("random", self.design.lo, self.design.hi)

    def _history(self, keep: list[np.ndarray], **fields) -> EncounterHistory:
        pairs = list(zip(self.tags, keep, strict=True))
        return EncounterHistory(
            time=np.concatenate([t.time[k] for t, k in pairs]),
            tag=np.repeat(np.arange(len(pairs)), [int(k.sum()) for _, k in pairs]),
            heard=np.concatenate([t.heard[k] for t, k in pairs]),
            receivers=self.receivers,
            tags=tuple(t.name for t in self.tags),
            low=self.design.low,
            high=self.design.high,
            **fields,
        )

    def truth(self, history: EncounterHistory) -> np.ndarray:
        """True positions (P, 2) of a history's pings, m."""
        out = np.empty((len(history), 2))
        for i, name in enumerate(history.tags):
            tag = next(t for t in self.tags if t.name == name)
            rows = history.tag == i
            out[rows] = tag.position[np.searchsorted(tag.time, history.time[rows])]
        return out

    def missed(self, name: str, start: float, end: float) -> int:
        """How many unheard pings a tag sent between two times, both excluded."""
        tag = next(t for t in self.tags if t.name == name)
        return int(np.sum((tag.time > start) & (tag.time < end) & ~tag.was_heard))


def _around(heard: np.ndarray) -> np.ndarray:
    """Pings from a few before the first heard to a few after the last, (P,) bool."""
    rows = np.flatnonzero(heard)
    at = np.arange(len(heard))
    return (at >= rows[0] - _AROUND) & (at <= rows[-1] + _AROUND)


def simulate_study(rng: np.random.Generator, design: Design | None = None) -> Study:
    """Simulate one data set of the paper's study.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    design : Design, optional
        The paper's by default: 10 x 10 receivers, 25 tags.

    Returns
    -------
    Study
        Tags that nobody ever heard are left out.

    References
    ----------
    Hostetter & Royle (2020) Movement-assisted localization from acoustic telemetry data. Movement
    Ecology 8: 15, "Illustration: Simulated data" and its Additional file 1.
    """
    design = Design() if design is None else design
    receivers = design.receivers()
    most = int(design.duration / design.lo) + 2
    tags = []
    for i in range(design.tags):
        start = rng.uniform(design.low, design.high)
        interval = rng.uniform(design.lo, design.hi, most)
        interval[0] = rng.uniform(0, design.hi / 2)
        time = np.cumsum(interval)
        n = int(np.searchsorted(time, design.duration, side="right"))
        step = rng.standard_normal((n, 2)) * np.sqrt(interval[:n, None])
        position = start + design.sigma_step * np.cumsum(step, axis=0)
        squared = ((position[:, None] - receivers.xy) ** 2).sum(axis=2)
        p = design.p0 * np.exp(-squared / (2 * design.scale**2))
        heard = rng.random(p.shape) < p
        if heard.any():
            tags.append(SimulatedTag(f"{i + 1:02d}", time[:n], position, heard))
    return Study(design, receivers, tuple(tags))
