"""How fast an animal swam, and how far."""

from __future__ import annotations

import numpy as np

from maloc.biology.estimate import Estimate, summarise
from maloc.errors import InputError
from maloc.infer.predict import TrackDraws

__all__ = ["distance_travelled", "speed"]


def speed(tracks: TrackDraws, level: float = 0.95) -> Estimate:
    """Speed at each time of the draws.

    Parameters
    ----------
    tracks : TrackDraws
        With velocities: drawn from a correlated random walk (CTCRW).
    level : float
        Probability of the interval.

    Returns
    -------
    Estimate
        (n,) m/s.

    Raises
    ------
    InputError
        If the draws have no velocity. A Brownian or a home-range path has none: the shorter the
        step, the faster it looks.
    """
    if tracks.velocity is None:
        raise InputError(
            "these draws have no velocity", mend="fit movement='ctcrw', or use distance_travelled"
        )
    return summarise(np.linalg.norm(tracks.velocity, axis=-1), level)


def distance_travelled(tracks: TrackDraws, level: float = 0.95) -> Estimate:
    """Distance swum from the first time to each.

    Parameters
    ----------
    tracks : TrackDraws
    level : float
        Probability of the interval.

    Returns
    -------
    Estimate
        (n,) m; the first is 0, the last the whole distance.

    Notes
    -----
    Straight from time to time, so it grows as times grow denser: for a CTCRW to a limit, reached
    when steps are short beside ``t05``; for Brownian and home-range movement without one, and then
    it only compares tracks at the same times.
    """
    steps = np.linalg.norm(np.diff(tracks.position, axis=1), axis=-1)
    start = np.zeros((len(steps), 1))
    return summarise(np.concatenate([start, np.cumsum(steps, axis=1)], axis=1), level)
