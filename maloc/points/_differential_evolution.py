"""LS-TDOA by differential evolution: the classical reference, global but blind to late arrivals.

References
----------
Li, Deng, Rauchenstein & Carlson (2016) Source-localization algorithms and applications using time
of arrival and time difference of arrival measurements. Rev. Sci. Instrum. 87: 041502.
Storn & Price (1997) Differential evolution. Journal of Global Optimization 11: 341-359.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc.points._problem import Found, Problem

__all__ = ["cost", "differential_evolution"]


def cost(position: np.ndarray, place: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Sum of squares (S,) of range differences to the first arrival.

    Parameters
    ----------
    position : array (d, S)
        Candidates, m.
    place : array (m, 3)
        Receivers, the first arrival's first, as in a `Problem`, m.
    later : array (m - 1,)
        Ranges of the other arrivals less that of the first, m.
    """
    square = sum((position[i] - place[:, i, None]) ** 2 for i in range(len(position)))
    if len(position) == 2:
        square = square + place[:, 2, None] ** 2
    distance = np.sqrt(square)
    return ((later[:, None] - distance[1:] + distance[0]) ** 2).sum(axis=0)


def differential_evolution(
    problem: Problem,
    d: int,
    *,
    margin: float = 0.25,
    reach: float = np.inf,
    seed: int = 0,
    **options: Any,
) -> Found:
    """Least squares of the time differences to the first arrival, by `scipy.optimize`.

    Parameters
    ----------
    problem : Problem
        P pings of at least d + 1 arrivals.
    d : int
        2 or 3.
    margin : float
        The search stays in the box of the receivers that heard anything, wider by this share of
        its diagonal on each side.
    reach : float
        Largest distance (m) from the nearest receiver that heard the ping.
    seed : int
        Same pings and seed, same positions.
    **options
        Of `scipy.optimize.differential_evolution`.
    """
    from scipy import optimize

    n = len(problem.heard)
    position, emission = np.full((n, d), np.nan), np.full(n, np.nan)
    places = problem.place[problem.heard][:, :d]
    low, high = places.min(axis=0), places.max(axis=0)
    wider = margin * max(float(np.linalg.norm(high - low)), 1.0)
    bounds = np.column_stack([low - wider, high + wider])
    # `seed` is the name that every SciPy since 1.11 takes
    how: dict[str, Any] = {"vectorized": True, "updating": "deferred", **options}
    how["seed"] = np.random.default_rng(seed)
    for i in range(n):
        heard = problem.heard[i]
        order = np.flatnonzero(heard)[np.argsort(problem.range[i, heard], kind="stable")]
        place, ranges = problem.place[i, order], problem.range[i, order]
        found = optimize.differential_evolution(
            cost,
            bounds,
            args=(place, ranges[1:] - ranges[0]),
            **how,
        )
        position[i] = found.x
        emission[i] = ranges[0] - np.sqrt(_square(found.x, place[0]))
    away = np.linalg.norm(position[:, None, :2] - problem.place[..., :2], axis=-1)
    far = np.where(problem.heard, away, np.inf).min(axis=1) > reach
    position[far] = emission[far] = np.nan
    return Found(
        position,
        emission,
        problem.heard & ~far[:, None],
        np.zeros(n, bool),
        np.full((n, d), np.nan),
        np.where(far, "the arrivals point out of reach", ""),
    )


def _square(position: np.ndarray, place: np.ndarray) -> float:
    full = np.zeros(3)
    full[: len(position)] = position
    return float(((full - place) ** 2).sum())
