"""The whitening map: standard normal coordinates in which a chain's posterior is nearly N(0, I).

    u = u_hat + C zeta,   x = x_hat + B (u - u_hat) + W (z exp(-S (u - u_hat)))

W is the inverse transposed factor of the path's precision, cut to a few states ahead (a multiply,
not a scan); B moves the mode with the parameters; S lets the widths follow them: without it the
widths are wrong wherever the parameters are not at their mode, and trajectories get long. The log
Jacobian is part of the density, so the target is exact whatever the map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._model import ChainModel
from maloc.infer.marginal import MarginalFit
from maloc.infer.mode import _factor

__all__ = ["WhiteningMap", "from_white", "make_map", "potential"]

_WINDOW = 8


class WhiteningMap(NamedTuple):
    """Arrays of the map: x (T, d), u (k,), C (k, k), B (k, T, d), S (k, T, d), W both ways."""

    x: jax.Array
    u: jax.Array
    c: jax.Array
    b: jax.Array
    s: jax.Array
    ahead: jax.Array
    back: jax.Array


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
    w = fit.factor.window(_WINDOW)
    ahead = w.transpose(0, 2, 1, 3).reshape(length, d, _WINDOW * d)
    back = np.zeros((length, d, _WINDOW, d))
    for j in range(min(_WINDOW, length)):
        back[j:, :, j, :] = w[: length - j, j].transpose(0, 2, 1)
    return WhiteningMap(
        x=jnp.asarray(fit.x),
        u=jnp.asarray(fit.u),
        c=jnp.asarray(np.linalg.cholesky(fit.covariance)) if k else jnp.zeros((0, 0)),
        b=jnp.asarray(fit.slope),
        s=jnp.asarray(s),
        ahead=jnp.asarray(ahead),
        back=jnp.asarray(back.reshape(length, d, _WINDOW * d)),
    )


def _multiply(matrix, z, forward: bool):
    """Banded multiply: rows of (T, d, W d) against the W states ahead of (or behind) each."""
    length, d = z.shape
    width = matrix.shape[2] // d
    pad = jnp.zeros((width - 1, d), z.dtype)
    if forward:
        padded = jnp.concatenate([z, pad])
        parts = [padded[w : w + length] for w in range(width)]
    else:
        padded = jnp.concatenate([pad, z])
        parts = [padded[width - 1 - w : width - 1 - w + length] for w in range(width)]
    window = jnp.concatenate(parts, axis=1)
    return jnp.einsum("tij,tj->ti", matrix, window)  # a batched dot: four times a fused sum's speed


@jax.custom_vjp
def _unwhiten(z, ahead, back):
    return _multiply(ahead, z, True)


def _unwhiten_forward(z, ahead, back):
    return _multiply(ahead, z, True), back


def _unwhiten_backward(back, g):
    return _multiply(back, g, False), None, None


_unwhiten.defvjp(_unwhiten_forward, _unwhiten_backward)


def from_white(m: WhiteningMap, white):
    """Path (T, d), parameters (k,) and log Jacobian (up to a constant) of white (k + T d,)."""
    k = m.u.shape[0]
    delta = m.c @ white[:k]
    z = white[k:].reshape(m.x.shape)
    shift = jnp.tensordot(delta, m.b, 1) if k else 0.0
    log_scale = jnp.tensordot(delta, m.s, 1) if k else jnp.zeros_like(z)
    x = m.x + shift + _unwhiten(z * jnp.exp(-log_scale), m.ahead, m.back)
    return x, m.u + delta, -jnp.sum(log_scale)


def potential(cm: ChainModel, white, m: WhiteningMap, args: tuple):
    """Negative log density of the white coordinates: exact target, Jacobian included."""
    x, u, log_jacobian = from_white(m, white)
    return -cm.log_joint(x, u, args) - log_jacobian
