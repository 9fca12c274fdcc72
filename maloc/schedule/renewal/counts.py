"""Gaps of laws that hardly vary: a sum over the number of pings, these evenly spread.

Given n missed pings, ping j of an inside gap was sent close to j D / (n + 1), so the gap's density
is the sum over n of f_(n+1)(D) product of q there, f_m the density of the sum of m intervals. Log q
is linear between nodes: the log of every product is a fixed linear map of the nodes' log q.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from maloc._jax import jax, jnp

__all__ = [
    "CountPart",
    "counts",
    "log_likelihood",
    "log_pmf",
    "path_weights",
    "terms",
]

_NONE = -1e30  # log of a count's density where the law rules it out
_GAUSS = np.polynomial.legendre.leggauss(48)
_REACH = 7.0  # sds of the sum of the intervals


@dataclass(frozen=True)
class CountPart:
    """N gaps, a pytree.

    Attributes
    ----------
    index : (N,) int32
        Which gap of the data set; one beyond the last for padding.
    duration : (N,) s;  kind : (N,) int32
    least : (N,) int32
        First count n.
    log_density : (N, M)
        Of the counts least, least + 1, ...
    weight : (N, M, K);  states : (N, K) int32
        Sum over the pings of log q = weight @ log_q[states].
    """

    index: np.ndarray
    duration: np.ndarray
    kind: np.ndarray
    least: np.ndarray
    log_density: np.ndarray
    weight: np.ndarray
    states: np.ndarray


jax.tree_util.register_dataclass(CountPart, [f.name for f in fields(CountPart)], [])


def counts(kind: str, duration: float, law) -> np.ndarray:
    """Numbers of missed pings that a gap can hold; at least one, the nearest."""

    def solve(sign):  # m mean + sign reach sd sqrt(m) = duration, for m
        reach = _REACH * law.sd
        root = np.sqrt(reach**2 + 4 * law.mean * duration) - sign * reach
        return (root / (2 * law.mean)) ** 2

    first, last = int(np.floor(solve(1.0))), int(np.ceil(solve(-1.0)))
    if kind == "inside":
        return np.arange(max(first - 1, 0), max(last, 1))
    return np.arange(0 if law.expiry else max(first - 1, 0), last + 1)


def terms(kind: str, duration: float, law, end) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Counts n (M,), log density of each, and the mean time of the last missed ping, s."""
    n = counts(kind, duration, law)
    if kind == "inside":
        return n, law.log_sum_density(n + 1, np.full(len(n), duration)), duration * n / (n + 1)
    spread = _REACH * law.sd * np.sqrt(n)
    low = np.clip(n * law.mean - spread, 0.0, duration)
    high = np.clip(n * law.mean + spread, 0.0, duration)
    pieces = np.linspace(low, high, 9)  # (9, M)
    half = (pieces[1:] - pieces[:-1])[..., None] / 2
    s = (pieces[1:] + pieces[:-1])[..., None] / 2 + half * _GAUSS[0]
    many = np.broadcast_to(np.maximum(n, 1)[:, None], s.shape)
    mass = half * _GAUSS[1] * np.exp(law.log_sum_density(many, s)) * end(duration - s)
    total = mass.sum(axis=(0, 2))
    middle = (mass * s).sum(axis=(0, 2)) / np.maximum(total, 1e-300)
    total = np.where(n == 0, end(np.asarray(duration)), total)
    with np.errstate(divide="ignore"):
        return n, np.log(total), np.where(n == 0, 0.0, middle)


def path_weights(n: int, last: float, nodes: np.ndarray) -> np.ndarray:
    """Weights (K,) of the nodes' log q in its sum over pings at j last / n, j = 1..n."""
    at = last * np.arange(1, n + 1) / max(n, 1)
    k = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, max(len(nodes) - 2, 0))
    share = (at - nodes[k]) / (nodes[k + 1] - nodes[k])
    out = np.bincount(k, 1 - share, len(nodes))
    return out + np.bincount(k + 1, share, len(nodes))


def _log_terms(part: CountPart, log_q):
    return part.log_density + jnp.einsum("nmk,nk->nm", part.weight, log_q[part.states])


def log_likelihood(part: CountPart, log_q):
    """Log likelihood of each gap, (N,)."""
    return jax.scipy.special.logsumexp(_log_terms(part, log_q), axis=1)


def log_pmf(part: CountPart, log_q, most: int):
    """Log probability of 0..most missed pings, (N, most + 1)."""
    joint = jax.nn.log_softmax(_log_terms(part, log_q), axis=1)
    place = jnp.arange(most + 1)[None] - part.least[:, None]
    inside = (place >= 0) & (place < joint.shape[1])
    value = jnp.take_along_axis(joint, jnp.clip(place, 0, joint.shape[1] - 1), axis=1)
    return jnp.where(inside, value, _NONE)
