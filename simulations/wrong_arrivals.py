"""Arrival times that break what the model says of them, one thing at a time.

A walker among twelve receivers, direct arrivals with a normal error of 1 m, 6 % of all late by up
to 375 m; and on top of it what a case of `CASES` says.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maloc.data import ArrivalTimes
from simulations._walk import arrivals, grid, walk

__all__ = ["CASES", "wrong_arrivals"]

SIGMA, LATE, FARTHEST = 1.0, 0.06, 375.0  # m, share, m


def _early(rng: np.random.Generator, error: np.ndarray) -> np.ndarray:
    ahead = rng.random(error.shape) < 0.03
    return np.where(ahead, -rng.uniform(5.0, 100.0, error.shape), error)


def _short(rng: np.random.Generator, error: np.ndarray) -> np.ndarray:
    near = rng.random(error.shape) < 0.25
    reflected = np.abs(SIGMA * rng.standard_normal(error.shape)) + rng.exponential(5.0, error.shape)
    return np.where(near, reflected, error)


def _persistent(rng: np.random.Generator, error: np.ndarray) -> np.ndarray:
    """Each receiver hears in spells of about 12 pings, every fourth of them late by 2 to 12 m."""
    out = error.copy()
    for j in range(error.shape[1]):
        spell = np.cumsum(rng.random(len(error)) < 1 / 12)
        lateness = rng.uniform(2.0, 12.0, spell[-1] + 1) * (rng.random(spell[-1] + 1) < 0.25)
        out[:, j] += lateness[spell]
    return out


def _wandering(rng: np.random.Generator, error: np.ndarray) -> np.ndarray:
    """Each receiver's clock is off by 1 m (sd), with a memory of 60 pings."""
    keep = np.exp(-1 / 60)
    clock = rng.standard_normal(error.shape)
    for i in range(1, len(clock)):
        clock[i] = keep * clock[i - 1] + np.sqrt(1 - keep**2) * clock[i]
    return error + clock


def _two_displaced(rng: np.random.Generator, xy: np.ndarray) -> np.ndarray:
    out, angle = xy.copy(), rng.uniform(0, 2 * np.pi, 2)
    two = rng.choice(len(xy), 2, replace=False)
    out[two] += 5.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    return out


def _all_displaced(rng: np.random.Generator, xy: np.ndarray) -> np.ndarray:
    return xy + 2.0 / np.sqrt(2) * rng.standard_normal(xy.shape)


def _as_is(rng: np.random.Generator, value: np.ndarray) -> np.ndarray:
    return value


# case: law of a direct arrival's error, what happens to the errors, where receivers are said to be
_Change = Callable[[np.random.Generator, np.ndarray], np.ndarray]
CASES: dict[str, tuple[str, _Change, _Change]] = {
    "right": ("normal", _as_is, _as_is),
    "early": ("normal", _early, _as_is),
    "t3": ("t3", _as_is, _as_is),
    "shortlate": ("normal", _short, _as_is),
    "persist": ("normal", _persistent, _as_is),
    "ar1": ("normal", _wandering, _as_is),
    "wrongpos": ("normal", _as_is, _two_displaced),
    "wrong2all": ("normal", _as_is, _all_displaced),
}


def wrong_arrivals(
    rng: np.random.Generator, case: str, pings: int = 44
) -> tuple[ArrivalTimes, np.ndarray]:
    """Arrival times of one case, and the true positions (P, 2), m."""
    law, change, said = CASES[case]
    xy = grid(rng, 4, 3, 170.0, 30.0)
    time = np.cumsum(rng.uniform(20.0, 40.0, pings))
    place = walk(rng, time, 0.3, 260.0, rng.uniform([150, 100], [350, 250]))
    away = np.linalg.norm(place[:, None] - xy, axis=-1)
    direct = rng.standard_t(3, away.shape) if law == "t3" else rng.standard_normal(away.shape)
    late = rng.random(away.shape) < LATE
    error = np.where(late, rng.uniform(0, FARTHEST, away.shape), SIGMA * direct)
    heard = rng.random(away.shape) < 0.9 * np.exp(-0.5 * (away / 230.0) ** 2)
    toa, known = arrivals(time, away + change(rng, error), heard, said(rng, xy))
    return toa, place[known]
