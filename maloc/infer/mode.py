"""Mode of the path given the parameters: banded Newton steps that survive bad starts.

Where the exact Hessian is not positive definite the Gauss-Newton one, which always is, serves for
that step only; far from the mode, widened errors and the reweighted curvature (annealing) keep
single wild arrivals from deciding where the path goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.infer._chain import ChainFactor
from maloc.infer._model import ChainModel

__all__ = ["Mode", "anneal", "find_mode"]


class Mode(NamedTuple):
    """A path at (or near) the maximum: x (T, d), negative log joint, steps, converged or not."""

    x: np.ndarray
    value: float
    steps: int
    converged: bool


def _factor(band, d: int) -> ChainFactor:
    """Factor, with the diagonal raised as little as makes an indefinite band positive definite.

    Bands of arrival laws need it for rounding only; those of a user's plain distributions can be
    indefinite far from the mode. By ten times the rows' sums any matrix is diagonally dominant.
    """
    band = np.asarray(band)
    lift, reach = 0.0, None
    while True:
        try:
            if reach is not None:
                raised = band.copy()
                raised[0] += lift * reach + 1e-12
                return ChainFactor(raised, d)
            return ChainFactor(band, d)
        except np.linalg.LinAlgError:
            if lift > 1.0 or not np.isfinite(band).all():
                raise
            lift, reach = max(10 * lift, 1e-8), _row_sums(band)


def _row_sums(band: np.ndarray) -> np.ndarray:
    """Sums of the absolute values in each row of a lower band's symmetric matrix."""
    size, n = np.abs(band), band.shape[1]
    out = size.sum(axis=0)
    for offset in range(1, min(len(band), n)):
        out[offset:] += size[offset, : n - offset]
    return out


def find_mode(
    cm: ChainModel,
    args: tuple,
    x: np.ndarray,
    u: np.ndarray,
    *,
    temper: float = 0.0,
    method: str = "exact",
    max_steps: int = 30,
    tol: float = 1e-6,
) -> Mode:
    """Climb to the mode of the path from `x` with the parameters `u` held.

    Parameters
    ----------
    cm : ChainModel
    args : tuple
        The model's arguments.
    x : (T, d) array
        Start.
    u : (k,) array
        Unconstrained parameters.
    temper : float
        Arrival errors are widened to at least this (m).
    method : {"exact", "gauss-newton", "robust"}
        Curvature: exact Hessian where positive definite, Gauss-Newton, or reweighted least squares.
    max_steps : int
        Steps at most.
    tol : float
        Stop when the expected gain of a step falls below this (log units).

    Returns
    -------
    Mode
    """

    def terms(x):
        if method == "exact":
            return cm.exact(x, u, args, temper)
        return cm.terms(x, u, args, temper, method == "robust")

    value, gradient, band = terms(x)
    value = float(value)
    for step in range(max_steps):
        gradient = np.asarray(gradient)
        found, gain = None, np.inf
        for factor in _factors(cm, x, u, args, temper, method, band):
            move = factor.solve(gradient)
            gain = float(np.sum(gradient * move))
            if gain < tol:
                return Mode(x, value, step, True)
            found = _shortened(terms, x, value, move, gain)
            if found is not None:
                break
        if found is None:
            return Mode(x, value, step, gain < 1e-2)
        x, value, gradient, band = found
    return Mode(x, value, max_steps, False)


def _factors(cm: ChainModel, x, u, args, temper: float, method: str, band):
    """Factors to step by, each more careful than the one before: exact, Gauss-Newton, damped."""
    if method == "exact":
        try:
            yield ChainFactor(band, cm.d)
        except np.linalg.LinAlgError:
            pass
        band = cm.terms(x, u, args, temper, False)[2]
    yield _factor(band, cm.d)
    if cm.has_local:  # clipped curvatures can leave a whole tag unheld
        band = np.asarray(band)
        rows = _row_sums(band)
        for damping in (1e-3, 1e-2, 0.1, 1.0):
            damped = band.copy()
            damped[0] += damping * (rows + rows.mean())
            yield _factor(damped, cm.d)


def _shortened(terms, x, value: float, move, gain: float):
    """Longest of the shortened steps that pays; None where none does."""
    size = 1.0
    while size > 1e-4:
        trial = x - size * move
        new, gradient, band = terms(trial)
        new = float(new)
        if new < value - 1e-4 * size * gain:
            return trial, new, gradient, band
        size *= 0.4
    return None


def anneal(
    cm: ChainModel,
    args: tuple,
    x: np.ndarray,
    u: np.ndarray,
    scales: tuple[float, ...],
    *,
    steps: int = 3,
) -> np.ndarray:
    """Path after a few reweighted steps at each of the falling error scales (m)."""
    for scale in scales:
        x = find_mode(cm, args, x, u, temper=scale, method="robust", max_steps=steps, tol=1e-2).x
    return x
