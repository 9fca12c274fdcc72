"""Covariance of a point position from first derivatives (Arnon et al. 2023, eq. 6)."""

from __future__ import annotations

import numpy as np

__all__ = ["covariance"]


def covariance(
    position: np.ndarray, place: np.ndarray, used: np.ndarray, sigma: np.ndarray
) -> np.ndarray:
    """Return the covariance of least-squares positions, the emission time projected out.

    Parameters
    ----------
    position : array (P, d)
        Metres; d = 2 (plane) or 3.
    place : array (P, M, 3)
        Receivers as in `maloc.points._problem.Problem`, m.
    used : array (P, M) bool
        Arrivals that the position rests on.
    sigma : array (P, M)
        Standard deviation of each arrival's error, m.

    Returns
    -------
    array (P, d, d)
        m^2; inf where the geometry is singular, NaN where there is no position.
    """
    d = position.shape[1]
    offset = position[:, None, :] - place[..., :d]
    full = offset if d == 3 else np.concatenate([offset, -place[..., 2:]], axis=-1)
    distance = np.linalg.norm(full, axis=-1, keepdims=True)
    weight = np.where(used, 1 / sigma**2, 0.0)[..., None]
    slope = np.where(used[..., None], offset / np.maximum(distance, 1e-9), 0.0)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    centred = slope - (weight * slope).sum(axis=1, keepdims=True) / total
    information = np.einsum("pmi,pmj->pij", weight * centred, centred)
    out = np.full((len(position), d, d), np.nan)
    known = np.all(np.isfinite(position), axis=1)
    sure = np.array(known)
    sure[known] = np.linalg.cond(information[known]) < 1e10
    out[known] = np.inf
    out[sure] = np.linalg.inv(information[sure])
    return out
