"""Laplace marginal likelihood of the parameters, with gradient, and its maximum.

The path is integrated out by its mode and the log determinant of the clipped Gauss-Newton
precision: the exact one is near-singular whenever a ping has two modes, and then rules the
parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from maloc.infer._arrow import Arrow
from maloc.infer._chain import ChainFactor
from maloc.infer._model import ChainModel
from maloc.infer.mode import Mode, _factor, find_mode

__all__ = ["MarginalFit", "maximise_marginal"]


_SETTLE = 12  # steps of the inner parameters at most
_SETTLED = 1e-3  # log units
_NEAR = 1.0  # scales; a curvature serves for gradients as far as this
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
    """The marginal at one value of the outer parameters.

    ``u`` all parameters, the inner at their mode; ``gradient``, ``curvature`` (n,) in the outer;
    ``slope`` (n, T, d), ``moved`` (n, k): how path and parameters follow the outer; ``arrow``: the
    precision of path and inner parameters.
    """

    mode: Mode
    u: np.ndarray
    value: float
    gradient: np.ndarray
    curvature: np.ndarray
    slope: np.ndarray
    moved: np.ndarray
    arrow: Arrow


class _Marginal:
    """Negative log Laplace marginal in the outer parameters; remembers the best point."""

    def __init__(self, cm: ChainModel, args: tuple, x, u, scale: np.ndarray) -> None:
        self.cm, self.args, self.scale = cm, args, scale
        self.outer, self.inner = cm.outer, cm.inner
        self.best: _Point | None = None
        self.start = np.asarray(x), np.array(u)
        self.known: tuple | None = None  # where a curvature was worked out, and it
        self.evaluations = 0

    def arrow(self, x, u, factor: ChainFactor | None = None) -> Arrow:
        """Gauss-Newton precision of path and inner parameters."""
        cm = self.cm
        if factor is None:
            factor = _factor(cm.terms(x, u, self.args, 0.0, False)[2], cm.d)
        if not len(self.inner):
            return Arrow(factor, np.zeros((0, *np.shape(x))), np.zeros((0, 0)))
        mixed, block = (np.asarray(a) for a in cm.border(x, u, self.args))
        return Arrow(factor, mixed, block + np.eye(len(block)))

    def settle(self, x, u) -> tuple[Mode, np.ndarray]:
        """Mode of the path, and parameters of which the inner ones are at theirs."""
        cm, u = self.cm, np.array(u)
        tol = 1e-3 if len(self.inner) else 1e-5
        mode = find_mode(cm, self.args, x, u, max_steps=25, tol=tol)
        for _ in range(_SETTLE if len(self.inner) else 0):
            slope = np.asarray(cm.gradients(mode.x, u, self.args, 0.0)[1])[self.inner]
            arrow = self.arrow(mode.x, u)
            step = -arrow.covariance @ slope
            if -0.5 * float(step @ slope) < _SETTLED:
                break
            size = 1.0
            while size > 0.05:
                trial = u.copy()
                trial[self.inner] += size * step
                path = mode.x + size * np.einsum("m,mtd->td", step, arrow.follow)
                new = find_mode(cm, self.args, path, trial, max_steps=25, tol=tol)
                if new.value < mode.value:
                    break
                size *= 0.4
            else:
                break
            mode, u = new, trial
        if len(self.inner):
            mode = find_mode(cm, self.args, mode.x, u, max_steps=25, tol=1e-5)
        return mode, u

    def profile(self, point_x, u, slope, moved, offsets):
        """Negative log marginal, to the second order in the path, at outer offsets (m, n)."""
        xs = point_x + np.einsum("mn,ntd->mtd", offsets, slope)
        out = []
        for x, v in zip(xs, u + offsets @ moved, strict=True):
            value, _, band = self.cm.terms(x, v, self.args, 0.0, False)
            factor = _factor(band, self.cm.d)
            out.append(float(value) + 0.5 * self.arrow(x, v, factor).log_det)
        return np.asarray(out)

    def _curvature_at(self, mode: Mode, u, clipped: ChainFactor) -> ChainFactor:
        """What moves the mode with the parameters: the exact Hessian where clipping changes it."""
        if not self.cm.has_local:
            return clipped
        try:
            return ChainFactor(self.cm.exact(mode.x, u, self.args, 0.0)[2], self.cm.d)
        except np.linalg.LinAlgError:
            return clipped

    def __call__(self, outer: np.ndarray) -> _Point:
        cm, n = self.cm, len(self.outer)
        self.evaluations += 1
        x, u = self.start
        if self.best is not None:
            x, u = self.best.mode.x, self.best.u
        u = np.array(u)
        u[self.outer] = outer
        mode, u = self.settle(x, u)
        arrow = self.arrow(mode.x, u)
        mixed, own = cm.cross(mode.x, u, self.args)
        exact = self._curvature_at(mode, u, arrow.factor)
        if exact is not arrow.factor and not len(self.inner):
            slope, inner = -exact.solve(mixed), np.zeros((n, 0))
        else:
            slope, inner = (-a for a in arrow.solve(mixed, own[:, self.inner]))
        moved = np.zeros((n, cm.k))
        moved[np.arange(n), self.outer], moved[:, self.inner] = 1.0, inner
        value = mode.value + 0.5 * arrow.log_det
        step = 0.05 * self.scale
        offsets = np.diag(step)
        ahead = self.profile(mode.x, u, slope, moved, offsets) - value
        if self.known is None or np.abs((outer - self.known[0]) / self.scale).max() > _NEAR:
            behind = self.profile(mode.x, u, slope, moved, -offsets) - value
            curvature = (ahead + behind) / step**2
            self.known = np.array(outer), curvature
        curvature = self.known[1]
        gradient = ahead / step - 0.5 * step * curvature
        point = _Point(mode, u, value, gradient, curvature, slope, moved, arrow)
        if self.best is None or value < self.best.value:
            self.best = point
        return point


def _covariance(marginal: _Marginal, point: _Point, scale: np.ndarray):
    """Covariance of the outer parameters from second differences of the profile, (n, n)."""
    k = len(scale)
    pairs = [(i, j) for i in range(k) for j in range(i)]
    eye = np.diag(0.5 * scale)
    ahead = np.array([*eye, *(eye[i] + eye[j] for i, j in pairs)])
    offsets = np.concatenate([ahead, -ahead])
    values = marginal.profile(point.mode.x, point.u, point.slope, point.moved, offsets)
    second = values[: len(ahead)] + values[len(ahead) :] - 2 * point.value
    hessian = np.diag(second[:k] / (0.5 * scale) ** 2)
    for (i, j), both in zip(pairs, second[k:], strict=True):
        mixed = (both - second[i] - second[j]) / (0.5 * scale[i] * scale[j])
        hessian[i, j] = hessian[j, i] = mixed
    scaled = hessian * np.outer(scale, scale)
    eigen, vectors = np.linalg.eigh(scaled)
    eigen = np.maximum(eigen, 1e-2)
    return (vectors / eigen) @ vectors.T * np.outer(scale, scale)


def whole(marginal: _Marginal, point: _Point, covariance: np.ndarray, converged: bool):
    """The fit at a point, given the covariance (n, n) of the outer parameters."""
    arrow, m, effects = point.arrow, point.moved, marginal.inner
    inner = m[:, effects]
    both = m.T @ covariance @ m
    both[np.ix_(effects, effects)] += arrow.covariance
    slope = np.zeros((marginal.cm.k, *point.mode.x.shape))
    slope[effects] = arrow.follow
    slope[marginal.outer] = point.slope - np.einsum("nm,mtd->ntd", inner, arrow.follow)
    return MarginalFit(
        x=point.mode.x,
        u=point.u,
        value=point.value,
        factor=arrow.factor,
        slope=slope,
        covariance=both,
        evaluations=marginal.evaluations,
        converged=converged,
    )


def maximise_marginal(
    cm: ChainModel,
    args: tuple,
    x: np.ndarray,
    u: np.ndarray,
    *,
    max_iterations: int = 40,
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
    n = len(cm.outer)
    marginal = _Marginal(cm, args, x, u, np.full(n, 0.1))
    start = marginal(u[marginal.outer])
    if not n:
        return whole(marginal, start, np.zeros((0, 0)), start.mode.converged)
    scale = np.clip(1 / np.sqrt(np.maximum(start.curvature, 1e-6)), 1e-4, 0.5)
    marginal.scale, marginal.known = scale, None

    def function(y):
        try:
            point = marginal(y * scale)
        except np.linalg.LinAlgError:  # a trial step into parameters that no path survives
            assert marginal.best is not None
            back = y - marginal.best.u[marginal.outer] / scale
            return marginal.best.value + _STEEP * float(back @ back), 2 * _STEEP * back
        return point.value, point.gradient * scale

    first = start.u[marginal.outer]
    bounds = [((v - 8) / s, (v + 8) / s) for v, s in zip(first, scale, strict=True)]
    options = {"maxiter": max_iterations, "ftol": 1e-7, "gtol": 0.05}
    found = minimize(
        function, first / scale, jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    point = marginal.best
    assert point is not None
    scale = np.clip(1 / np.sqrt(np.maximum(point.curvature, 1e-6)), 1e-4, 1.0)
    covariance = _covariance(marginal, point, scale)
    small = float(np.max(np.abs(point.gradient) * np.sqrt(np.diag(covariance)))) < 0.5
    good = bool(small and point.mode.converged) or bool(found.success)
    return whole(marginal, point, covariance, good)
