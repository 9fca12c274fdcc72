"""A walker and what an array hears of it, in plain NumPy: nothing of the package's models."""

from __future__ import annotations

import numpy as np

from maloc.data import ArrivalTimes, Receivers

__all__ = ["arrivals", "grid", "walk"]

SPEED = 1480.0  # m/s


def walk(
    rng: np.random.Generator, time: np.ndarray, sd: float, memory: float, start: np.ndarray
) -> np.ndarray:
    """Places (P, 2) at times (P,) of a walker whose velocity wanders.

    Parameters
    ----------
    time : (P,) array
        s, ascending from 0 on.
    sd : float
        Standard deviation of the velocity by axis, m/s.
    memory : float
        Time after which 5 % of its correlation is left, s.
    start : (2,) array
        m.
    """
    clock = np.arange(0.0, time[-1] + 2.0)  # steps of 1 s
    keep = 0.05 ** (1.0 / memory)
    velocity = np.empty((len(clock), 2))
    velocity[0] = sd * rng.standard_normal(2)
    kick = sd * np.sqrt(1 - keep**2) * rng.standard_normal((len(clock), 2))
    for i in range(1, len(clock)):
        velocity[i] = keep * velocity[i - 1] + kick[i]
    place = start + np.cumsum(velocity, axis=0) - velocity[0]
    return np.column_stack([np.interp(time, clock, place[:, a]) for a in (0, 1)])


def grid(rng: np.random.Generator, across: int, down: int, step: float, jitter: float):
    """Places (across * down, 2) m of receivers on a grid, each off by up to `jitter`."""
    x, y = np.meshgrid(step * np.arange(across), step * np.arange(down))
    xy = np.column_stack([x.ravel(), y.ravel()])
    return xy + rng.uniform(-jitter, jitter, xy.shape)


def arrivals(
    time: np.ndarray, far: np.ndarray, heard: np.ndarray, xy: np.ndarray
) -> tuple[ArrivalTimes, np.ndarray]:
    """Arrival times of the pings that anybody heard, and which those are (P,) bool.

    Parameters
    ----------
    time : (P,) array
        Emissions, s.
    far : (P, R) array
        Way of the sound with all its errors, m.
    heard : (P, R) array of bool
    xy : (R, 2) array
        Where the receivers are said to stand, m.
    """
    toa = np.where(heard, time[:, None] + far / SPEED, np.nan)
    any_ = heard.any(axis=1)
    names = np.array([f"R{j + 1:02d}" for j in range(len(xy))])
    speed = np.full(int(any_.sum()), SPEED)
    return ArrivalTimes(toa[any_], Receivers(names, xy[:, 0], xy[:, 1]), speed), any_
