"""Slow drift of one number along the chain: detection range, sound speed, burst interval."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp

__all__ = ["GaussMarkov", "IntervalDrift", "RandomWalk", "interval_step"]

_LOG_2PI = 1.8378770664093453


class _Drift(dist.Distribution):
    """A Markov path (T,): each state normal given the one before."""

    is_chain = True
    support: Any = constraints.independent(constraints.real, 1)

    # multiplier of the state before (T,), 0 where a path starts, and sd (T,)
    _laws: Callable[[], tuple[Array, Array]]

    def log_prob(self, value: Float[Array, "... T"]):
        """Log density of paths (..., T), shape (...)."""
        keep, sd = (jnp.broadcast_to(x, value.shape) for x in self._laws())
        before = jnp.concatenate([jnp.zeros_like(value[..., :1]), value[..., :-1]], axis=-1)
        z = (value - keep * before) / sd
        return jnp.sum(-0.5 * z**2 - jnp.log(sd) - 0.5 * _LOG_2PI, axis=-1)

    def sample(self, key: Array, sample_shape=()):
        """Draw paths, ``sample_shape + (T,)``."""
        keep, sd = self._laws()
        noise = jax.random.normal(key, (*sample_shape, *self.event_shape))
        noise = jnp.broadcast_to(sd, noise.shape) * noise

        def step(state, inputs):
            k, e = inputs
            state = k * state + e
            return state, state

        first = jnp.zeros(sample_shape)
        _, path = jax.lax.scan(step, first, (keep, jnp.moveaxis(noise, -1, 0)))
        return jnp.moveaxis(path, 0, -1)

    @property
    def mean(self):
        """Zero."""
        return jnp.zeros(self.event_shape)


class GaussMarkov(_Drift):
    """Stationary Gauss-Markov (Ornstein-Uhlenbeck) path of unit sd at given times.

    Parameters
    ----------
    dt : (T - 1,) array
        Seconds from each state to the next, positive.
    memory : ()
        Time after which the correlation is 1/e, s.
    tag : (T,) array of int
        Whose state each one is; each tag's path starts anew.
    """

    arg_constraints: Any = {}
    pytree_data_fields = ("dt", "memory", "tag")

    def __init__(self, dt, memory, tag, *, validate_args=None) -> None:
        self.dt, self.memory, self.tag = dt, memory, tag
        super().__init__((), (jnp.shape(dt)[0] + 1,), validate_args=validate_args)

    def _laws(self):
        same = jnp.diff(self.tag) == 0
        x = self.dt / self.memory
        keep = jnp.where(same, jnp.exp(-x), 0.0)
        sd = jnp.sqrt(jnp.where(same, -jnp.expm1(-2 * x), 1.0))
        return jnp.concatenate([jnp.zeros(1), keep]), jnp.concatenate([jnp.ones(1), sd])


class RandomWalk(_Drift):
    """Random walk with normal steps.

    Parameters
    ----------
    n : (T - 1,) array
        Length of each step, s or burst intervals; 0: the walk starts anew.
    sd : ()
        Standard deviation of a step of length 1.
    first_sd : ()
        Standard deviation of a first state.
    """

    arg_constraints: Any = {}
    pytree_data_fields = ("n", "sd", "first_sd")

    def __init__(self, n, sd, first_sd, *, validate_args=None) -> None:
        self.n, self.sd, self.first_sd = jnp.asarray(n), sd, first_sd
        super().__init__((), (jnp.shape(n)[0] + 1,), validate_args=validate_args)

    def _laws(self):
        known = self.n > 0
        sd = jnp.where(known, self.sd * jnp.sqrt(jnp.where(known, self.n, 1.0)), self.first_sd)
        keep = jnp.concatenate([jnp.zeros(1), jnp.where(known, 1.0, 0.0)])
        return keep, jnp.concatenate([jnp.full(1, self.first_sd), sd])


class IntervalDrift(RandomWalk):
    """How far a tag's burst interval is from its nominal one, a random walk over its pings.

    Parameters
    ----------
    n : (T - 1,) array
        Burst intervals from each state to the next; 0 where not known: the walk starts anew.
    sd : ()
        Standard deviation of the change from one interval to the next.
    first_sd : ()
        Standard deviation of a first one.
    """


def interval_step(n, before, after, sd, jitter):
    """Mean and sd of what n intervals add to n nominal ones, given the drift at both ends.

    With intervals b_0, b_0 + w_1, ..., each w normal with sd `sd` and each interval off by another
    `jitter`, the sum over n of them given b_0 and b_n is normal with mean n b_0 + (n - 1) / 2
    (b_n - b_0) and variance sd^2 (n - 1) n (n + 1) / 12 + n jitter^2.

    Parameters
    ----------
    n : (T - 1,) array
        Intervals, at least 1.
    before, after : (T - 1,) arrays
        b_0 and b_n.
    sd, jitter : ()
        In the unit of the drift.
    """
    mean = n * before + 0.5 * (n - 1) * (after - before)
    return mean, jnp.sqrt(sd**2 * (n - 1) * n * (n + 1) / 12 + n * jitter**2)
