"""What one transmitter's pings are like: times between them, the way from one to the next."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from maloc.data.arrivals import Schedule

__all__ = ["AWAY", "Pings", "Settings"]

AWAY = 12.0  # nats that an absence costs, however long
_LONGEST = 20  # mean intervals without a located ping that are still a gap, not an absence
_SURE = 20.0  # nats that leaving a ping out costs at most
_WILD = 0.02  # share of wrong positions
_SLACK = 0.05  # s, of an emission time


class Pings(NamedTuple):
    """Located pings in the order of their emission: s (N,), m (N, 2), m^2 (N, 2, 2), heard (N,)."""

    time: np.ndarray
    xy: np.ndarray
    covariance: np.ndarray
    n_heard: np.ndarray


@dataclass(frozen=True)
class Settings:
    """Laws of bursts and of movement.

    Parameters
    ----------
    schedule : Schedule
        Burst interval, random or stable.
    n_receivers : int
    false_rate : float
        False detections at a receiver, 1/s.
    travel : float
        Sound time across the array, s.
    missed : float
        Share of pings that are not located.
    diffusion : float
        Variance of a step a second and axis, m^2/s.
    """

    schedule: Schedule
    n_receivers: int
    false_rate: float
    travel: float
    missed: float = 0.3
    diffusion: float = 10.0

    @property
    def shortest(self) -> float:
        """Shortest burst interval, s, less what an emission may be off."""
        return self.schedule.shortest - _SLACK

    @property
    def longest(self) -> float:
        """The longest gap that is no absence, s."""
        return _LONGEST * self.schedule.mean

    def log_gap(self, gap: np.ndarray) -> np.ndarray:
        """Log density of gaps (G,) s a mean interval, pings between missed; -inf: impossible."""
        if self.schedule.kind == "stable":
            n = np.maximum(np.rint(gap / self.schedule.mean) - 1, 0).astype(int)
            density = _density(n, np.maximum(gap, 0.0), self.schedule) * self.missed**n
        else:
            grid, each = _density_table(self.schedule, self.longest)
            weight = self.missed ** np.arange(len(each))
            density = np.interp(gap, grid, weight @ each)
        with np.errstate(divide="ignore"):
            inside = np.log(density * self.schedule.mean)
        least = np.where(np.isfinite(inside), np.maximum(inside, -AWAY), -np.inf)
        return np.where(gap > self.longest, -AWAY, least)

    def log_move(self, pings: Pings, a: np.ndarray, b: np.ndarray, area: float) -> np.ndarray:
        """Log density of the way from pings a to pings b, against anywhere in the area (m^2)."""
        step = pings.xy[b] - pings.xy[a]
        dt = pings.time[b] - pings.time[a]
        s = pings.covariance[a] + pings.covariance[b]
        s = s + (self.diffusion * dt)[:, None, None] * np.eye(2)
        det = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] ** 2
        square = (
            s[:, 1, 1] * step[:, 0] ** 2
            - 2 * s[:, 0, 1] * step[:, 0] * step[:, 1]
            + s[:, 0, 0] * step[:, 1] ** 2
        ) / det
        normal = np.exp(-0.5 * square) / (2 * np.pi * np.sqrt(det)) * area
        return np.log((1 - _WILD) * normal + _WILD)

    def worth(self, n_heard: np.ndarray) -> np.ndarray:
        """Nats (N,) that a ping of n receivers is worth, against as many false detections."""
        rate = self.n_receivers * self.false_rate
        together = np.log(self.schedule.mean * rate) + (n_heard - 1) * np.log(rate * self.travel)
        return np.clip(-together, 0.0, _SURE)


def _density(n: np.ndarray, gap: np.ndarray, schedule: Schedule) -> np.ndarray:
    from maloc.schedule.signal import interval_sum_density

    return interval_sum_density(n, gap, schedule, slack=_SLACK)


@lru_cache(maxsize=8)
def _density_table(schedule: Schedule, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Gaps (G,) s, and the density (n, G), 1/s, of a gap that holds n = 0, 1, ... missed pings."""
    gap = np.linspace(0.0, longest, 200 * _LONGEST + 1)
    n = np.arange(int(longest / schedule.shortest) + 2)
    return gap, _density(n[:, None], gap[None], schedule)
