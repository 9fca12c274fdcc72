"""Sync arrivals, where they came from, and how likely each came by the direct path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

__all__ = [
    "Arrivals", "Geometry", "Links", "distances", "links", "log_density", "low_quantile",
    "p_direct", "travel_derivative",
]  # fmt: skip

LATEST = 0.3  # largest lateness of a reflection, s
BACKGROUND = 0.003  # share of arrivals that are anything
SHORTEST = 1e-6  # a receiver and a tag closer than this have no direction, m
DELAY_SD = 3e-3  # prior of the delay with which a receiver hears its own sync tag, s


class Arrivals(NamedTuple):
    """Sync arrivals, all arrays (N,), those of a ping side by side and pings in time order.

    Attributes
    ----------
    recorded : float
        Time on the receiver's clock, s.
    receiver : int
        Clock.
    ping : int
        0..P-1, every one present, ascending.
    place, source : int
        Deployment that heard it and deployment beside which it was emitted.
    segment : int
        How many jumps of its clock lie before it.
    """

    recorded: np.ndarray
    receiver: np.ndarray
    ping: np.ndarray
    place: np.ndarray
    source: np.ndarray
    segment: np.ndarray


class Geometry(NamedTuple):
    """Where deployments are, how fast sound is, and how well that is known.

    Attributes
    ----------
    xyz : array (D, 3)
        Metres; z = 0 everywhere where depths are not all known.
    sd : array (D,)
        Prior sd of x and of y of each deployment, m; 0 = as given.
    sound_speed, sound_speed_sd : float
        Prior of the sound speed, m/s; sd 0 = as given.
    relative : array (K,), optional
        Given sound speed at each knot over `sound_speed`; 1 by default.
    """

    xyz: np.ndarray
    sd: np.ndarray
    sound_speed: float
    sound_speed_sd: float
    relative: np.ndarray | None = None


class Links(NamedTuple):
    """Who heard whom on which stretch of its clock: arrivals of a link share all derivatives.

    Attributes
    ----------
    place, source, receiver, segment : int arrays (L,)
        Sorted by receiver.
    of : array (N,) of int
        Link of each arrival.
    """

    place: np.ndarray
    source: np.ndarray
    receiver: np.ndarray
    segment: np.ndarray
    of: np.ndarray

    @property
    def own(self) -> np.ndarray:
        """Whether a receiver hears the sync tag beside it (L,)."""
        return np.asarray(self.place == self.source)


def links(a: Arrivals) -> Links:
    """Find the links of some arrivals."""
    bits = [int(x.max(initial=0)) + 1 for x in (a.place, a.source, a.segment)]
    key = ((a.receiver * bits[0] + a.place) * bits[1] + a.source) * bits[2] + a.segment
    _, first, of = np.unique(key, return_index=True, return_inverse=True)
    return Links(a.place[first], a.source[first], a.receiver[first], a.segment[first], of)


def distances(xyz: np.ndarray, place: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Distance (N,) between two deployments each, m."""
    return np.linalg.norm(xyz[place] - xyz[source], axis=1)


def travel_derivative(at: Links, xyz: np.ndarray, slowness: float) -> np.ndarray:
    """Derivative (L, 2 D) of the travel time to x and y of each deployment, s/m."""
    distance = distances(xyz, at.place, at.source)
    away = (xyz[at.place, :2] - xyz[at.source, :2]) / np.maximum(distance, SHORTEST)[:, None]
    away = np.where(distance[:, None] > SHORTEST, away, 0.0) * slowness
    rows = np.zeros((len(distance), len(xyz), 2))
    each = np.arange(len(distance))
    rows[each, at.place] += away
    rows[each, at.source] -= away
    return rows.reshape(len(distance), -1)


def p_direct(residual: np.ndarray, sigma: float, reflected: float) -> np.ndarray:
    """Probability (N,) that arrivals with these residuals (s) came by the direct path.

    Direct arrivals are N(0, sigma), reflected ones later by U(0, `LATEST`) besides, and a small
    share is anything within +-`LATEST`: late arrivals lose all weight, and so do wild ones.
    """
    direct, rest = _densities(residual, sigma, reflected)
    return direct / (direct + rest)


def log_density(residual: np.ndarray, sigma: float, reflected: float) -> np.ndarray:
    """Log density (N,) of residuals (s), direct or not, 1/s."""
    return np.log(sum(_densities(residual, sigma, reflected)))


def _densities(
    residual: np.ndarray, sigma: float, reflected: float
) -> tuple[np.ndarray, np.ndarray]:
    z = residual / sigma
    direct = (1 - reflected - BACKGROUND) * np.exp(-0.5 * z * z) / (sigma * np.sqrt(2 * np.pi))
    late = reflected * (ndtr(z) - ndtr((residual - LATEST) / sigma)) / LATEST
    return direct, late + BACKGROUND / (2 * LATEST)


def low_quantile(y: np.ndarray, ping: np.ndarray, quantile: float = 0.35) -> np.ndarray:
    """Low quantile of each ping (P,): reflections are only late, so the middle lies too high."""
    order = np.lexsort((y, ping))
    count = np.bincount(ping)
    return y[order][np.cumsum(count) - count + ((count - 1) * quantile).astype(int)]
