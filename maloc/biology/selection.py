"""Resource selection when positions are uncertain."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from maloc.data._limits import Z95
from maloc.errors import FitError, InputError

__all__ = ["Selection", "resource_selection"]


class Selection(NamedTuple):
    """A fitted resource selection function w(x) = exp(coefficient . covariates(x)).

    Attributes
    ----------
    coefficient, sd, low, high : (C,) arrays
        Estimate, standard error and 95 % interval.
    covariance : (C, C) array
    log_likelihood : float
        Against no selection.
    """

    coefficient: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    covariance: np.ndarray
    log_likelihood: float


def resource_selection(
    position: np.ndarray, covariates: Callable[[np.ndarray], np.ndarray], available: np.ndarray
) -> Selection:
    """Fit a resource selection function to draws of positions.

    Parameters
    ----------
    position : (D, n, 2) array
        D draws of the positions at n times (``tracks.position``), m; (1, n, 2) takes positions as
        known.
    covariates : callable
        Covariates (..., C) at places (..., 2).
    available : (M, 2) array
        Places spread evenly over all that the animal could have used, m: they stand for the
        integral over it, so many of them.

    Returns
    -------
    Selection

    Raises
    ------
    InputError
        If a covariate is not finite somewhere, or varies nowhere.
    FitError
        If no maximum is found, as where positions are too uncertain to tell.

    Notes
    -----
    Draws come from a model that knows of no selection, so a fit to each of them, pooled (multiple
    imputation), is biased towards none, and so is a fit to mean positions. Here the draws of a
    position are integrated over instead, each weighted by the selection itself:

        L(beta) = prod over times [mean over draws exp(beta h(x)) / mean of available exp(beta h)]

    which is the likelihood of what the receivers heard, where the movement model left places a
    priori equally likely over distances of a position's uncertainty. Times count as independent:
    take them far enough apart that the animal has had time to go elsewhere.

    References
    ----------
    Hostetter & Royle (2020) Movement Ecology 8: 15 (discussion: selection from the posterior of the
    track); Johnson, Thomas, Ver Hoef & Christ (2008) A general framework for the analysis of animal
    resource selection from telemetry data. Biometrics 64: 968-976 (the weighted distribution).
    """
    position = np.asarray(position, float)
    if position.ndim != 3 or position.shape[-1] != 2:
        raise InputError(f"position has draws, times and x, y: (D, n, 2), not {position.shape}")
    used, free = np.asarray(covariates(position)), np.asarray(covariates(np.asarray(available)))
    if not (np.isfinite(used).all() and np.isfinite(free).all()):
        raise InputError("a covariate is not finite at a position or an available place")
    if (free.std(axis=0) == 0).any():
        raise InputError("a covariate is the same everywhere")
    scale = free.std(axis=0)
    middle = free.mean(axis=0)
    used, free = (used - middle) / scale, (free - middle) / scale
    beta, value, hessian = _climb(used, free)
    covariance = np.linalg.inv(-hessian) / np.outer(scale, scale)
    sd, beta = np.sqrt(np.diag(covariance)), beta / scale
    return Selection(beta, sd, beta - Z95 * sd, beta + Z95 * sd, covariance, value)


def _climb(used: np.ndarray, free: np.ndarray):
    """Newton with halved steps: maximum (C,), log likelihood, Hessian."""
    beta = np.zeros(used.shape[-1])
    value, gradient, hessian = _terms(beta, used, free)
    for _ in range(100):
        values, vectors = np.linalg.eigh(-hessian)
        step = vectors @ (vectors.T @ gradient / np.maximum(np.abs(values), 1e-6))
        if np.sqrt(gradient @ step) < 1e-8 and values[0] > 0:
            return beta, value, hessian
        for _ in range(40):
            trial = _terms(beta + step, used, free)
            if trial[0] >= value - 1e-12:
                break
            step = 0.5 * step
        beta = beta + step
        value, gradient, hessian = trial
        if np.abs(beta).max() > 50:
            break
    raise FitError("no maximum of the selection's likelihood: positions tell too little of it")


def _terms(beta: np.ndarray, used: np.ndarray, free: np.ndarray):
    """Log likelihood, gradient and Hessian."""
    n = used.shape[1]
    own, all_ = used @ beta, free @ beta  # (D, n), (M,)
    value = float(np.sum(logsumexp(own, axis=0))) - n * np.log(len(used))
    value -= n * (float(logsumexp(all_)) - np.log(len(free)))
    w, v = softmax(own, axis=0), softmax(all_)
    mean = np.einsum("dn,dnc->nc", w, used)
    spread = np.einsum("dn,dnc,dne->ce", w, used, used) - mean.T @ mean
    level = v @ free
    expected = np.einsum("m,mc,me->ce", v, free, free) - np.outer(level, level)
    return value, mean.sum(axis=0) - n * level, spread - n * expected
