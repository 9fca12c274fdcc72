"""The tabulated interval law: density linear between points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from maloc.errors import InputError
from maloc.schedule.sums import log_uniform_sum

__all__ = [
    "Table",
    "checked_expiry",
    "log_normal",
]

_GAUSS = np.polynomial.legendre.leggauss(12)


def checked_expiry(expiry: float) -> None:
    """Raise InputError if a hazard (1/s) is negative or not finite."""
    if not (np.isfinite(expiry) and expiry >= 0):
        raise InputError(f"an expiry hazard of {expiry:g} per s is not zero or more")


@dataclass(frozen=True)
class Table:
    """Interval law from a table: density linear between points, zero outside.

    Parameters
    ----------
    x : tuple of float
        Interval lengths, s, ascending, the first one 0 or more.
    values : tuple of float
        Density at `x`, any positive scale: normalised here.
    expiry : float
        Hazard of the tag's falling silent for good, per s.
    limits : tuple of float, optional
        MIN and MAX of the uniform law that the table is, s (see `uniform_law`).

    Raises
    ------
    InputError
        If the table is no density or the hazard is below 0.
    """

    x: tuple[float, ...]
    values: tuple[float, ...]
    expiry: float = 0.0
    limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        checked_expiry(self.expiry)
        x, y = np.asarray(self.x, float), np.asarray(self.values, float)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise InputError("an interval's table needs two columns of the same length, 2 or more")
        if not (np.all(np.isfinite(x)) and x[0] >= 0 and np.all(np.diff(x) > 0)):
            raise InputError("an interval's table must ascend from 0 s or more")
        area = float(np.trapezoid(y, x))
        if not (np.all(np.isfinite(y)) and np.all(y >= 0) and area > 0):
            raise InputError("an interval's density must be zero or more, and not all zero")
        object.__setattr__(self, "x", tuple(float(v) for v in x))
        object.__setattr__(self, "values", tuple(float(v) for v in y / area))

    @property
    def lo(self) -> float:
        """Shortest possible interval, s."""
        return self.x[0]

    @property
    def hi(self) -> float:
        """Longest possible interval, s."""
        return self.x[-1]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Lengths at which the density is not smooth, s."""
        return self.x

    @cached_property
    def _moments(self) -> tuple[float, float]:
        x, w = self._nodes(np.asarray(self.x[:-1]), np.asarray(self.x[1:]))
        w = w * np.interp(x, self.x, self.values)
        mean = float(np.sum(w * x))
        return mean, float(np.sqrt(np.sum(w * (x - mean) ** 2)))

    @property
    def mean(self) -> float:
        """Mean interval of a tag that does not fall silent, s."""
        return self._moments[0]

    @property
    def sd(self) -> float:
        """Standard deviation of the interval of a tag that does not fall silent, s."""
        return self._moments[1]

    def density(self, x) -> np.ndarray:
        """Density of the interval at x, 1/s, the shape of x."""
        x = np.asarray(x, float)
        return np.interp(x, self.x, self.values, left=0.0, right=0.0) * np.exp(-self.expiry * x)

    @staticmethod
    def _nodes(start, end) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Legendre points and weights between start and end, (..., 12)."""
        half = (end - start)[..., None] / 2
        return (start + end)[..., None] / 2 + half * _GAUSS[0], half * _GAUSS[1]

    @cached_property
    def _mass(self) -> np.ndarray:
        x, w = self._nodes(np.asarray(self.x[:-1]), np.asarray(self.x[1:]))
        return np.concatenate([[0.0], np.cumsum(np.sum(w * self.density(x), axis=-1))])

    def survival(self, x) -> np.ndarray:
        """Probability that no ping has followed within x s, the shape of x."""
        knots = np.asarray(self.x)
        x = np.clip(np.asarray(x, float), knots[0], knots[-1])
        k = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
        at, w = self._nodes(knots[k], x)
        return np.maximum(1 - self._mass[k] - np.sum(w * self.density(at), axis=-1), 0.0)

    def first_density(self, x, at_start: bool) -> np.ndarray:
        """Density of the first ping's time after the study's start, 1/s, the shape of x.

        Parameters
        ----------
        x : array
            Seconds after the start, 0 or more.
        at_start : bool
            True: the first ping falls uniformly in [0, MAX / 2] (Hostetter & Royle 2020). False:
            the tag has been pinging for long, so the density is survival / mean.
        """
        x = np.asarray(x, float)
        if at_start:
            plain = np.where(x <= self._first_end, 1 / self._first_end, 0.0)
        else:
            alive = self if self.expiry == 0 else replace(self, expiry=0.0)
            plain = alive.survival(x) / self.mean
        return np.where(x >= 0, plain * np.exp(-self.expiry * x), 0.0)

    @property
    def _first_end(self) -> float:
        return 0.5 * (self.limits[1] if self.limits else self.hi)

    def first_breaks(self, at_start: bool) -> tuple[float, ...]:
        """Times at which `first_density` is not smooth, s."""
        return (0.0, self._first_end) if at_start else (0.0, *self.x)

    def log_sum_density(self, m, total) -> np.ndarray:
        """Log density of the sum of m intervals (broadcast), for laws of small sd / mean.

        Uniform: exact up to 300 intervals; other tables: exact for one, normal beyond.
        """
        m, total = np.broadcast_arrays(np.asarray(m), np.asarray(total, float))
        if self.limits:
            out = np.empty(total.shape)
            width = self.hi - self.lo
            for count in np.unique(m):
                here = m == count
                at = (total[here] - count * self.lo) / width
                out[here] = log_uniform_sum(int(count), at) - np.log(width)
        else:
            out = log_normal(total, m * self.mean, np.sqrt(m) * self.sd)
        with np.errstate(divide="ignore"):
            one = np.log(self.density(total)) + self.expiry * total
        return np.where(m == 1, one, out) - self.expiry * total


def log_normal(x, mean, sd) -> np.ndarray:
    """Return the log density of a normal law."""
    return -0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi)
