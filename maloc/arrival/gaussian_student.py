"""Gaussian arrivals with a Student t part; public as `maloc.arrival.GaussianStudent`."""

from __future__ import annotations

import math
from typing import Any

from jax.scipy.special import ndtr
from jaxtyping import Array
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp
from maloc.arrival.error import ArrivalError
from maloc.arrival.gennorm import quantile

__all__ = ["GaussianStudent"]

_PEAK = 1 / math.sqrt(2 * math.pi)
_T3_PEAK = 2 / (math.pi * math.sqrt(3))  # density of Student's t with 3 df at 0


class GaussianStudent(ArrivalError):
    """Mixture of a Gaussian and a Student t with three degrees of freedom: YAPS's "Mixture".

    f(e) = (1 - w) N(e; 0, sigma) + w t3(e / scale) / scale for e = value - loc. The t part is
    symmetric: it takes late arrivals for errors either way.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Standard deviation of the Gaussian part, in the unit of the value.
    scale : float or array
        Scale of the t part, same unit.
    w : float or array
        Share of the t part, above 0 and at most 1.

    References
    ----------
    Baktoft, Gjelland, Okland & Thygesen (2017) Positioning of aquatic animals based on
    time-of-arrival and random walk models using YAPS. Sci. Rep. 7: 14294.
    """

    arg_constraints = {
        "loc": constraints.real,
        "sigma": constraints.positive,
        "scale": constraints.positive,
        "w": constraints.unit_interval,
    }
    reparametrized_params = ["loc", "sigma", "scale"]
    sigma: Any
    scale: Any
    w: Any

    def __init__(
        self, loc: Any = 0.0, sigma: Any = 1.0, scale: Any = 10.0, w: Any = 0.05, *,
        validate_args=None,
    ):  # fmt: skip
        self.loc, self.sigma, self.scale, self.w = promote_shapes(loc, sigma, scale, w)
        shape = jax.lax.broadcast_shapes(*(jnp.shape(a) for a in (loc, sigma, scale, w)))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def _densities(self, value):
        """Densities of the two parts; added up, for the t part never vanishes."""
        error = value - self.loc
        gaussian = (1 - self.w) * _PEAK / self.sigma * jnp.exp(-0.5 * (error / self.sigma) ** 2)
        student = self.w * _T3_PEAK / self.scale / (1 + (error / self.scale) ** 2 / 3) ** 2
        return gaussian, student

    def log_prob(self, value):
        """Log density."""
        return jnp.log(sum(self._densities(value)))

    def p_direct(self, value):
        """Posterior probability that each arrival is of the Gaussian part."""
        gaussian, student = self._densities(value)
        return gaussian / (gaussian + student)

    def sample(self, key: Array, sample_shape=()):
        """Draw."""
        key_normal, key_t, key_part = jax.random.split(key, 3)
        shape = self.shape(sample_shape)
        normal = self.sigma * jax.random.normal(key_normal, shape)
        wide = self.scale * jax.random.t(key_t, 3.0, shape)
        return self.loc + jnp.where(jax.random.uniform(key_part, shape) < self.w, wide, normal)

    def cdf(self, value):
        """Distribution function."""
        error = value - self.loc
        t = error / (self.scale * math.sqrt(3))
        student = 0.5 + (jnp.arctan(t) + t / (1 + t**2)) / math.pi
        return (1 - self.w) * ndtr(error / self.sigma) + self.w * student

    def icdf(self, q):
        """Quantile function, by bisection; differentiable."""
        return quantile(self.cdf, q, self.loc, self.sigma)

    @property
    def variance(self):
        """Variance: that of t3 is three times its squared scale."""
        both = (1 - self.w) * self.sigma**2 + self.w * 3 * self.scale**2
        return jnp.broadcast_to(both, self.batch_shape)

    def widened(self, scale) -> GaussianStudent:
        """The same law with both scales at least ``scale``."""
        wider = jnp.maximum(self.sigma, scale), jnp.maximum(self.scale, scale)
        return GaussianStudent(self.loc, *wider, self.w)

    def direct_curvature(self, value):
        """P / sigma^2, p the probability of the Gaussian part."""
        return self.p_direct(value) / self.sigma**2

    def robust_curvature(self, value):
        """Sum over the parts of probability times weight: the surrogate of EM, globally above."""
        p, error = self.p_direct(value), value - self.loc
        return p / self.sigma**2 + (1 - p) * 4 / (3 * self.scale**2 + error**2)

    def _second(self, value):
        """Second derivative of ``log_prob``: mean of the parts' plus the variance of the slopes."""
        p, error = self.p_direct(value), value - self.loc
        size = 3 * self.scale**2 + error**2
        slopes = -error / self.sigma**2 + 4 * error / size  # difference of the parts'
        student = -4 * (3 * self.scale**2 - error**2) / size**2
        return p * (1 - p) * slopes**2 - p / self.sigma**2 + (1 - p) * student
