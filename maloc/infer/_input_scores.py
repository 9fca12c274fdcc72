"""Efficient scores of inputs that a model takes as given: where receivers stand, the sound speed.

Would the log density rise if receiver j stood elsewhere, the path following? To the first order
that is the score, the gradient in the receivers' positions less what the path takes over (through
its banded factor), with its information.

A sound speed that is too low by a share s makes every range too short by s. In the ranges' own
units that is an array drawn too large: a wrong sound speed is a displacement of all receivers
towards their middle, and needs no derivative of its own.

A receiver that is far off can be taken for one that hears nothing but late arrivals, and then has
no slope at all. The same scores with the arrivals' error widened, the path as it was, see it.
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

__all__ = ["Lens", "Point", "fitted_point", "lens", "redrawn", "refitted", "score"]


class Point(NamedTuple):
    """Where a fit stands: path (T, d), parameters (k,), factor of the path's precision."""

    cm: ChainModel
    args: tuple
    x: np.ndarray
    u: np.ndarray
    factor: ChainFactor


class Lens(NamedTuple):
    """How the receivers are looked at.

    temper : least error of an arrival, m; information : (R, 2, R, 2) 1/m^2; moved : (2 R, T, d),
    how the path moves with the receivers, its sign turned.
    """

    temper: float
    information: np.ndarray
    moved: np.ndarray


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


def _surrogate(cm: ChainModel, shift, x, here, u, args, temper):
    """What has the arrivals' Gauss-Newton Hessian at path ``here`` and no shift."""
    fixed = cm._trace(cm.sites(here, u)[0], args)
    total = jnp.zeros(())
    for name, site in cm._trace(cm.sites(x, u)[0], _shifted(args, shift)).items():
        if site["type"] != "sample":
            continue
        base, mask = _unwrap(site["fn"])
        if hasattr(base, "curvature"):
            law = _unwrap(fixed[name]["fn"])[0].widened(temper)
            at = site["value"]
            # far out in a wide law the second derivative vanishes, EM's curvature does not
            wide = jnp.asarray(temper) > 0
            curvature = jnp.where(wide, law.robust_curvature(at), law.curvature(at))
            if mask is not None:
                curvature = jnp.where(mask, curvature, 0.0)
            total += 0.5 * jnp.sum(curvature * (base.loc - law.loc) ** 2)
    return total


@functools.lru_cache(maxsize=16)
def _compiled(cm: ChainModel):
    """Gradient in shift and path; blocks of the Hessian; redrawn arrivals."""

    def gradient(x, u, args, temper):
        def of(shift, x):
            return cm._joint(x, u, _shifted(args, shift), temper)

        return jax.grad(of, argnums=(0, 1))(jnp.zeros(args[0].receiver_xy.shape), x)

    def blocks(x, u, args, temper):
        def slope(shift):
            both = jax.grad(functools.partial(_surrogate, cm), argnums=(0, 1))
            return both(shift.reshape(args[0].receiver_xy.shape), x, x, u, args, temper)

        own, path = jax.jacfwd(slope)(jnp.zeros(args[0].receiver_xy.size))
        return own.reshape(own.shape[-1], -1), jnp.moveaxis(path, -1, 0)

    def drawn(key, x, u, args):
        law, _ = _unwrap(cm._trace(cm.sites(x, u)[0], args)["arrival"]["fn"])
        return jnp.where(args[0].heard, law.sample(key), args[0].range)

    return jax.jit(gradient), jax.jit(blocks), jax.jit(drawn)


def lens(point: Point, temper: float = 0.0) -> Lens:
    """Information of the receivers' positions at a fit, errors widened to ``temper``."""
    cm, args, x, u = point.cm, point.args, point.x, point.u
    factor = point.factor
    if temper:
        factor = _factor(cm.terms(x, u, args, temper, True)[2], cm.d)
    own, path = (np.asarray(b) for b in _compiled(cm)[1](x, u, args, temper))
    moved = factor.solve(path)
    taken = np.tensordot(path, moved, axes=([1, 2], [1, 2]))
    shape = args[0].receiver_xy.shape
    information = 0.5 * (own - taken + (own - taken).T)
    return Lens(temper, information.reshape(*shape, *shape), moved)


def score(point: Point, through: Lens) -> np.ndarray:
    """Efficient score of the receivers' positions (R, 2), 1/m."""
    shift, path = _compiled(point.cm)[0](point.x, point.u, point.args, through.temper)
    taken = np.tensordot(through.moved, np.asarray(path), axes=([1, 2], [0, 1]))
    return np.asarray(shift) - taken.reshape(shift.shape)


def redrawn(point: Point, key) -> tuple:
    """The arguments with arrivals drawn anew from the fitted law at the fitted path."""
    drawn = _compiled(point.cm)[2](key, point.x, point.u, point.args)
    return (dataclasses.replace(point.args[0], range=drawn), *point.args[1:])


def refitted(point: Point, args: tuple) -> Point:
    """The fit with its path refitted to other arrivals, the parameters held."""
    x = find_mode(point.cm, args, point.x, point.u, max_steps=10, tol=1e-3).x
    return point._replace(args=args, x=x)
