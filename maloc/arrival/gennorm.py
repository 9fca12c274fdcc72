"""The generalized normal distribution, and what the arrival laws share with it.

Public as `maloc.arrival.GeneralizedNormal`; here so that one module keeps to one idea.
"""

from __future__ import annotations

import math
from typing import Any

import numpyro.distributions as dist
from jax.scipy.special import gammaincc, gammaln
from jaxtyping import Array
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp

__all__ = ["GeneralizedNormal", "power", "quantile"]

_LOG_FLAT = math.log(1e-17)  # below this |z|^beta is nothing beside 1
_HALVINGS = 75
_REACH = 60.0  # asinh of the furthest quantile looked for, in scales: 6e25


def power(z, beta, max_log: float):
    """|z|^beta, cut at e^max_log, with finite value and gradient; fast for a static even beta."""
    if isinstance(beta, int | float) and float(beta).is_integer() and int(beta) % 2 == 0:
        limit = math.exp(max_log / beta)
        return jnp.clip(z, -limit, limit) ** int(beta)
    size = jnp.abs(z)
    nonzero = size > 0
    log_size = jnp.log(jnp.where(nonzero, size, 1.0))
    return jnp.where(nonzero, jnp.exp(jnp.minimum(beta * log_size, max_log)), 0.0)


def quantile(cdf, q, loc, scale):
    """Value at which a location-scale family's ``cdf`` reaches ``q``, by bisection.

    Bisects asinh((value - loc) / scale), so that centre and tails come out to rounding alike. The
    derivatives are those of the inverse function: in ``q``, and in whatever ``cdf`` closes over.
    """
    q = jnp.asarray(q, float)

    def value(t):
        return loc + scale * jnp.sinh(t)

    def halve(_, bounds):
        low, high = bounds
        middle = 0.5 * (low + high)
        below = cdf(value(middle)) < q
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    q = jnp.broadcast_to(q, jnp.broadcast_shapes(q.shape, jnp.shape(loc), jnp.shape(scale)))
    bounds = jnp.full_like(q, -_REACH), jnp.full_like(q, _REACH)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, bounds)
    found = jax.lax.stop_gradient(value(0.5 * (low + high)))
    density = jax.lax.stop_gradient(jax.jvp(cdf, (found,), (jnp.ones_like(found),))[1])
    step = (q - cdf(found)) / jnp.where(density > 0, density, jnp.inf)
    found = found + step - jax.lax.stop_gradient(step)
    found = jnp.where(q > 0, jnp.where(q < 1, found, jnp.inf), -jnp.inf)
    return jnp.where((q >= 0) & (q <= 1), found, jnp.nan)


class GeneralizedNormal(dist.Distribution):
    """Generalized normal (exponential power) distribution.

    f(x) = beta / (2 alpha Gamma(1/beta)) exp(-(abs(x - loc) / alpha)^beta); beta 2 is Gaussian
    with sd alpha / sqrt 2, large beta approaches a uniform on loc +- alpha.

    Parameters
    ----------
    loc, alpha : float or array
        Centre and scale, in the unit of the value.
    beta : float or array
        Shape, positive; a plain even number is fastest.

    References
    ----------
    Nadarajah (2005) A generalized normal distribution. J. Appl. Stat. 32(7): 685-694.
    """

    arg_constraints = {
        "loc": constraints.real,
        "alpha": constraints.positive,
        "beta": constraints.positive,
    }
    support: Any = constraints.real
    reparametrized_params = ["loc", "alpha"]
    pytree_aux_fields = ("_static_beta",)
    loc: Any
    alpha: Any
    beta: Any

    def __init__(self, loc: Any = 0.0, alpha: Any = 1.0, beta: Any = 32.0, *, validate_args=None):
        self._static_beta = float(beta) if isinstance(beta, int | float) else None
        self.loc, self.alpha, self.beta = promote_shapes(loc, alpha, beta)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(alpha), jnp.shape(beta))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    @property
    def _shape_parameter(self):
        return self.beta if self._static_beta is None else self._static_beta

    def log_prob(self, value):
        """Log density; gradients are finite at the centre and far out."""
        z = (value - self.loc) / self.alpha
        norm = jnp.log(self.beta / (2 * self.alpha)) - gammaln(1 / self.beta)
        return norm - power(z, self._shape_parameter, 600.0)

    def sample(self, key: Array, sample_shape=()):
        """Draw by the gamma representation: abs(z)^beta ~ Gamma(1/beta)."""
        key_size, key_sign = jax.random.split(key)
        shape = self.shape(sample_shape)
        # the logarithm, since Gamma(1/32) draws underflow
        log_power = jax.random.loggamma(key_size, jnp.broadcast_to(1 / self.beta, shape))
        sign = jax.random.rademacher(key_sign, shape, dtype=log_power.dtype)
        return self.loc + self.alpha * sign * jnp.exp(log_power / self.beta)

    def cdf(self, value):
        """Distribution function; the lower tail keeps its relative precision."""
        z = (value - self.loc) / self.alpha
        # where the density is flat: there |z|^beta underflows, and gammaincc with it
        flat = jnp.abs(z) < jnp.exp(_LOG_FLAT / self.beta)
        away = jnp.where(flat, 1.0, z)
        upper = gammaincc(1 / self.beta, power(away, self._shape_parameter, 600.0))
        outer = jnp.where(away < 0, 0.5 * upper, 1 - 0.5 * upper)
        height = 0.5 * self.beta * jnp.exp(-gammaln(1 / self.beta))
        return jnp.where(flat, 0.5 + height * z, outer)

    def icdf(self, q):
        """Quantile function, by bisection; differentiable."""
        return quantile(self.cdf, q, self.loc, self.alpha)

    @property
    def mean(self):
        """Mean: loc."""
        return jnp.broadcast_to(self.loc, self.batch_shape)

    @property
    def variance(self):
        """Variance: alpha^2 Gamma(3/beta) / Gamma(1/beta)."""
        ratio = jnp.exp(gammaln(3 / self.beta) - gammaln(1 / self.beta))
        return jnp.broadcast_to(self.alpha**2 * ratio, self.batch_shape)
