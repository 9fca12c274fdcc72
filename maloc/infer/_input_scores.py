"""Efficient scores of inputs that a model takes as given: where receivers stand, the sound speed.

Would the log density rise if receiver j stood elsewhere, the path following? To the first order
that is the score, the gradient in the receivers' positions at the fitted path, with its
information, less what the path takes over (through its banded factor).

A sound speed that is too low by a share s makes every range too short by s. In the ranges' own
units that is an array drawn too large: a wrong sound speed is a displacement of all receivers
towards their middle, and needs no derivative of its own.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._chain import ChainFactor
from maloc.infer._model import ChainModel, _unwrap
from maloc.infer.mode import _factor, find_mode
from maloc.infer.result import Fit, LaplaceFit

__all__ = ["Point", "fitted_point", "information", "redrawn", "score"]


class Point(NamedTuple):
    """Where a fit stands: path (T, d), parameters (k,), factor of the path's precision."""

    cm: ChainModel
    args: tuple
    x: np.ndarray
    u: np.ndarray
    factor: ChainFactor


def fitted_point(fit: Fit) -> Point:
    """The fit's mode; of a sampled fit the mode of the path at the parameters' posterior mean."""
    cm, args = fit.cm, fit.args
    if isinstance(fit, LaplaceFit):
        return Point(cm, args, fit.marginal.x, fit.marginal.u, fit.marginal.factor)
    x, u = fit.flat_draws()
    mean = u.reshape(-1, cm.k).mean(axis=0)
    mode = find_mode(cm, args, x.reshape(-1, *x.shape[2:]).mean(axis=0), mean)
    factor = _factor(cm.terms(mode.x, mean, args, 0.0, False)[2], cm.d)
    return Point(cm, args, mode.x, mean, factor)


def _shifted(args: tuple, shift):
    data = args[0]
    return dataclasses.replace(data, receiver_xy=data.receiver_xy + shift), *args[1:]


def _surrogate(cm: ChainModel, shift, x, here, u, args):
    """What has the arrivals' Gauss-Newton Hessian at path ``here`` and no shift."""
    fixed = cm._trace(cm.sites(here, u)[0], args)
    total = jnp.zeros(())
    for name, site in cm._trace(cm.sites(x, u)[0], _shifted(args, shift)).items():
        base, mask = _unwrap(site["fn"]) if site["type"] == "sample" else (None, None)
        if hasattr(base, "curvature"):
            law = _unwrap(fixed[name]["fn"])[0]
            curvature = law.curvature(site["value"])
            if mask is not None:
                curvature = jnp.where(mask, curvature, 0.0)
            total += 0.5 * jnp.sum(curvature * (base.loc - law.loc) ** 2)
    return total


@functools.lru_cache(maxsize=16)
def _compiled(cm: ChainModel):
    """Gradient in the shift; blocks of the Hessian; redrawn arrivals."""

    def gradient(x, u, args):
        def of(shift):
            return cm.log_joint(x, u, _shifted(args, shift))

        return jax.grad(of)(jnp.zeros(args[0].receiver_xy.shape))

    def blocks(x, u, args):
        def slope(shift):
            both = jax.grad(functools.partial(_surrogate, cm), argnums=(0, 1))
            return both(shift.reshape(args[0].receiver_xy.shape), x, x, u, args)

        own, path = jax.jacfwd(slope)(jnp.zeros(args[0].receiver_xy.size))
        return own.reshape(own.shape[-1], -1), jnp.moveaxis(path, -1, 0)

    def drawn(key, x, u, args):
        law, _ = _unwrap(cm._trace(cm.sites(x, u)[0], args)["arrival"]["fn"])
        return jnp.where(args[0].heard, law.sample(key), args[0].range)

    return jax.jit(gradient), jax.jit(blocks), jax.jit(drawn)


def information(point: Point) -> np.ndarray:
    """Efficient information (R, 2, R, 2) of the receivers' positions at a fit, 1/m^2."""
    own, path = (np.asarray(b) for b in _compiled(point.cm)[1](point.x, point.u, point.args))
    taken = np.tensordot(path, point.factor.solve(path), axes=([1, 2], [1, 2]))
    shape = point.args[0].receiver_xy.shape
    return (0.5 * (own - taken + (own - taken).T)).reshape(*shape, *shape)


def score(point: Point, args: tuple | None = None) -> np.ndarray:
    """Score (R, 2) at a fit or, given data drawn from it, at the path refitted to those, 1/m."""
    x = point.x
    if args is None:
        args = point.args
    else:
        x = find_mode(point.cm, args, x, point.u, max_steps=10, tol=1e-3).x
    return np.asarray(_compiled(point.cm)[0](x, point.u, args))


def redrawn(point: Point, key) -> tuple:
    """The arguments with arrivals drawn anew from the fitted law at the fitted path."""
    drawn = _compiled(point.cm)[2](key, point.x, point.u, point.args)
    return (dataclasses.replace(point.args[0], range=drawn), *point.args[1:])
