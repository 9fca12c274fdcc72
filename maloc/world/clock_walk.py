"""How receivers' clocks wander: offsets whose rates walk at random."""

from __future__ import annotations

import math
from typing import Any

import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp

__all__ = ["ClockWalk"]

_LOG_2PI = math.log(2 * math.pi)
_PER_STEP = math.sqrt(12.0)  # the part of the offset's noise that the rate's end does not tell


class ClockWalk(dist.Distribution):
    """Integrated random walks of C clocks, told as departures from given curves.

    The curves plus the value are the walks: it is as likely as they are, wherever the curves lie.
    What a curve has of a straight line matters at the first time only.

    Parameters
    ----------
    dt : array (T - 1,)
        From each time to the next, h.
    noise : array (C,)
        Standard deviation of a rate's change in an hour, ms/h.
    curves : array (T, 2, C)
        Offsets (ms) and rates (ms/h) that the value departs from.
    first_sd : pair of float
        Standard deviations of a first offset (ms) and rate (ms/h) about the curve's.

    Notes
    -----
    A value has shape (T, 2, C), ms and ms/h. Over a step h the state (offset, rate) becomes
    (offset + h rate, rate) plus normal noise of covariance q [[h^3/3, h^2/2], [h^2/2, h]],
    q = noise^2.

    References
    ----------
    Wahba (1978), J. R. Statist. Soc. B 40: 364-372: the integrated random walk is the prior of
    which cubic splines are the posterior mean.
    """

    is_chain = True
    arg_constraints: Any = {}
    support: Any = constraints.independent(constraints.real, 3)
    pytree_data_fields = ("dt", "noise", "curves")
    pytree_aux_fields = ("first_sd",)

    def __init__(self, dt, noise, curves, first_sd=(1e3, 180.0), *, validate_args=None) -> None:
        self.dt, self.noise, self.curves, self.first_sd = dt, noise, curves, first_sd
        super().__init__((), jnp.shape(curves), validate_args=validate_args)

    def log_prob(self, value: Float[Array, "... T 2 C"]):
        """Log density of departures (..., T, 2, C), shape (...)."""
        if value.ndim > 3:
            return jax.vmap(self.log_prob)(value)
        offset, rate = (self.curves[:, i] + value[:, i] for i in (0, 1))
        h, sd = self._steps()
        turn = jnp.diff(rate, axis=-2)
        bent = jnp.diff(offset, axis=-2) - h * rate[:-1] - 0.5 * h * turn
        off = sd * h / _PER_STEP
        steps = -0.5 * (turn / sd) ** 2 - 0.5 * (bent / off) ** 2 - jnp.log(sd * off) - _LOG_2PI
        first = [
            -0.5 * (value[0, i] / s) ** 2 - math.log(s) - 0.5 * _LOG_2PI
            for i, s in enumerate(self.first_sd)
        ]
        return jnp.sum(steps) + jnp.sum(first[0] + first[1])

    def _steps(self):
        """Length of each step (T - 1, 1) and sd of the rate's change in it (T - 1, C)."""
        h = self.dt[:, None]
        return h, self.noise[None] * jnp.sqrt(h)

    def sample(self, key: Array, sample_shape=()):
        """Draw departures, ``sample_shape + (T, 2, C)``."""
        if sample_shape:
            keys = jax.random.split(key, sample_shape)
            draw = self.sample
            for _ in sample_shape:
                draw = jax.vmap(draw)
            return draw(keys)
        z = jax.random.normal(key, self.event_shape)
        h, sd = self._steps()
        turn = sd * z[1:, 1]
        start = self.curves[0] + jnp.asarray(self.first_sd)[:, None] * z[0]
        rate = start[1:] + _summed(turn)
        moved = h * rate[:-1] + 0.5 * h * turn + sd * h / _PER_STEP * z[1:, 0]
        offset = start[:1] + _summed(moved)
        return jnp.stack([offset, rate], axis=1) - self.curves

    @property
    def mean(self):
        """Departures that straighten the curves (T, 2, C)."""
        time = _summed(self.dt[:, None])
        rate = jnp.broadcast_to(self.curves[0, 1], (len(time), self.event_shape[-1]))
        line = jnp.stack([self.curves[:1, 0] + time * rate, rate], axis=1)
        return line - self.curves


def _summed(x):
    """Running sums (T, C) of steps (T - 1, C), from 0."""
    return jnp.cumsum(jnp.concatenate([jnp.zeros_like(x[:1]), x]), axis=0)
