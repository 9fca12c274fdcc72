"""The variational guide: a Gauss-Markov path around Gaussian parameters, and its natural units.

    u = u_hat + C zeta,   x = x_hat + B delta + y,   delta = u - u_hat,
    y_t = R_t E(delta) z_t + (M_t + N_t delta) y_(t+1)

with zeta and z standard normal: given the parameters y = L^-T z with L block-bidiagonal. E is upper
triangular, exp(S delta) on the diagonal and S delta above it. This is the sampler's whitening map
pushed forward, and N more: by it the path's correlation, too, follows the parameters. Without N
their widths come out a fifth too small however long the chain is, since the guide then fits the
path better the less the parameters move.

Means and widths are learnt; how the path follows the parameters, B, S and N, stays as the Laplace
fit has it, to second order: the noise of learning k T d (2 d + 1) numbers more narrowed the
parameters to a half. In the parts that are learnt the Fisher information of the guide is
block-diagonal. Increments are counted from the Laplace fit in units in which it is nearly constant,
so that a gradient step is a natural one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._chain import ChainFactor
from maloc.infer._map import WhiteningMap
from maloc.infer._model import ChainModel
from maloc.infer.marginal import MarginalFit
from maloc.infer.mode import _factor

__all__ = [
    "Frame", "Guide", "Learnt", "covariances", "information", "laplace_frame", "log_density",
    "moved", "push", "still", "whitening",
]  # fmt: skip


class Guide(NamedTuple):
    """Parts: x (T, d), u (k,), c (k, k), b (k, T, d), s, n (k, T, d, d), root, carry (T, d, d)."""

    x: jax.Array
    u: jax.Array
    c: jax.Array
    b: jax.Array
    s: jax.Array
    n: jax.Array
    root: jax.Array
    carry: jax.Array


class Learnt(NamedTuple):
    """Increments of what is learnt: x (T, d), u (k,), c (k, k), root and carry (T, d, d)."""

    x: jax.Array
    u: jax.Array
    c: jax.Array
    root: jax.Array
    carry: jax.Array


class Frame(NamedTuple):
    """Where increments start, and their units.

    unit : (T, d, d), inverse Cholesky factor of the next state's covariance given the parameters;
    0 where the chain starts afresh there, so that it stays so.
    """

    start: Guide
    unit: jax.Array


def laplace_frame(cm: ChainModel, args: tuple, fit: MarginalFit) -> Frame:
    """The guide that the Laplace fit is; S and N by differences at the fitted path."""
    k, d, length = cm.k, cm.d, fit.x.shape[0]
    root, carry = _recursion(fit.factor)
    inverse = np.linalg.inv(root)
    s, n = np.zeros((2, k, length, d, d))
    for i, step in enumerate(0.1 * np.sqrt(np.diag(fit.covariance))):
        ends = []
        for way in (step, -step):
            band = cm.terms(fit.x, fit.u + way * np.eye(k)[i], args, 0.0, False)[2]
            ends.append(_recursion(_factor(band, d)))
        s[i] = inverse @ (ends[0][0] - ends[1][0]) / (2 * step)
        n[i] = (ends[0][1] - ends[1][1]) / (2 * step)
    unit = np.zeros_like(carry)
    unit[:-1] = np.linalg.inv(np.linalg.cholesky(fit.factor.covariances()[1:]))
    unit[~np.any(carry != 0, axis=(1, 2))] = 0.0
    c = np.linalg.cholesky(fit.covariance) if k else np.zeros((0, 0))
    start = Guide(*map(jnp.asarray, (fit.x, fit.u, c, fit.slope, s, n, root, carry)))
    return Frame(start, jnp.asarray(unit))


def _recursion(factor: ChainFactor) -> tuple[np.ndarray, np.ndarray]:
    """R = L_tt^-T and M = -R L_(t+1,t)^T (T, d, d) of a factor."""
    diagonal, below = factor._blocks()
    root = np.linalg.inv(diagonal).transpose(0, 2, 1)
    carry = np.zeros_like(root)
    carry[:-1] = -root[:-1] @ below.transpose(0, 2, 1)
    return root, carry


def _times(blocks, vectors):
    return jnp.einsum("tij,tj->ti", blocks, vectors)


def _chained(carry, noise):
    """y_t = noise_t + carry_t y_(t+1), backward in time; on a CPU far quicker than doubling."""

    def step(ahead, part):
        y = part[1] + part[0] @ ahead
        return y, y

    return jax.lax.scan(step, jnp.zeros_like(noise[0]), (carry, noise), reverse=True)[1]


def _solved(upper, vectors):
    """Upper triangular blocks' solutions (T, d), column by column for all states at once."""
    columns: list = []
    for i in reversed(range(vectors.shape[1])):
        rest = sum(upper[:, i, j] * z for j, z in enumerate(columns, i + 1))
        columns.insert(0, (vectors[:, i] - rest) / upper[:, i, i])
    return jnp.stack(columns, axis=1)


def _mixing(steps, lower: bool = False):
    """Triangular matrices near the identity (..., n, n); the diagonal by its logarithm."""
    outside = jnp.tril(steps, -1) if lower else jnp.triu(steps, 1)
    diagonal = jnp.exp(jnp.diagonal(steps, axis1=-2, axis2=-1))
    eye = jnp.eye(steps.shape[-1])
    return outside + diagonal[..., None] * eye[(None,) * (steps.ndim - 2)]


