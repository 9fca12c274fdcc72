"""When tags ping, and the sound speed at those times."""

from __future__ import annotations

import numpy as np

from maloc.data import Schedule
from maloc.errors import InputError

__all__ = ["burst_times", "sound_speed_walk"]


def burst_times(rng: np.random.Generator, n: int, schedule: Schedule) -> np.ndarray:
    """Draw the emission times of `n` pings.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    n : int
        Number of pings.
    schedule : Schedule
        "random": intervals Uniform(lo, hi); "stable": intervals N(lo, hi).

    Returns
    -------
    array (n,)
        Seconds; the first is Uniform(0, lo).

    Raises
    ------
    InputError
        If the schedule is unknown: there is nothing to draw from.
    """
    if schedule.kind == "random":
        interval = rng.uniform(schedule.lo, schedule.hi, n)
    elif schedule.kind == "stable":
        interval = rng.normal(schedule.lo, schedule.hi, n)
    else:
        raise InputError("cannot simulate pings without a burst interval", mend="give one")
    interval[:1] = rng.uniform(0.0, schedule.lo, min(n, 1))
    return np.cumsum(interval)


def sound_speed_walk(
    rng: np.random.Generator, time: np.ndarray, start: float, rate: float
) -> np.ndarray:
    """Sound speed, m/s, at each time (P,): a random walk of `rate` m/s per square root second."""
    step = rng.standard_normal(max(len(time) - 1, 0)) * rate * np.sqrt(np.diff(time))
    return start + np.concatenate([np.zeros(min(len(time), 1)), np.cumsum(step)])
