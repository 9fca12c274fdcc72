"""Long gaps: the adiabatic closed form, G decaying at the rate that the local q sets.

With constant q, a defective renewal density decays as exp(-r s), q integral f exp(r x) dx = 1
(Feller 1971, vol. 2, XI.6). With q varying along the gap,

    log G = - integral r(q) ds + e(q_0) + e(q_D),   e = -(log q + log m) / 2,
    m = q integral x f exp(r x) dx,

and an end that is no heard ping adds log of q integral end(x) exp(r x) dx.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline

from maloc._jax import jax, jnp

__all__ = [
    "ENDS",
    "LongPart",
    "log_likelihood",
    "log_pmf",
    "splines",
]

_LOG_Q = np.linspace(-40.0, 0.5, 811)
_GAUSS = np.polynomial.legendre.leggauss(12)
ENDS = (("inside", False), ("after", False), ("before", False), ("before", True))


@dataclass(frozen=True)
class LongPart:
    """N long gaps, a pytree.

    Attributes
    ----------
    index : (N,) int32
        Which gap of the data set; one beyond the last for padding.
    duration : (N,) s;  kind : (N,) int32
        Kind: place in `ENDS`.
    time, weight : (N, K)
        Nodes, s away from the heard ping, and their trapezoid weights; the last one repeated.
    states : (N, K) int32
    rate, start : (L, 4);  end : (4, L, 4)
        Cubic splines in log q: r, e, and e with each kind's end.
    real : (N,)
        0 for padding.
    """

    index: np.ndarray
    duration: np.ndarray
    kind: np.ndarray
    time: np.ndarray
    weight: np.ndarray
    states: np.ndarray
    rate: np.ndarray
    start: np.ndarray
    end: np.ndarray
    real: np.ndarray


jax.tree_util.register_dataclass(LongPart, [f.name for f in fields(LongPart)], [])


def splines(law) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tables (rate, start, end) of a law."""
    edges = np.unique([0.0, *law.breaks, *law.first_breaks(True), *law.first_breaks(False)])
    half = np.diff(edges)[:, None] / 2
    x = ((edges[:-1] + edges[1:])[:, None] / 2 + half * _GAUSS[0]).ravel()
    w = (half * _GAUSS[1]).ravel()
    f = w * law.density(x)
    r = np.zeros_like(_LOG_Q)
    for i in range(len(r) - 1, -1, -1):  # Newton from the neighbour; log mgf is convex
        r[i] = r[i + 1] if i + 1 < len(r) else 0.0
        for _ in range(50):
            grown = f * np.exp(r[i] * x)
            step = (np.log(grown.sum()) + _LOG_Q[i]) / (np.sum(x * grown) / grown.sum())
            r[i] -= step
            if abs(step) < 1e-13 * (1 + abs(r[i])):
                break
    grown = np.exp(r[:, None] * x)
    m = np.exp(_LOG_Q) * (grown @ (f * x))
    start = -0.5 * (_LOG_Q + np.log(m))
    last = {
        "inside": np.zeros_like(r),
        "after": _LOG_Q + np.log(grown @ (w * law.survival(x))),
    }
    for first in (False, True):
        last[f"before{first}"] = _LOG_Q + np.log(grown @ (w * law.first_density(x, first)))
    ends = np.stack([start + value for value in last.values()])
    both = CubicSpline(_LOG_Q, np.vstack([r, start, ends]), axis=1).c.transpose(2, 1, 0)
    return both[0], both[1], both[2:]


def _spline(cells, log_q):
    """A table at log q, any shape; `cells` broadcast to (..., L, 4) by the caller's gather."""
    y = jnp.clip(log_q, _LOG_Q[0], _LOG_Q[-1])
    width = _LOG_Q[1] - _LOG_Q[0]
    at = jax.lax.stop_gradient(jnp.floor((y - _LOG_Q[0]) / width)).astype(int)
    at = jnp.clip(at, 0, len(_LOG_Q) - 2)
    c = cells(at)
    x = y - (_LOG_Q[0] + width * at)
    return ((c[..., 0] * x + c[..., 1]) * x + c[..., 2]) * x + c[..., 3]


def log_likelihood(part: LongPart, log_q):
    """Log likelihood of each gap, (N,)."""
    here = log_q[part.states]
    decay = jnp.sum(part.weight * _spline(lambda at: part.rate[at], here), axis=1)
    first = _spline(lambda at: part.start[at], here[:, 0])
    last = _spline(lambda at: part.end[part.kind, at], here[:, -1])
    return jnp.where(part.real > 0, first + last - decay, 0.0)


def log_pmf(part: LongPart, log_q, most: int):
    """Log probability of 0..most missed pings, (N, most + 1): normal, mean and variance exact."""

    def shifted(c):
        return log_likelihood(part, log_q + c)

    def mean_at(c):
        return jax.jvp(shifted, (c,), (1.0,))[1]

    mean, variance = jax.jvp(mean_at, (0.0,), (1.0,))
    sd = jnp.sqrt(jnp.maximum(variance, 1e-4))
    edge = (jnp.arange(most + 2)[None] - 0.5 - mean[:, None]) / sd[:, None]
    cdf = jax.scipy.special.ndtr(edge)
    return jnp.log(jnp.maximum(jnp.diff(cdf, axis=1), 1e-300))
