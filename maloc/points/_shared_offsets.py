"""One ping against several beacons' at once: clock offsets and emissions projected out.

Exact for independent errors: the constraints (2) and (3) of Arnon et al. (2023) leave a full
precision matrix over the receivers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["refine_shared", "share_offsets"]


def share_offsets(
    toa: np.ndarray,
    sigma: np.ndarray,
    ranges: np.ndarray,
    beacon_sigma: np.ndarray,
    used: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Pseudo-ranges and precision of one ping with several beacon pings, nuisances projected out.

    The receivers' offsets and all emission times are eliminated from the constraints (2) and (3)
    of the seed: what is left is the sum of squares (s - g - d)' Q (s - g - d) in the distances d.

    Parameters
    ----------
    toa : array (R,)
        Sound speed x the tag's arrivals, m.
    sigma : array (R,)
        Their standard deviations, m.
    ranges : array (K, R)
        Sound speed x the beacons' arrivals less the distance beacon-receiver, m.
    beacon_sigma : array (K, R)
        Standard deviations, m.
    used : array (K, R) bool
        Pairs that are no outliers.

    Returns
    -------
    pseudo : array (R,)
        s - g, m; 0 where no beacon was used.
    precision : array (R, R)
        Q, 1/m^2.
    """
    weight = np.where(used, 1 / beacon_sigma**2, 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-300)
    laplacian = np.diag(weight.sum(axis=0)) - np.einsum("kr,ks,k->rs", weight, weight, 1 / total)
    value = np.where(used, ranges, 0.0)
    mean = (weight * value).sum(axis=1) / total
    right = (weight * (value - mean[:, None])).sum(axis=0)
    offset = np.linalg.pinv(laplacian, hermitian=True, rcond=1e-12) @ right
    own = np.where(used.any(axis=0), 1 / sigma**2, 0.0)
    inside = used.any(axis=0)
    precision = np.zeros_like(laplacian)
    block = np.ix_(inside, inside)
    if inside.any():
        w = np.diag(own[inside])
        precision[block] = w - w @ np.linalg.solve(w + laplacian[block], w)
    return np.where(inside, np.nan_to_num(toa) - offset, 0.0), precision


def refine_shared(
    position: np.ndarray, place: np.ndarray, pseudo: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of pseudo-ranges with a full precision matrix, from a good start.

    Parameters
    ----------
    position : array (d,)
        Start, m.
    place : array (R, 3)
        Receivers as in a `Problem`, m.
    pseudo, precision : array (R,), (R, R)
        Of `share_offsets`.

    Returns
    -------
    position (d,) m, covariance (d, d) m^2 (inf where singular)
    """
    from scipy.optimize import least_squares

    d = len(position)
    value, axes = np.linalg.eigh(precision)
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * axes.T
    keep = value > 1e-12 * max(float(value.max(initial=0.0)), 1e-300)
    root = root[keep]

    def offset(x: np.ndarray) -> np.ndarray:
        full = np.zeros(3)
        full[:d] = x
        return full - place

    def residual(x: np.ndarray) -> np.ndarray:
        return root @ (np.linalg.norm(offset(x), axis=1) - pseudo)

    def slope(x: np.ndarray) -> np.ndarray:
        step = offset(x)
        return root @ (step[:, :d] / np.maximum(np.linalg.norm(step, axis=1), 1e-9)[:, None])

    if len(root) < d:
        return position, np.full((d, d), np.inf)
    jac: Any = slope
    found = least_squares(residual, position, jac, method="lm")
    gram: Any = found.jac.T @ found.jac
    singular = np.linalg.cond(gram) > 1e10
    return found.x, np.full((d, d), np.inf) if singular else np.linalg.inv(gram)
