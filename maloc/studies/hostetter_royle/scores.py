"""Scores of one fit in the study: how far off positions are, and whether stated sets hold them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["PositionScores", "count_set", "in_ellipse", "in_kernel", "score_positions"]

_KERNEL_DRAWS = 400


class PositionScores(NamedTuple):
    """One element a position, (P,).

    Attributes
    ----------
    distance : posterior mean to truth, m ("RMSE" in the paper's Table 2)
    precision : mean over draws of the distance to truth, m ("Prec")
    ellipse, kernel : whether the 95 % set holds the truth, see `in_ellipse` and `in_kernel`
    """

    distance: np.ndarray
    precision: np.ndarray
    ellipse: np.ndarray
    kernel: np.ndarray


def score_positions(draws: np.ndarray, truth: np.ndarray, level: float = 0.95) -> PositionScores:
    """Score draws (D, P, 2) of P positions against their truth (P, 2)."""
    off = draws - truth
    return PositionScores(
        np.hypot(*off.mean(axis=0).T),
        np.hypot(off[..., 0], off[..., 1]).mean(axis=0),
        in_ellipse(draws, truth, level),
        in_kernel(draws, truth, level),
    )


def _white(draws: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draws (D, P, 2) and truth (P, 2) in units of the draws' own spread."""
    mean = draws.mean(axis=0)
    off = draws - mean
    covariance = np.einsum("dpi,dpj->pij", off, off) / (len(draws) - 1)
    tiny = 1e-12 * np.trace(covariance, axis1=1, axis2=2)[:, None, None] + 1e-30
    root = np.linalg.cholesky(covariance + tiny * np.eye(2))
    solved = np.linalg.solve(root, np.concatenate([off, (truth - mean)[None]]).transpose(1, 2, 0))
    return solved[..., :-1].transpose(2, 0, 1), solved[..., -1]


def in_ellipse(draws: np.ndarray, truth: np.ndarray, level: float = 0.95) -> np.ndarray:
    """Whether the ellipse around the mean that holds ``level`` of the draws holds the truth.

    The ellipse's shape is the draws' covariance; its size is the quantile of their own Mahalanobis
    distances, so that it is a set of that posterior probability whatever the posterior's shape.

    Parameters
    ----------
    draws : array (D, P, 2)
    truth : array (P, 2)
    level : float

    Returns
    -------
    array (P,) of bool
    """
    z, true = _white(draws, truth)
    edge = np.quantile((z**2).sum(axis=2), level, axis=0)
    return (true**2).sum(axis=1) <= edge


def in_kernel(
    draws: np.ndarray, truth: np.ndarray, level: float = 0.95, most: int = _KERNEL_DRAWS
) -> np.ndarray:
    """Whether the highest-density set of a two-dimensional kernel estimate holds the truth.

    Gaussian kernels of Scott's width, of the draws' own shape. The set's threshold is the quantile
    of the density at each draw estimated from the other draws; with the draw's own kernel counted,
    the draws would seem to lie higher than the truth does and the set would come out too small.

    Parameters
    ----------
    draws : array (D, P, 2)
        Thinned to ``most`` evenly spaced ones.
    truth : array (P, 2)
    level : float
    most : int

    Returns
    -------
    array (P,) of bool
    """
    keep = np.unique(np.linspace(0, len(draws) - 1, min(len(draws), most)).astype(int))
    z, true = _white(draws[keep], truth)
    n = len(keep)
    narrow = 0.5 * n ** (1 / 3)  # 1 / (2 width^2), width n^(-1/6)
    out = np.empty(len(truth), bool)
    for p in range(len(truth)):
        apart = ((z[:, p][:, None] - z[:, p][None]) ** 2).sum(axis=2)
        density = (np.exp(-narrow * apart).sum(axis=1) - 1) / (n - 1)
        here = np.exp(-narrow * ((z[:, p] - true[p]) ** 2).sum(axis=1)).mean()
        out[p] = here >= np.quantile(density, 1 - level)
    return out


def count_set(pmf: np.ndarray, level: float = 0.9) -> np.ndarray:
    """Smallest sets of counts with probability ``level`` or more, (G, M) bool.

    Parameters
    ----------
    pmf : array (G, M)
        Probability of 0, 1, ... missed pings in each gap; a row sums to 1.
    """
    order = np.argsort(-pmf, axis=1, kind="stable")
    falling = np.take_along_axis(pmf, order, axis=1)
    before = np.cumsum(falling, axis=1) - falling
    inside = np.empty(pmf.shape, bool)
    np.put_along_axis(inside, order, before < level - 1e-12, axis=1)
    return inside
