"""Laws of the burst interval: from one ping of a tag to its next.

Every law has the same surface: `density`, `survival`, `first_density`, `mean`, `sd`, `lo`, `hi`,
`breaks` and `log_sum_density`, the density of the sum of m intervals. Real tags break their stated
limits by some milliseconds, so a uniform law's edges are ramps as wide as `soft_limits` allows.
With an `expiry` hazard kappa (the tag falls silent for good) the density is f(x) exp(-kappa x) and
survival is one minus its integral.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr

from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.schedule.sums import soft_limits
from maloc.schedule.table import Table, checked_expiry, log_normal

__all__ = ["IntervalLaw", "Poisson", "Stable", "Table", "interval_law", "uniform_law"]

_REACH = 6.0  # sds of a stable interval that count as possible


@dataclass(frozen=True)
class Stable:
    """Interval normal around a mean: a crystal's beat that drifts slowly.

    Parameters
    ----------
    mean, sd : float
        Seconds, positive.
    expiry : float
        Hazard of the tag's falling silent for good, per s.

    Raises
    ------
    InputError
        If a number is not positive, or the sd exceeds a quarter of the mean.
    """

    mean: float
    sd: float
    expiry: float = 0.0

    def __post_init__(self) -> None:
        checked_expiry(self.expiry)
        if not (0 < self.sd and self.mean > 0 and np.isfinite(self.mean)):
            raise InputError(f"stable interval {self.mean:g} s, sd {self.sd:g} s is not positive")
        if self.sd > 0.25 * self.mean:
            raise InputError(
                f"stable interval: sd {self.sd:g} s is above a quarter of {self.mean:g} s",
                mend="give it as random MIN MAX",
            )

    @property
    def lo(self) -> float:
        """Shortest interval, s: 6 sd below the mean, at least a quarter of it."""
        return max(self.mean - _REACH * self.sd, 0.25 * self.mean)

    @property
    def hi(self) -> float:
        """Longest interval, s: 6 sd above the mean."""
        return self.mean + _REACH * self.sd

    @property
    def breaks(self) -> tuple[float, ...]:
        """Lengths at which the density changes fast, s."""
        return tuple(self.mean + self.sd * np.arange(-6.0, 7.0))

    def density(self, x) -> np.ndarray:
        """Density of the interval at x, 1/s, the shape of x."""
        x = np.asarray(x, float)
        return np.exp(log_normal(x, self.mean, self.sd) - self.expiry * x)

    def survival(self, x) -> np.ndarray:
        """Probability that no ping has followed within x s, the shape of x."""
        z, k = (np.asarray(x, float) - self.mean) / self.sd, self.expiry * self.sd
        tilt = np.exp(0.5 * k**2 - self.expiry * self.mean)  # completes the square
        return 1 - tilt * ndtr(z + k)

    def first_density(self, x, at_start: bool) -> np.ndarray:
        """Density of the first ping's time after the study's start; see `Table.first_density`."""
        x = np.asarray(x, float)
        if at_start:
            plain = np.where(x <= self.mean / 2, 2 / self.mean, 0.0)
        else:
            plain = ndtr((self.mean - x) / self.sd) / self.mean
        return np.where(x >= 0, plain * np.exp(-self.expiry * x), 0.0)

    def first_breaks(self, at_start: bool) -> tuple[float, ...]:
        """Times at which `first_density` is not smooth, s."""
        return (0.0, self.mean / 2) if at_start else (0.0, *self.breaks)

    def log_sum_density(self, m, total) -> np.ndarray:
        """Log density of the sum of m intervals (broadcast)."""
        m, total = np.asarray(m), np.asarray(total, float)
        return log_normal(total, m * self.mean, np.sqrt(m) * self.sd) - self.expiry * total


@dataclass(frozen=True)
class Poisson:
    """Cues at random times at a constant rate: the interval is exponential.

    Parameters
    ----------
    mean : float
        Mean interval, s, positive.
    expiry : float
        Hazard of the animal's falling silent for good, per s.

    Raises
    ------
    InputError
        If a number is not as above.
    """

    mean: float
    expiry: float = 0.0

    def __post_init__(self) -> None:
        checked_expiry(self.expiry)
        if not (self.mean > 0 and np.isfinite(self.mean)):
            raise InputError(f"a mean interval of {self.mean:g} s is not positive")

    @property
    def lo(self) -> float:
        """Shortest possible interval: 0 s."""
        return 0.0

    @property
    def hi(self) -> float:
        """Longest possible interval: infinite."""
        return float("inf")

    @property
    def sd(self) -> float:
        """Standard deviation of the interval, s."""
        return self.mean

    @property
    def breaks(self) -> tuple[float, ...]:
        """Lengths at which the density is not smooth, s."""
        return (0.0,)

    def density(self, x) -> np.ndarray:
        """Density of the interval at x, 1/s, the shape of x."""
        x = np.asarray(x, float)
        return np.where(x >= 0, np.exp(-(1 / self.mean + self.expiry) * x) / self.mean, 0.0)

    def survival(self, x) -> np.ndarray:
        """Probability that no ping has followed within x s, the shape of x."""
        total = 1 / self.mean + self.expiry
        return 1 + np.expm1(-total * np.maximum(np.asarray(x, float), 0.0)) / (self.mean * total)

    def first_density(self, x, at_start: bool) -> np.ndarray:
        """Density of the first ping's time after the study's start: the interval's own."""
        del at_start
        return self.density(x)


