"""The renewal recursion over batches of gaps of like size (JAX)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from maloc._jax import jax, jnp

__all__ = [
    "ExactPart",
    "LEAST_LOG_Q",
    "at_knots",
    "log_likelihood",
    "log_pmf",
    "q_on_grid",
]

LEAST_LOG_Q = -40.0  # a ping missed with a chance below e^-40: no digit of any answer
_MOST = 600.0  # largest exponent; by then the first interval has nothing to add


@dataclass(frozen=True)
class ExactPart:
    """N gaps on one grid of nodes, a pytree.

    Attributes
    ----------
    index : (N,) int32
        Which gap of the data set; one beyond the last for padding.
    duration : (N,) s;  kind : (N,) int32
        Kind: place in `maloc.schedule.renewal.long.ENDS`.
    left, right : (N, V) int32;  share : (N, V)
        Path at knot v: log_q of states `left` and `right`, `share` of the way.
    c0 : (N,);  first : (N, F);  later : (N, blocks * block)
        End rows.
    a : (rows, F);  beta : (lags, block, block);  diagonal : ()
        The shared recursion.
    coarse : int
        Nodes from knot to knot, static.
    """

    index: np.ndarray
    duration: np.ndarray
    kind: np.ndarray
    left: np.ndarray
    right: np.ndarray
    share: np.ndarray
    c0: np.ndarray
    first: np.ndarray
    later: np.ndarray
    a: np.ndarray
    beta: np.ndarray
    diagonal: np.ndarray
    coarse: int


jax.tree_util.register_dataclass(
    ExactPart,
    data_fields=[f.name for f in fields(ExactPart) if f.name != "coarse"],
    meta_fields=["coarse"],
)


def at_knots(part, log_q):
    """Log q at the knots of each gap, (N, V)."""
    left, right = log_q[part.left], log_q[part.right]
    return left + part.share * (right - left)


def q_on_grid(part: ExactPart, log_q):
    """Q at the nodes of each gap, (N, blocks * block): log q is linear between knots."""
    knots = at_knots(part, log_q)
    share = jnp.arange(part.coarse) / part.coarse
    between = knots[:, :-1, None] * (1 - share)[None, None]
    between = between + knots[:, 1:, None] * share[None, None]
    fine = between.reshape(len(knots), -1)[:, : part.later.shape[1]]
    # beyond a gap's end, where no weight lies, it extrapolates
    return jnp.exp(jnp.clip(fine, LEAST_LOG_Q, 1.0))


def log_likelihood(part: ExactPart, log_q):
    """Log G of each gap, (N,)."""
    q = q_on_grid(part, log_q)
    n, m = len(q), part.beta.shape[-1]
    lags = len(part.beta)
    early = q[:, : part.first.shape[1]]
    started = jnp.pad(early @ part.a.T, ((0, 0), (0, q.shape[1] - part.a.shape[0])))
    weights = part.beta.reshape(lags * m, m)  # lag 1 first

    def step(carry, block):
        past, total, scale = carry  # q H before, the last block first; both over exp(scale)
        q_block, rhs, later = block
        rhs = rhs * jnp.exp(jnp.minimum(-scale, _MOST))[:, None] + past @ weights
        if m == 1:
            rhs = rhs / (1 - part.diagonal * q_block)
        flow = q_block * rhs
        past = jnp.concatenate([flow, past], axis=1)[:, : lags * m]
        total = total + jnp.sum(later * flow, axis=1)
        size = jax.lax.stop_gradient(jnp.maximum(jnp.max(past, axis=1, initial=0.0), total))
        size = jnp.where(size > 0, size, 1.0)
        return (past / size[:, None], total / size, scale + jnp.log(size)), None

    constant = part.c0 + jnp.sum(part.first * early, axis=1)
    begin = (jnp.zeros((n, lags * m)), constant, jnp.zeros(n))
    blocks = [v.reshape(n, -1, m).swapaxes(0, 1) for v in (q, started, part.later)]
    (_, total, scale), _ = jax.lax.scan(step, begin, tuple(blocks))
    return jnp.log(jnp.where(total > 0, total, 1.0)) + scale


def log_pmf(part: ExactPart, log_q, most: int):
    """Log probability of 0..most missed pings, (N, most + 1).

    H of exactly n missed pings follows from that of n - 1: H(1) = A q, H(n) = B (q H(n - 1)).
    """
    q = q_on_grid(part, log_q)
    n, m = len(q), part.beta.shape[-1]
    early = q[:, : part.first.shape[1]]
    started = jnp.pad(early @ part.a.T, ((0, 0), (0, q.shape[1] - part.a.shape[0])))
    shape = (n, q.shape[1] // m, m)

    def step(carry, _):
        flow, scale = carry
        joint = jnp.sum(part.later * flow, axis=1)
        rows = flow.reshape(shape)
        after = jnp.zeros(shape)
        for j, weights in enumerate(part.beta, 1):
            after = after.at[:, j:].add(rows[:, :-j] @ weights)
        if m == 1:
            after = after + part.diagonal * rows
        flow = q * after.reshape(q.shape)
        size = jnp.max(flow, axis=1)
        size = jnp.where(size > 0, size, 1.0)
        return (flow / size[:, None], scale + jnp.log(size)), jnp.log(joint) + scale

    begin = (q * started, jnp.zeros(n))
    _, later = jax.lax.scan(step, begin, length=max(most - 1, 0))
    one = jnp.log(jnp.sum(part.first * early, axis=1))
    joint = jnp.stack([jnp.log(part.c0), one, *later], axis=1)[:, : most + 1]
    return joint - log_likelihood(part, log_q)[:, None]
