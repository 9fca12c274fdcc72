"""Laplace marginal likelihood of the parameters, with gradient, and its maximum.

The path is integrated out by its mode and the log determinant of the clipped Gauss-Newton
precision: the exact one is near-singular whenever a ping has two modes, and then rules the
parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from maloc.infer._chain import ChainFactor
from maloc.infer._model import ChainModel
from maloc.infer.mode import Mode, _factor, find_mode

__all__ = ["MarginalFit", "maximise_marginal"]


_STEEP = 100.0  # log units a squared standard deviation, where the path's mode is lost


class MarginalFit(NamedTuple):
    """Maximum of the marginal likelihood.

    x : (T, d) mode of the path; u : (k,) unconstrained parameters; value : negative log marginal
    posterior; factor : ChainFactor of the path's precision; slope : (k, T, d), d mode / d
    parameters; covariance : (k, k) of u; evaluations : int; converged : bool.
    """

    x: np.ndarray
    u: np.ndarray
    value: float
    factor: ChainFactor
    slope: np.ndarray
    covariance: np.ndarray
    evaluations: int
    converged: bool


class _Point(NamedTuple):
    """The marginal at one parameter value: path mode, value, gradient, curvature, slope, factor."""

    mode: Mode
    value: float
    gradient: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray
    factor: ChainFactor


class _Marginal:
    """Negative log Laplace marginal; remembers the best point for warm starts."""

    def __init__(self, cm: ChainModel, args: tuple, x: np.ndarray, scale: np.ndarray) -> None:
        self.cm, self.args, self.scale = cm, args, scale
        self.best: _Point | None = None
        self.best_u: np.ndarray | None = None
        self.start = x
        self.evaluations = 0

    def profile(self, x, u, slope, offsets):
        """Negative log marginal, to the second order in the path, at u + offsets (m, k)."""
        xs = x + np.einsum("mk,ktd->mtd", offsets, slope)
        out = []
        for x, v in zip(xs, u + offsets, strict=True):
            value, _, band = self.cm.terms(x, v, self.args, 0.0, False)
            out.append(float(value) + 0.5 * _factor(band, self.cm.d).log_det)
        return np.asarray(out)

    def _curvature_at(self, mode: Mode, u, clipped: ChainFactor) -> ChainFactor:
        """What moves the mode with the parameters: the exact Hessian where clipping changes it."""
        if not self.cm.has_local:
            return clipped
        try:
            return ChainFactor(self.cm.exact(mode.x, u, self.args, 0.0)[2], self.cm.d)
        except np.linalg.LinAlgError:
            return clipped

    def __call__(self, u: np.ndarray) -> _Point:
        cm, k = self.cm, self.cm.k
        self.evaluations += 1
        x = self.start
        if self.best is not None:
            x = self.best.mode.x
        mode = find_mode(cm, self.args, x, u, max_steps=25, tol=1e-5)
        band = cm.terms(mode.x, u, self.args, 0.0, False)[2]
        factor = _factor(band, cm.d)
        mixed = np.asarray(cm.cross(mode.x, u, self.args))
        slope = -self._curvature_at(mode, u, factor).solve(mixed)
        value = mode.value + 0.5 * factor.log_det
        offsets = np.concatenate([np.diag(self.scale), -np.diag(self.scale)]) * 0.05
        ends = self.profile(mode.x, u, slope, offsets)
        step = 0.05 * self.scale
        gradient = (ends[:k] - ends[k:]) / (2 * step)
        curvature = (ends[:k] + ends[k:] - 2 * value) / step**2
        point = _Point(mode, value, gradient, curvature, slope, factor)
        if self.best is None or value < self.best.value:
            self.best, self.best_u = point, u.copy()
        return point


def _covariance(marginal: _Marginal, point: _Point, u: np.ndarray, scale: np.ndarray):
    """Covariance of the parameters from second differences of the profile, (k, k)."""
    k = len(u)
    pairs = [(i, j) for i in range(k) for j in range(i)]
    eye = np.diag(0.5 * scale)
    ahead = np.array([*eye, *(eye[i] + eye[j] for i, j in pairs)])
    values = marginal.profile(point.mode.x, u, point.slope, np.concatenate([ahead, -ahead]))
    second = values[: len(ahead)] + values[len(ahead) :] - 2 * point.value
    hessian = np.diag(second[:k] / (0.5 * scale) ** 2)
    for (i, j), both in zip(pairs, second[k:], strict=True):
        mixed = (both - second[i] - second[j]) / (0.5 * scale[i] * scale[j])
        hessian[i, j] = hessian[j, i] = mixed
    scaled = hessian * np.outer(scale, scale)
    eigen, vectors = np.linalg.eigh(scaled)
    eigen = np.maximum(eigen, 1e-2)
    return (vectors / eigen) @ vectors.T * np.outer(scale, scale)


def maximise_marginal(
    cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray, *, max_iterations: int = 40
) -> MarginalFit:
    """Maximise the Laplace marginal posterior of the parameters by L-BFGS on scaled variables.

    Parameters
    ----------
    cm, args
        Chain model and its arguments.
    x : (T, d) array
        Start of the path.
    u : (k,) array
        Start of the unconstrained parameters.
    max_iterations : int
        L-BFGS iterations at most.

    Returns
    -------
    MarginalFit
    """
    if cm.k == 0:
        mode = find_mode(cm, args, x, u, max_steps=50)
        factor = _factor(cm.terms(mode.x, u, args, 0.0, False)[2], cm.d)
        value, slope = mode.value + 0.5 * factor.log_det, np.zeros((0, *mode.x.shape))
        return MarginalFit(mode.x, u, value, factor, slope, np.zeros((0, 0)), 1, mode.converged)
    scale = np.full(cm.k, 0.1)
    marginal = _Marginal(cm, args, x, scale)
    start = marginal(u)
    scale = np.clip(1 / np.sqrt(np.maximum(start.curvature, 1e-6)), 1e-4, 0.5)
    marginal.scale = scale

    def function(y):
        try:
            point = marginal(y * scale)
        except np.linalg.LinAlgError:  # a trial step into parameters that no path survives
            assert marginal.best is not None and marginal.best_u is not None
            back = y - marginal.best_u / scale
            return marginal.best.value + _STEEP * float(back @ back), 2 * _STEEP * back
        return point.value, point.gradient * scale

    bounds = [((v - 8) / s, (v + 8) / s) for v, s in zip(u, scale, strict=True)]
    options = {"maxiter": max_iterations, "ftol": 1e-7, "gtol": 0.05}
    found = minimize(
        function, u / scale, jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    point, best_u = marginal.best, marginal.best_u
    assert point is not None and best_u is not None
    curvature = np.maximum(point.curvature, 1e-6)
    scale = np.clip(1 / np.sqrt(curvature), 1e-4, 1.0)
    covariance = _covariance(marginal, point, best_u, scale)
    small = float(np.max(np.abs(point.gradient) * np.sqrt(np.diag(covariance)))) < 0.5
    return MarginalFit(
        x=point.mode.x,
        u=best_u,
        value=point.value,
        factor=point.factor,
        slope=point.slope,
        covariance=covariance,
        evaluations=marginal.evaluations,
        converged=bool(small and point.mode.converged) or bool(found.success),
    )