def still(frame: Frame) -> Learnt:
    """Increments of nothing."""
    return Learnt(*(jnp.zeros_like(getattr(frame.start, part)) for part in Learnt._fields))


def information(by: Learnt) -> Learnt:
    """Fisher information of the increments at 0: 2 for what is a logarithm of a width, else 1."""
    ones = jax.tree.map(jnp.ones_like, by)
    c, wide = ones.c + jnp.eye(by.u.shape[0]), ones.root + jnp.eye(by.x.shape[1])[None]
    return ones._replace(c=c, root=wide)


def moved(frame: Frame, by: Learnt) -> Guide:
    """The guide at increments ``by`` from the frame's start.

    Where u_hat moves, the path moves as it does given the parameters: else path and parameters
    would wait for one another, as in the EM algorithm, and take four times the steps.
    """
    start, unit = frame.start, frame.unit
    shift = start.c @ by.u
    x, root, carry = _given(start, shift)
    return start._replace(
        x=x + _chained(start.carry, _times(start.root, by.x)),
        u=start.u + shift,
        c=start.c @ _mixing(by.c, True),
        root=jnp.einsum("tij,tjk->tik", root, _mixing(by.root)),
        carry=carry + jnp.einsum("tij,tjk,tkl->til", start.root, by.carry, unit),
    )


def _given(g: Guide, delta):
    """Mean (T, d), R E and M + N delta (T, d, d) of the path at parameters u_hat + delta."""
    if not g.u.shape[0]:
        return g.x, g.root, g.carry
    root = jnp.einsum("tij,tjk->tik", g.root, _mixing(jnp.tensordot(delta, g.s, 1)))
    return g.x + jnp.tensordot(delta, g.b, 1), root, g.carry + jnp.tensordot(delta, g.n, 1)


def push(g: Guide, white):
    """Path (T, d) and parameters (k,) of white (k + T d,)."""
    k = g.u.shape[0]
    delta = g.c @ white[:k]
    mean, root, carry = _given(g, delta)
    return mean + _chained(carry, _times(root, white[k:].reshape(mean.shape))), g.u + delta


def log_density(g: Guide, x, u):
    """Log density of the guide at a path and parameters, all constants included."""
    delta = u - g.u
    mean, root, carry = _given(g, delta)
    off = x - mean
    ahead = jnp.concatenate([off[1:], jnp.zeros_like(off[:1])])
    z = _solved(root, off - _times(carry, ahead))
    squares = jnp.sum(z**2)
    log_det = jnp.sum(jnp.log(jnp.diagonal(root, axis1=1, axis2=2)))
    if g.u.shape[0]:
        squares += jnp.sum(jax.scipy.linalg.solve_triangular(g.c, delta, lower=True) ** 2)
        log_det += jnp.sum(jnp.log(jnp.diagonal(g.c)))
    return -0.5 * squares - log_det - 0.5 * (delta.size + x.size) * jnp.log(2 * jnp.pi)


def covariances(g: Guide, zeta):
    """Covariance (T, d, d) of each state given the parameters, mean over those of zeta (m, k)."""
    delta = zeta @ g.c.T

    def step(ahead, part):
        root, carry, s, n = part
        root = root[None] @ _mixing(jnp.tensordot(delta, s, 1))
        carry = carry[None] + jnp.tensordot(delta, n, 1)
        out = root @ jnp.swapaxes(root, 1, 2) + carry @ ahead @ jnp.swapaxes(carry, 1, 2)
        return out, out.mean(axis=0)

    parts = g.root, g.carry, jnp.moveaxis(g.s, 1, 0), jnp.moveaxis(g.n, 1, 0)
    none = jnp.zeros((len(zeta), *g.root.shape[1:]))
    return jax.lax.scan(step, none, parts, reverse=True)[1]


def whitening(g: Guide) -> WhiteningMap:
    """The sampler's map nearest to the guide: S's diagonal, and no N."""
    root, powers = _factor(_precision(g), g.x.shape[1]).doubled()
    s = -jnp.diagonal(g.s, axis1=2, axis2=3)
    return WhiteningMap(g.x, g.u, g.c, g.b, s, jnp.asarray(root), jnp.asarray(powers))


def _precision(g: Guide) -> np.ndarray:
    """Band (2 d, T d) of the path's precision at u_hat."""
    length, d = g.x.shape
    diagonal = np.linalg.inv(g.root).transpose(0, 2, 1)  # L_tt
    below = -np.asarray(g.carry)[:-1].transpose(0, 2, 1) @ diagonal[:-1]  # L_(t+1,t)
    own = diagonal @ diagonal.transpose(0, 2, 1)
    own[1:] += below @ below.transpose(0, 2, 1)
    columns = np.zeros((length, 2 * d, d))
    columns[:, :d] = own
    columns[:-1, d:] = below @ diagonal[:-1].transpose(0, 2, 1)
    band = np.zeros((2 * d, length, d))
    for j in range(d):
        band[: 2 * d - j, :, j] = columns[:, j:, j].T
    return band.reshape(2 * d, length * d)
