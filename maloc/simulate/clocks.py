"""Receivers' clocks: an offset each, and a drift that is piecewise linear in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Clocks", "draw_clocks"]


class Clocks(NamedTuple):
    """How far each receiver's clock is ahead of true time.

    ``knots`` (K,) are true times, s; ``ahead`` (K, R) is the error there, s, linear between.
    """

    knots: np.ndarray
    ahead: np.ndarray

    def error(self, time: np.ndarray) -> np.ndarray:
        """Error (s) of each clock at true times (P, R), NaN where the time is."""
        columns = [
            np.interp(time[:, j], self.knots, self.ahead[:, j]) for j in range(time.shape[1])
        ]
        return np.stack(columns, 1)


def draw_clocks(
    rng: np.random.Generator,
    n_receivers: int,
    duration: float,
    offset_sd: float = 0.5,
    drift_ppm: float = 5.0,
    wander_ppm: float = 1.0,
    knot_every: float = 3600.0,
) -> Clocks:
    """Draw clocks that start N(0, `offset_sd`) s wrong and drift.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    n_receivers : int
        R.
    duration : float
        The clocks run from 0 to here, s.
    offset_sd : float
        Seconds.
    drift_ppm : float
        Standard deviation of the drift in the first interval, microseconds a second.
    wander_ppm : float
        Standard deviation of the drift's change from one interval to the next.
    knot_every : float
        Length of an interval of steady drift, s.

    Returns
    -------
    Clocks
        Error of each clock; the first receiver keeps true time.
    """
    n = max(int(np.ceil(duration / knot_every)), 1)
    knots = knot_every * np.arange(n + 1)
    ppm = drift_ppm * rng.standard_normal((1, n_receivers))
    ppm = ppm + np.cumsum(wander_ppm * rng.standard_normal((n, n_receivers)), 0)
    offset = offset_sd * rng.standard_normal((1, n_receivers))
    ahead = np.concatenate([offset, offset + np.cumsum(1e-6 * knot_every * ppm, 0)])
    ahead[:, 0] = 0.0
    return Clocks(knots, ahead)
