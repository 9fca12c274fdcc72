"""How arrival times err: densities of the arrival's residual around the predicted arrival.

All are location families over ranges (metres: speed of sound x seconds) or seconds, as the caller
likes, as long as ``value``, ``loc`` and scales share the unit. Each is an `ArrivalError`, which
knows more than a plain distribution does: that makes the engine robust without knowing any fish.
A law of a user's own is one subclass away.

References
----------
Campbell, Shry, Lundberg, Calles & Holker (2025) A population Monte Carlo model for underwater
acoustic telemetry positioning in reflective environments. Methods Ecol. Evol. 16(4): 775-785.
"""

from __future__ import annotations

import math
from typing import Any

from jax.scipy.special import betainc, gammaln, ndtr, ndtri
from jaxtyping import Array
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp
from maloc.arrival.ddetect import DDetect
from maloc.arrival.error import ArrivalError
from maloc.arrival.gaussian_student import GaussianStudent
from maloc.arrival.gennorm import GeneralizedNormal, quantile
from maloc.arrival.multipath import Multipath

__all__ = [
    "ArrivalError",
    "DDetect",
    "Gaussian",
    "GaussianStudent",
    "GeneralizedNormal",
    "Multipath",
    "Student",
]

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class Gaussian(ArrivalError):
    """Gaussian arrival error.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Standard deviation, in the unit of the value.
    """

    arg_constraints = {"loc": constraints.real, "sigma": constraints.positive}
    reparametrized_params = ["loc", "sigma"]
    sigma: Any

    def __init__(self, loc: Any = 0.0, sigma: Any = 1.0, *, validate_args=None):
        self.loc, self.sigma = promote_shapes(loc, sigma)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(sigma))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log density."""
        z = (value - self.loc) / self.sigma
        return -0.5 * z**2 - jnp.log(self.sigma) - _HALF_LOG_2PI

    def sample(self, key: Array, sample_shape=()):
        """Draw."""
        return self.loc + self.sigma * jax.random.normal(key, self.shape(sample_shape))

    def cdf(self, value):
        """Distribution function."""
        return ndtr((value - self.loc) / self.sigma)

    def icdf(self, q):
        """Quantile function."""
        return self.loc + self.sigma * ndtri(q)

    @property
    def variance(self):
        """Variance."""
        return jnp.broadcast_to(self.sigma**2, self.batch_shape)

    def widened(self, scale) -> Gaussian:
        """The same law with a standard deviation of at least ``scale``."""
        return Gaussian(self.loc, jnp.maximum(self.sigma, scale))

    def direct_curvature(self, value):
        """1 / sigma^2."""
        shape = jnp.broadcast_shapes(jnp.shape(value), self.batch_shape)
        return jnp.broadcast_to(1 / self.sigma**2, shape)

    def curvature(self, value, floor=0.1):
        """1 / sigma^2, exactly."""
        return self.direct_curvature(value)


class Student(ArrivalError):
    """Student t arrival error: symmetric heavy tails, no reflections of their own.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Scale, in the unit of the value.
    df : float or array
        Degrees of freedom (3 as in YAPS).

    References
    ----------
    Baktoft, Gjelland, Okland & Thygesen (2017) Positioning of aquatic animals based on
    time-of-arrival and random walk models using YAPS. Sci. Rep. 7: 14294.
    """

    arg_constraints = {
        "loc": constraints.real,
        "sigma": constraints.positive,
        "df": constraints.positive,
    }
    reparametrized_params = ["loc", "sigma", "df"]
    sigma: Any
    df: Any

    def __init__(self, loc: Any = 0.0, sigma: Any = 1.0, df: Any = 3.0, *, validate_args=None):
        self.loc, self.sigma, self.df = promote_shapes(loc, sigma, df)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(sigma), jnp.shape(df))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log density."""
        z2 = ((value - self.loc) / self.sigma) ** 2
        tails = (self.df + 1) / 2 * jnp.log1p(z2 / self.df)
        return self._log_peak() - jnp.log(self.sigma) - tails

    def _log_peak(self):
        """Log density of the standard law at 0."""
        df = self.df
        return gammaln((df + 1) / 2) - gammaln(df / 2) - 0.5 * jnp.log(df * jnp.pi)

    def sample(self, key: Array, sample_shape=()):
        """Draw."""
        return self.loc + self.sigma * jax.random.t(key, self.df, self.shape(sample_shape))

    def cdf(self, value):
        """Distribution function; the lower tail keeps its relative precision."""
        z = (value - self.loc) / self.sigma
        near = jnp.abs(z) < 1e-6  # two terms of the series, where betainc has no slope
        away = jnp.where(near, 1.0, z)
        tail = 0.5 * betainc(self.df / 2, 0.5, self.df / (self.df + away**2))
        height = jnp.exp(self._log_peak())
        series = 0.5 + height * z * (1 - z**2 * (self.df + 1) / (6 * self.df))
        return jnp.where(near, series, jnp.where(away < 0, tail, 1 - tail))

    def icdf(self, q):
        """Quantile function, by bisection; differentiable."""
        return quantile(self.cdf, q, self.loc, self.sigma)

    @property
    def mean(self):
        """Mean; NaN for df <= 1, where there is none."""
        return jnp.broadcast_to(jnp.where(self.df > 1, self.loc, jnp.nan), self.batch_shape)

    @property
    def variance(self):
        """Variance; infinite for df <= 2, NaN for df <= 1."""
        heavy = self.df <= 2
        factor = self.df / jnp.where(heavy, 1.0, self.df - 2)
        factor = jnp.where(heavy, jnp.where(self.df <= 1, jnp.nan, jnp.inf), factor)
        return jnp.broadcast_to(self.sigma**2 * factor, self.batch_shape)

    def widened(self, scale) -> Student:
        """The same law with a scale of at least ``scale``."""
        return Student(self.loc, jnp.maximum(self.sigma, scale), self.df)

    def direct_curvature(self, value):
        """Weight of iteratively reweighted least squares: it majorises ``-log_prob`` globally."""
        z2 = ((value - self.loc) / self.sigma) ** 2
        return (self.df + 1) / (self.df + z2) / self.sigma**2
