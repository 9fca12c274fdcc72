"""Poisson cues: heard and missed ones are independent, so everything is in closed form.

With rate lambda, inside and before: log G = log lambda - lambda integral (1 - q); after the last
heard cue the same without log lambda. An expiry hazard kappa adds -kappa D, and after the last cue
the mixture over the time at which the animal fell silent.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from maloc._jax import jax, jnp

__all__ = [
    "PoissonPart",
    "log_likelihood",
    "log_pmf",
    "missed_until",
]


@dataclass(frozen=True)
class PoissonPart:
    """N gaps, a pytree.

    Attributes
    ----------
    index : (N,) int32
        Which gap of the data set; one beyond the last for padding.
    duration : (N,) s;  kind : (N,) int32
        Padding: 0 s, kind 1 (after).
    time : (N, K) s;  states : (N, K) int32
        Nodes away from the heard cue; the last one repeated.
    rate, expiry : ()
        Per s.
    """

    index: np.ndarray
    duration: np.ndarray
    kind: np.ndarray
    time: np.ndarray
    states: np.ndarray
    rate: np.ndarray
    expiry: np.ndarray


jax.tree_util.register_dataclass(PoissonPart, [f.name for f in fields(PoissonPart)], [])


def _cumulated(part: PoissonPart, log_q):
    """Integral of q up to each node, (N, K): Simpson, log q linear between nodes."""
    here = log_q[part.states]
    a, b = here[:, :-1], here[:, 1:]
    mean = (jnp.exp(a) + 4 * jnp.exp((a + b) / 2) + jnp.exp(b)) / 6
    area = jnp.cumsum(jnp.diff(part.time, axis=1) * mean, axis=1)
    return jnp.concatenate([jnp.zeros_like(area[:, :1]), area], axis=1)


def _log_shares(part: PoissonPart, log_q):
    """Log mass of falling silent in each step and of never (N, K), and integral of q by then."""
    missed = _cumulated(part, log_q)
    exponent = (part.rate + part.expiry) * part.time - part.rate * missed
    fall, dt = jnp.diff(exponent, axis=1), jnp.diff(part.time, axis=1)
    some = fall > 1e-9
    safe = jnp.where(some, fall, 1.0)
    step = jnp.where(some, -jnp.expm1(-safe) / safe, 1.0) * dt * part.expiry
    dies = jnp.where(step > 0, jnp.log(jnp.where(step > 0, step, 1.0)) - exponent[:, :-1], -jnp.inf)
    log_mass = jnp.concatenate([dies, -exponent[:, -1:]], axis=1)
    middle = (missed[:, 1:] + missed[:, :-1]) / 2
    return log_mass, jnp.concatenate([middle, missed[:, -1:]], axis=1)


def log_likelihood(part: PoissonPart, log_q):
    """Log likelihood of each gap, (N,)."""
    log_mass, _ = _log_shares(part, log_q)
    silent = jax.scipy.special.logsumexp(log_mass, axis=1)
    return jnp.where(part.kind == 1, silent, log_mass[:, -1] + jnp.log(part.rate))


def _log_silent(part: PoissonPart, log_q):
    """Log chance of having fallen silent in each step, or never, given the gap; q's integral."""
    log_mass, missed = _log_shares(part, log_q)
    never = jnp.arange(log_mass.shape[1]) == log_mass.shape[1] - 1
    log_mass = jnp.where((part.kind == 1)[:, None] | never[None], log_mass, -jnp.inf)
    return jax.nn.log_softmax(log_mass, axis=1), missed


def missed_until(part: PoissonPart, log_q):
    """Chance of having fallen silent in each step, or never, and q's integral at nodes, (N, K)."""
    return jnp.exp(_log_silent(part, log_q)[0]), _cumulated(part, log_q)


def log_pmf(part: PoissonPart, log_q, most: int):
    """Log probability of 0..most missed cues, (N, most + 1)."""
    log_mass, missed = _log_silent(part, log_q)
    mean = jnp.maximum(part.rate * missed, 1e-300)[..., None]
    n = jnp.arange(most + 1)[None, None]
    each = n * jnp.log(mean) - mean - jax.scipy.special.gammaln(n + 1.0)
    return jax.scipy.special.logsumexp(log_mass[..., None] + each, axis=1)
