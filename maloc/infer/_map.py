"""The whitening map: standard normal coordinates in which a chain's posterior is nearly N(0, I).

    u = u_hat + C zeta,   x = x_hat + B (u - u_hat) + W (z exp(-S (u - u_hat)))

W is the inverse transposed factor of the path's precision, applied by doubled shifts (a few
multiplies, not a scan) as far ahead as it reaches. B moves the mode with the parameters; S lets the
widths follow them: without it the widths are wrong wherever the parameters are not at their mode,
and trajectories get long. The log Jacobian is part of the density, so the target is exact whatever
the map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._model import ChainModel
from maloc.infer.marginal import MarginalFit
from maloc.infer.mode import _factor

__all__ = ["WhiteningMap", "from_white", "make_map", "potential", "unwhiten"]


class WhiteningMap(NamedTuple):
    """Arrays of the map: x (T, d), u (k,), C (k, k), B (k, T, d), S (k, T, d).

    W is kept as its root (T, d, d) and doubled powers (J, T, d, d): `ChainFactor.doubled`.
    """

    x: jax.Array
    u: jax.Array
    c: jax.Array
    b: jax.Array
    s: jax.Array
    root: jax.Array
    powers: jax.Array


def make_map(cm: ChainModel, args: tuple, fit: MarginalFit) -> WhiteningMap:
    """The map at a marginal fit: every difference is taken at the fitted path."""
    k, d, length = cm.k, cm.d, fit.x.shape[0]
    step = 0.1 * np.sqrt(np.diag(fit.covariance)) if k else np.zeros(0)
    offsets = np.concatenate([np.diag(step), -np.diag(step)])
    if k:
        bands = [cm.terms(fit.x, fit.u + o, args, 0.0, False)[2] for o in offsets]
        logs = np.array([_factor(band, d).log_diagonal for band in bands])
        s = (logs[:k] - logs[k:]) / (2 * step)[:, None, None]
    else:
        s = np.zeros((0, length, d))
    root, powers = fit.factor.doubled()
    return WhiteningMap(
        x=jnp.asarray(fit.x),
        u=jnp.asarray(fit.u),
        c=jnp.asarray(np.linalg.cholesky(fit.covariance)) if k else jnp.zeros((0, 0)),
        b=jnp.asarray(fit.slope),
        s=jnp.asarray(s),
        root=jnp.asarray(root),
        powers=jnp.asarray(powers),
    )


def _multiply(blocks, vectors):
    return jnp.einsum("tij,tj->ti", blocks, vectors)


def unwhiten(root, powers, z):
    """L^-T z (T, d) by doubled shifts."""
    y = _multiply(root, z)
    for j in range(powers.shape[0]):
        reach = 2**j
        if reach < y.shape[0]:
            y = y.at[:-reach].add(_multiply(powers[j, :-reach], y[reach:]))
    return y


def from_white(m: WhiteningMap, white):
    """Path (T, d), parameters (k,) and log Jacobian (up to a constant) of white (k + T d,)."""
    k = m.u.shape[0]
    delta = m.c @ white[:k]
    z = white[k:].reshape(m.x.shape)
    shift = jnp.tensordot(delta, m.b, 1) if k else 0.0
    log_scale = jnp.tensordot(delta, m.s, 1) if k else jnp.zeros_like(z)
    x = m.x + shift + unwhiten(m.root, m.powers, z * jnp.exp(-log_scale))
    return x, m.u + delta, -jnp.sum(log_scale)


def potential(cm: ChainModel, white, m: WhiteningMap, args: tuple):
    """Negative log density of the white coordinates: exact target, Jacobian included."""
    x, u, log_jacobian = from_white(m, white)
    return -cm.log_joint(x, u, args) - log_jacobian
