"""Sync arrivals, where they came from, and how likely each came by the direct path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.special import ndtr

__all__ = ["Arrivals", "Geometry", "distances", "low_quantile", "p_direct", "travel_derivative"]

LATEST = 0.3  # largest lateness of a reflection, s
BACKGROUND = 0.003  # share of arrivals that are anything
SHORTEST = 1e-6  # a receiver and a tag closer than this have no direction, m


class Arrivals(NamedTuple):
    """Sync arrivals, all arrays (N,).

    Attributes
    ----------
    recorded : float
        Time on the receiver's clock, s.
    receiver : int
        Clock.
    ping : int
        0..P-1, every one present.
    place, source : int
        Deployment that heard it and deployment beside which it was emitted.
    """

    recorded: np.ndarray
    receiver: np.ndarray
    ping: np.ndarray
    place: np.ndarray
    source: np.ndarray


class Geometry(NamedTuple):
    """Where deployments are and how well that is known.

    Attributes
    ----------
    xyz : array (D, 3)
        Metres; z = 0 everywhere where depths are not all known.
    sd : float
        Prior sd of x and of y of each deployment, m; 0 = as given.
    sound_speed, sound_speed_sd : float
        Prior of the sound speed, m/s; sd 0 = as given.
    """

    xyz: np.ndarray
    sd: float
    sound_speed: float
    sound_speed_sd: float


def distances(xyz: np.ndarray, place: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Distance (N,) between two deployments each, m."""
    return np.linalg.norm(xyz[place] - xyz[source], axis=1)


def p_direct(residual: np.ndarray, sigma: float, reflected: float) -> np.ndarray:
    """Probability (N,) that arrivals with these residuals (s) came by the direct path.

    Direct arrivals are N(0, sigma), reflected ones later by U(0, `LATEST`) besides, and a small
    share is anything within +-`LATEST`: late arrivals lose all weight, and so do wild ones.
    """
    z = residual / sigma
    direct = (1 - reflected - BACKGROUND) * np.exp(-0.5 * z * z) / (sigma * np.sqrt(2 * np.pi))
    late = reflected * (ndtr(z) - ndtr((residual - LATEST) / sigma)) / LATEST
    return direct / (direct + late + BACKGROUND / (2 * LATEST))


def low_quantile(y: np.ndarray, ping: np.ndarray, quantile: float = 0.35) -> np.ndarray:
    """Low quantile of each ping (P,): reflections are only late, so the middle lies too high."""
    order = np.lexsort((y, ping))
    count = np.bincount(ping)
    return y[order][np.cumsum(count) - count + ((count - 1) * quantile).astype(int)]


def travel_derivative(
    a: Arrivals, xyz: np.ndarray, distance: np.ndarray, slowness: float, geometry: Geometry
) -> sp.csr_matrix:
    """Derivative (N, B) of the travel time to what all knots share.

    Column 0 is the slowness in units of its prior (zeros where the sound speed is given); with
    free places 2 D columns follow, x and y of each deployment (m).
    """
    n, n_columns = len(a.recorded), 1 + (2 * len(xyz) if geometry.sd > 0 else 0)
    rows = np.arange(n)
    scale = 1 / geometry.sound_speed if geometry.sound_speed_sd > 0 else 0.0
    data, row, col = [distance * scale], [rows], [np.zeros(n, int)]
    if geometry.sd > 0:
        away = (xyz[a.place, :2] - xyz[a.source, :2]) / np.maximum(distance, SHORTEST)[:, None]
        away = np.where(distance[:, None] > SHORTEST, away, 0.0) * slowness
        for axis in range(2):
            data += [away[:, axis], -away[:, axis]]
            row += [rows, rows]
            col += [1 + 2 * a.place + axis, 1 + 2 * a.source + axis]
    entries = (np.concatenate(data), (np.concatenate(row), np.concatenate(col)))
    return sp.csr_matrix(entries, shape=(n, n_columns))
