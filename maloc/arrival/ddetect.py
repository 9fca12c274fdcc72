"""Direct and reflected arrivals; public as `maloc.arrival.DDetect`."""

from __future__ import annotations

import math
from typing import Any

from jax.scipy.special import ndtr
from jaxtyping import Array
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp
from maloc.arrival.error import ArrivalError
from maloc.arrival.gennorm import GeneralizedNormal, power, quantile

__all__ = ["DDetect"]

# |z|^beta is cut at e^150: its cube still fits a double, and no direct law falls below it
_MAX_LOG_POWER = 150.0
_WILD_SCALE = 10.0  # of the background, in phi
_T3_PEAK = 2 / (math.pi * math.sqrt(3))  # density of Student's t with 3 df at 0


class DDetect(ArrivalError):
    """Direct and reflected arrivals: kaltoa's ddetect as a distribution.

    f(e) = (1 - w) N(e; 0, sigma) + w GN(e; phi/2, phi/2, beta) for e = value - loc: a direct
    arrival is Gaussian, a reflected one is late by up to ``phi``, nearly uniformly. A share
    ``background`` of all arrivals may be anything (Student t, 3 df, centre phi/2, scale 10 phi):
    without it one arrival later than phi breaks a fit.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Standard deviation of direct arrivals, in the unit of the value.
    phi : float or array
        Largest lateness of a reflected arrival, same unit.
    w : float or array
        Probability that an arrival is reflected, in [0, 1].
    beta : float
        Shape of the generalized normal, at least 1; larger is closer to uniform.
    background : float
        Share of wild arrivals, in [0, 1); 0 for kaltoa's ddetect to the letter.

    Raises
    ------
    ValueError
        If ``beta`` or ``background`` is out of its range.

    References
    ----------
    Campbell et al. (2025), and ddetect of the R package kaltoa.
    """

    arg_constraints = {
        "loc": constraints.real,
        "sigma": constraints.positive,
        "phi": constraints.positive,
        "w": constraints.unit_interval,
    }
    reparametrized_params = ["loc", "sigma", "phi"]
    pytree_aux_fields = ("beta", "background")
    sigma: Any
    phi: Any
    w: Any

    def __init__(
        self,
        loc: Any = 0.0,
        sigma: Any = 1.0,
        phi: Any = 100.0,
        w: Any = 0.1,
        beta: float = 32.0,
        background: float = 0.0,
        *,
        validate_args=None,
    ):
        self.beta, self.background = float(beta), float(background)
        if not self.beta >= 1:
            raise ValueError(f"beta {self.beta:g} is below 1")
        if not 0 <= self.background < 1:
            raise ValueError(f"background {self.background:g} is not in [0, 1)")
        self.loc, self.sigma, self.phi, self.w = promote_shapes(loc, sigma, phi, w)
        shape = jax.lax.broadcast_shapes(*(jnp.shape(a) for a in (loc, sigma, phi, w)))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def _weights(self):
        """Height of the direct and of the reflected density, each times its share."""
        keep = 1 - self.background
        height = self.beta / math.gamma(1 / self.beta)
        direct = (1 - self.w) * (keep / math.sqrt(2 * math.pi)) / self.sigma
        return direct, self.w * (keep * height) / self.phi

    def _exponents(self, value):
        """Exponents of the direct and reflected densities."""
        error = value - self.loc
        half = self.phi / 2
        late = (error - half) / half
        return -0.5 * (error / self.sigma) ** 2, -power(late, self.beta, _MAX_LOG_POWER)

    def _wild(self, value):
        """Density of wild arrivals, times their share: rational, so that it never underflows."""
        wide = _WILD_SCALE * self.phi
        t = (value - self.loc - self.phi / 2) / wide
        return self.background * _T3_PEAK / wide / (1 + t**2 / 3) ** 2

    def _densities(self, value):
        """Densities of the three parts: they may be added up because the wild one never vanishes.

        Two exponentials an arrival, and gradients in w that are right at 0 and 1.
        """
        direct, reflected = self._exponents(value)
        direct_height, reflected_height = self._weights()
        parts = direct_height * jnp.exp(direct), reflected_height * jnp.exp(reflected)
        return *parts, self._wild(value)

    def _log_densities(self, value):
        """Logs of the two parts without a background; -inf where w is 0 or 1."""
        return [
            # no part: log 0, with a slope in w of 0 instead of NaN
            exponent + jnp.where(there, jnp.log(jnp.where(there, weight, 1.0)), -jnp.inf)
            for weight, exponent, there in zip(
                self._weights(), self._exponents(value), (self.w < 1, self.w > 0), strict=True
            )
        ]

    def log_prob(self, value):
        """Log density; finite gradients everywhere."""
        if self.background:
            return jnp.log(sum(self._densities(value)))
        return jnp.logaddexp(*self._log_densities(value))

    def _shares(self, value):
        """Probability of each part given the value."""
        if self.background:
            parts = self._densities(value)
            total = sum(parts)
            return [part / total for part in parts]
        direct, reflected = self._log_densities(value)
        p = jax.nn.sigmoid(direct - reflected)
        return [p, jax.nn.sigmoid(reflected - direct)]

    def p_direct(self, value):
        """Posterior probability that each arrival is direct."""
        return self._shares(value)[0]

    def _reflected(self):
        half = self.phi / 2
        return GeneralizedNormal(half, half, self.beta)

    def sample(self, key: Array, sample_shape=()):
        """Draw."""
        key_direct, key_late, key_path, key_wild, key_any = jax.random.split(key, 5)
        shape = self.shape(sample_shape)
        direct = self.sigma * jax.random.normal(key_direct, shape)
        half = jnp.broadcast_to(self.phi / 2, self.batch_shape)
        reflected = GeneralizedNormal(half, half, self.beta).sample(key_late, sample_shape)
        error = jnp.where(jax.random.uniform(key_path, shape) < self.w, reflected, direct)
        if self.background:
            wild = (0.5 + _WILD_SCALE * jax.random.t(key_wild, 3.0, shape)) * self.phi
            error = jnp.where(jax.random.uniform(key_any, shape) < self.background, wild, error)
        return self.loc + error

    def cdf(self, value):
        """Distribution function."""
        error = value - self.loc
        inside = (1 - self.w) * ndtr(error / self.sigma) + self.w * self._reflected().cdf(error)
        if not self.background:
            return inside
        t = (error / self.phi - 0.5) / (_WILD_SCALE * math.sqrt(3))
        wild = 0.5 + (jnp.arctan(t) + t / (1 + t**2)) / math.pi  # Student's t, 3 df
        return (1 - self.background) * inside + self.background * wild

    def icdf(self, q):
        """Quantile function, by bisection; differentiable."""
        return quantile(self.cdf, q, self.loc, self.sigma)

    @property
    def mean(self):
        """Mean: loc plus the share that is late times half of phi."""
        late = (1 - self.background) * self.w + self.background
        return jnp.broadcast_to(self.loc + late * self.phi / 2, self.batch_shape)

    @property
    def variance(self):
        """Variance of the mixture."""
        middle = (self.phi / 2) ** 2
        late = (1 - self.background) * self.w
        direct = (1 - self.background) * (1 - self.w)
        second = direct * self.sigma**2 + late * (self._reflected().variance + middle)
        second = second + self.background * (middle + 3 * (_WILD_SCALE * self.phi) ** 2)
        return jnp.broadcast_to(second - (late + self.background) ** 2 * middle, self.batch_shape)

    def widened(self, scale) -> DDetect:
        """The same law with a direct standard deviation of at least ``scale``."""
        sigma = jnp.maximum(self.sigma, scale)
        return DDetect(self.loc, sigma, self.phi, self.w, self.beta, self.background)

    def direct_curvature(self, value):
        """P / sigma^2, p the probability of the direct path."""
        return self.p_direct(value) / self.sigma**2

    def _reflected_derivatives(self, value):
        """Slope and second derivative (<= 0) of the reflected part's log density."""
        half = self.phi / 2
        # beyond |z| = 3 the share is 0, and the wall would overflow
        z = jnp.clip((value - self.loc - half) / half, -3.0, 3.0)
        if self.beta == 1:
            return -jnp.sign(z) / half, jnp.zeros_like(z)
        flat = power(z, self.beta - 2, _MAX_LOG_POWER)
        return -self.beta * flat * z / half, -self.beta * (self.beta - 1) * flat / half**2

    def robust_curvature(self, value):
        """Sum over the parts of probability times curvature: EM's surrogate.

        The reflected part is flat inside and a wall at its ends; the wild part is all but flat.
        """
        shares = self._shares(value)
        _, wall = self._reflected_derivatives(value)
        total = shares[0] / self.sigma**2 - shares[1] * wall
        if not self.background:
            return total
        wide = _WILD_SCALE * self.phi
        t = (value - self.loc - self.phi / 2) / wide
        return total + shares[2] * 4 / (3 + t**2) / wide**2

    def _second(self, value):
        """Second derivative of ``log_prob``: mean of the parts' plus the variance of the slopes."""
        shares = self._shares(value)
        error = value - self.loc
        slope, wall = self._reflected_derivatives(value)
        slopes, seconds = [-error / self.sigma**2, slope], [-1 / self.sigma**2, wall]
        if self.background:
            wide = _WILD_SCALE * self.phi
            t = (error - self.phi / 2) / wide
            slopes.append(-4 * t / (3 + t**2) / wide)
            seconds.append(-4 * (3 - t**2) / (3 + t**2) ** 2 / wide**2)
        mean = sum(p * g for p, g in zip(shares, slopes, strict=True))
        spread = sum(p * (g - mean) ** 2 for p, g in zip(shares, slopes, strict=True))
        return spread + sum(p * s for p, s in zip(shares, seconds, strict=True))