IntervalLaw: TypeAlias = Table | Stable | Poisson


def uniform_law(low: float, high: float, edge: float | None = None, expiry: float = 0.0) -> Table:
    """Interval uniform between limits, its edges ramps.

    Parameters
    ----------
    low, high : float
        MIN and MAX, s, ``0 <= low <= high``.
    edge : float, optional
        How far a limit may be passed either way, s; the ramp is twice as wide. Default: what
        `soft_limits` allows (5 ms + 1e-4 of the limit).
    expiry : float
        Hazard of the tag's falling silent for good, per s.

    Returns
    -------
    Table
        A trapezoid; a triangle where the ramps meet.

    Raises
    ------
    InputError
        If the limits are no interval.
    """
    if not (np.isfinite(high) and 0 <= low <= high and high > 0):
        raise InputError(f"burst interval {low:g} to {high:g} s")
    if edge is None:
        first, last = soft_limits(Schedule("random", max(low, 1e-9), high))
        first = min(first, low)
    else:
        first, last = max(low - edge, 0.0), high + edge
    below, above = low - first, last - high
    if below + above <= 0:  # not even a ramp: as steep as numbers allow
        first, last = low * (1 - 1e-6), high * (1 + 1e-6)
        below, above = low - first, last - high
    share = min(1.0, (high - low) / (below + above)) if below + above > 0 else 1.0
    x = [first, low + share * (low - first), high - share * (last - high), last]
    y = [0.0 if low > first else 1.0, 1.0, 1.0, 0.0]
    keep = [0, *(i for i in (1, 2, 3) if x[i] > x[i - 1])]
    return Table(tuple(x[i] for i in keep), tuple(y[i] for i in keep), expiry, (low, high))


def interval_law(schedule: Schedule, expiry: float = 0.0, slack: float = 0.0) -> IntervalLaw:
    """Law of the burst interval that a schedule states.

    Parameters
    ----------
    schedule : Schedule
        Random: uniform with soft edges. Stable: normal, its sd with the tags' own tolerance added
        in squares (`soft_limits`). Poisson: exponential.
    expiry : float
        Hazard of the tag's falling silent for good, per s.
    slack : float
        How far a heard ping's time may be off either way, s (1 s for clocks read to whole
        seconds): widens the edges, or the sd.

    Returns
    -------
    IntervalLaw
        A `Table`, `Stable` or `Poisson`, hashable.

    Raises
    ------
    InputError
        If the schedule is unknown, or the hazard or the slack is below 0.
    """
    if not (np.isfinite(slack) and slack >= 0):
        raise InputError(f"a slack of {slack:g} s is not zero or more")
    if schedule.kind == "poisson":
        return Poisson(schedule.lo, expiry)
    first, last = soft_limits(schedule)
    if schedule.kind == "stable":
        return Stable(first, float(np.hypot(last, slack / np.sqrt(3))), expiry)
    edge = max(schedule.lo - first, last - schedule.hi) + slack
    return uniform_law(schedule.lo, schedule.hi, min(edge, 0.9 * schedule.lo), expiry)
