"""Animals outside the array, where ranges tell the direction well and the distance hardly."""

from __future__ import annotations

import numpy as np

from maloc.data import ArrivalTimes
from simulations._walk import arrivals, grid, walk

__all__ = ["far_animal"]


def far_animal(
    rng: np.random.Generator, diameter: float, distance: float, pings: int = 45
) -> tuple[ArrivalTimes, np.ndarray]:
    """Arrival times of an animal that stays away from nine receivers, and its positions (P, 2), m.

    Parameters
    ----------
    diameter : float
        Of the array, from corner to corner, m.
    distance : float
        Of the animal's first ping from the array's middle, m.
    """
    step = diameter / 2 / np.sqrt(2)
    xy = grid(rng, 3, 3, step, 1.0) - step
    time = np.cumsum(rng.uniform(20.0, 40.0, pings))
    angle = rng.uniform(0, 2 * np.pi)
    place = walk(rng, time, 0.1, 260.0, distance * np.array([np.cos(angle), np.sin(angle)]))
    away = np.linalg.norm(place[:, None] - xy, axis=-1)
    late = rng.random(away.shape) < 0.03
    error = np.where(late, rng.uniform(0, 375.0, away.shape), rng.standard_normal(away.shape))
    toa, known = arrivals(time, away + error, rng.random(away.shape) < 0.8, xy)
    return toa, place[known]
