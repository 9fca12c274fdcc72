"""How well an array would locate a tag: covariance from geometry, GDOP, and maps of it.

First derivatives only (Arnon et al. 2023, eq. 6): what is not asked for (emission time, sound
speed, depth) is projected out, and where the rest does not fix the place the answer is inf.

References
----------
Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife Tracking.
Sensors 23: 9460, section 2.8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from maloc.data.receivers import Receivers
from maloc.errors import InputError

__all__ = ["ErrorMap", "expected_error", "gdop", "position_covariance"]

_SINGULAR = 1e-6  # ratio of the smallest to the largest singular value that counts as none
_MARGIN = 0.25  # of the array's extent, around the map


def position_covariance(
    position: np.ndarray,
    place: np.ndarray,
    sigma: float | np.ndarray = 1.0,
    heard: np.ndarray | None = None,
    *,
    emission_known: bool = False,
    speed_sd: float = 0.0,
    depth_sd: float = 0.0,
) -> np.ndarray:
    """Covariance of positions found by least squares from arrivals.

    Parameters
    ----------
    position : array (P, 2) or (P, 3)
        Metres; the third is depth.
    place : array (M, 2) or (M, 3)
        Receivers, m. With `position` (P, 2) a third column is the receivers' depth below the tag.
    sigma : float or array broadcast to (P, M)
        Standard deviation of an arrival's error, m.
    heard : array broadcast to (P, M) of bool, optional
        Which receivers heard; all when not given.
    emission_known : bool
        Ranges instead of differences of ranges.
    speed_sd : float
        Relative standard deviation of the sound speed; inf: unknown.
    depth_sd : float
        Standard deviation of the tag's depth, m, where the position is (P, 2); inf: unknown.

    Returns
    -------
    array (P, d, d)
        m^2; inf where the problem is singular.

    Raises
    ------
    InputError
        If shapes do not agree, or sigma is not positive.
    """
    position, place = np.asarray(position, float), np.asarray(place, float)
    if position.ndim != 2 or position.shape[1] not in (2, 3):
        raise InputError(f"position must be (P, 2) or (P, 3), got shape {position.shape}")
    (n, d), m = position.shape, len(place)
    if place.ndim != 2 or place.shape[1] not in (2, 3) or (d == 3 and place.shape[1] == 2):
        raise InputError(f"place must be (M, {d}), got shape {place.shape}")
    weight = 1 / np.broadcast_to(np.asarray(sigma, float), (n, m))
    if not (weight > 0).all():
        raise InputError("sigma must be positive")
    if heard is not None:
        weight = np.where(np.broadcast_to(heard, (n, m)), weight, 0.0)
    below = np.zeros(m) if place.shape[1] == 2 else place[:, 2]
    offset = np.empty((n, m, 3))
    offset[..., :2] = position[:, None, :2] - place[None, :, :2]
    offset[..., 2] = (position[:, 2:] if d == 3 else 0.0) - below[None]
    distance = np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    slope = offset / distance
    # columns of what is not asked for, with the sd that is known of each
    nuisance: list[tuple[np.ndarray, float]] = []
    if not emission_known:
        nuisance.append((np.ones((n, m)), np.inf))
    if speed_sd > 0:
        nuisance.append((distance[..., 0], speed_sd))
    if d == 2 and depth_sd > 0:
        nuisance.append((slope[..., 2], depth_sd))
    rows = weight[..., None] * slope[..., :d]
    known = [(c, sd) for c, sd in nuisance if np.isfinite(sd)]
    rows = np.concatenate([rows, np.zeros((n, len(known), d))], axis=1)
    basis: list[np.ndarray] = []
    at = m
    for column, sd in nuisance:
        u = np.zeros((n, m + len(known)))
        u[:, :m] = weight * column
        if np.isfinite(sd):  # what is known of it is one more observation
            u[:, at] = 1 / sd
            at += 1
        size = np.linalg.norm(u, axis=1, keepdims=True)
        for _ in range(2):  # twice: Gram and Schmidt lose digits where columns are nearly alike
            for b in basis:
                u = u - (b * u).sum(axis=1, keepdims=True) * b
        left = np.linalg.norm(u, axis=1, keepdims=True)
        basis.append(np.where(left > 1e-9 * size, u / np.maximum(left, 1e-300), 0.0))
        rows = rows - basis[-1][:, :, None] * (basis[-1][:, :, None] * rows).sum(1, keepdims=True)
    _, size, axes = np.linalg.svd(rows, full_matrices=False)
    free = (weight > 0).sum(axis=1) + len(known) - len(nuisance) >= d
    top = weight.max(axis=1, initial=0.0)
    sure = free & (size[:, -1] > _SINGULAR * np.maximum(top, 1e-300))
    inverse = 1 / np.where(sure[:, None], size, 1.0) ** 2
    out = np.einsum("pki,pk,pkj->pij", axes, inverse, axes)
    return np.where(sure[:, None, None], out, np.inf)


def gdop(position: np.ndarray, place: np.ndarray, heard: np.ndarray | None = None) -> np.ndarray:
    """Geometric dilution of precision (P,): error (root mean square, m) a metre of arrival error.

    Parameters
    ----------
    position, place, heard
        As of `position_covariance`.
    """
    covariance = position_covariance(position, place, 1.0, heard)
    return np.sqrt(np.trace(covariance, axis1=1, axis2=2))


@dataclass(frozen=True, repr=False, eq=False)
class ErrorMap:
    """How well a tag would be located at each point of a grid.

    Parameters
    ----------
    x, y : array (X,), (Y,)
        Grid, m.
    gdop : array (Y, X)
        Were all receivers to hear it; inf where singular.
    error : array (Y, X)
        Median over the sets of receivers that may hear a ping of the root mean square error, m,
        given that it can be located; inf where it never is.
    located : array (Y, X)
        Probability that a ping can be located.
    """

    x: np.ndarray
    y: np.ndarray
    gdop: np.ndarray
    error: np.ndarray
    located: np.ndarray

    def __repr__(self) -> str:
        good = self.error[self.located > 0.5]
        middle = f", median error {np.median(good):.2f} m there" if good.size else ""
        return f"ErrorMap: located more often than not in {good.size / self.error.size:.0%}{middle}"


def expected_error(
    receivers: Receivers,
    *,
    sigma: float = 1.0,
    detection: Callable[[np.ndarray], np.ndarray] | tuple | None = None,
    x: np.ndarray | None = None,
    y: np.ndarray | None = None,
    depth: float | None = None,
    speed_sd: float = 0.0,
    draws: int = 64,
    seed: int = 0,
    most: float = 1e4,
) -> ErrorMap:
    """Map of the positioning error to be expected from an array.

    Parameters
    ----------
    receivers : Receivers
        M deployments.
    sigma : float
        Standard deviation of an arrival's error, m.
    detection : callable or tuple, optional
        Probability of detection: a function of distance (m), or (kind, p0, scale[, shape]) as of
        `maloc.detection.log_probabilities`. None: every receiver hears everything.
    x, y : array, optional
        Grid, m; 60 x 60 points over the array and a quarter of its extent around it.
    depth : float, optional
        The tag's depth, m; at the receivers' depth when not given.
    speed_sd : float
        Relative standard deviation of the sound speed.
    draws : int
        Sets of hearing receivers drawn at each point.
    seed : int
    most : float
        A ping whose error would be larger (m) counts as not located.

    Returns
    -------
    ErrorMap

    Raises
    ------
    InputError
        If there are too few receivers, or the tag's depth is given and theirs is not.
    """
    xy = receivers.xy
    if len(xy) < 3:
        raise InputError(f"{len(xy)} receivers: positions need at least 3")
    place = xy
    if depth is not None:
        own = np.asarray(receivers.depth, float)
        if np.isnan(own).any():
            raise InputError("the tag's depth is given, but not every receiver's")
        place = np.column_stack([xy, own - depth])
    low, high = xy.min(axis=0), xy.max(axis=0)
    room = _MARGIN * max(float((high - low).max()), 1.0)
    x = np.linspace(low[0] - room, high[0] + room, 60) if x is None else np.asarray(x, float)
    y = np.linspace(low[1] - room, high[1] + room, 60) if y is None else np.asarray(y, float)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    shape = len(y), len(x)
    whole = gdop(grid, place)

    def error(heard: np.ndarray | None) -> np.ndarray:
        found = position_covariance(grid, place, sigma, heard, speed_sd=speed_sd)
        return np.sqrt(np.trace(found, axis1=1, axis2=2))

    if detection is None:
        one = error(None)
        sure = np.where(one <= most, one, np.inf)
        return ErrorMap(
            x, y, whole.reshape(shape), sure.reshape(shape), (one <= most).reshape(shape) * 1.0
        )
    square = ((grid[:, None] - xy[None]) ** 2).sum(-1)
    if place.shape[1] == 3:
        square = square + place[None, :, 2] ** 2
    p = _probability(detection, np.sqrt(square))
    rng = np.random.default_rng(seed)
    errors = np.stack([error(rng.random(p.shape) < p) for _ in range(draws)])
    located = errors <= most
    count = located.sum(axis=0)
    ordered = np.sort(np.where(located, errors, np.inf), axis=0)
    middle = np.maximum(count - 1, 0) // 2
    half = ordered[middle, np.arange(len(grid))]
    return ErrorMap(x, y, whole.reshape(shape), half.reshape(shape), (count / draws).reshape(shape))


def _probability(detection: Any, distance: np.ndarray) -> np.ndarray:
    if callable(detection):
        p = np.asarray(detection(distance), float)
    else:
        from maloc.detection import log_probabilities

        kind, p0, scale, *shape = detection
        p = np.exp(np.asarray(log_probabilities(kind, distance, p0, scale, *shape)[0]))
    if p.shape != distance.shape or not ((p >= 0) & (p <= 1)).all():
        raise InputError("detection must give a probability for every distance")
    return p
