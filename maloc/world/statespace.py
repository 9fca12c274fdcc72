"""Where an animal can be at all: the state space of spatial capture-recapture, with soft edges.

A hard wall has no gradient and makes samplers diverge; here the density falls off smoothly over the
width ``edge`` instead.
"""

from __future__ import annotations

from typing import Any

import numpyro.distributions as dist
from numpyro.distributions import constraints

from maloc._jax import jax, jnp

__all__ = ["SoftBox"]


class SoftBox(dist.Distribution):
    """Uniform over a box whose walls are smeared by a logistic law: uniform + logistic noise.

    Parameters
    ----------
    low, high : (A,) array
        Corners of the box (m).
    edge : float
        Scale of the smearing (m), positive: the density is 1/2 of the inner one at a wall and a
        fiftieth four edges outside.

    Notes
    -----
    Density of one axis: sigmoid((x - low) / e) sigmoid((high - x) / e) / Z, with
    Z = (high - low) / (1 - exp(-(high - low) / e)), which is exactly the convolution of the
    uniform with a logistic density.
    """

    arg_constraints = {
        "low": constraints.real_vector,
        "high": constraints.real_vector,
        "edge": constraints.positive,
    }
    support: Any = constraints.real_vector
    reparametrized_params = ["low", "high", "edge"]

    def __init__(self, low, high, edge, *, validate_args=None) -> None:
        self.low, self.high = jnp.asarray(low), jnp.asarray(high)
        self.edge = jnp.asarray(edge)
        super().__init__((), self.low.shape[-1:], validate_args=validate_args)

    def log_prob(self, value):
        """Log density of places (..., A), shape (...)."""
        lead = (None,) * (jnp.ndim(value) - 1)
        low, high = self.low[lead], self.high[lead]
        inside = jax.nn.log_sigmoid((value - low) / self.edge)
        inside += jax.nn.log_sigmoid((high - value) / self.edge)
        size = self.high - self.low
        log_z = jnp.log(size) - jnp.log(-jnp.expm1(-size / self.edge))
        return jnp.sum(inside, axis=-1) - jnp.sum(log_z)

    def sample(self, key: Any, sample_shape=()):
        """Draw places, shape ``sample_shape + (A,)``."""
        key_box, key_edge = jax.random.split(key)
        shape = (*sample_shape, *self.event_shape)
        lead = (None,) * len(sample_shape)
        inside = jax.random.uniform(key_box, shape)
        noise = jax.random.logistic(key_edge, shape)
        return self.low[lead] + inside * (self.high - self.low)[lead] + self.edge * noise

    @property
    def mean(self):
        """Middle of the box (A,)."""
        return 0.5 * (self.low + self.high)

    @property
    def variance(self):
        """Variance of each axis (A,), m2."""
        return (self.high - self.low) ** 2 / 12 + jnp.pi**2 / 3 * self.edge**2
