"""How arrival times err: densities of the arrival's residual around the predicted arrival.

All are location families over ranges (metres: speed of sound x seconds) or seconds, as the caller
likes, as long as ``value``, ``loc`` and scales share the unit. Each knows more than a plain
distribution does, which is what makes the engine robust without knowing any fish:

``p_direct(value)``
    probability that the arrival came by the direct path;
``widened(scale)``
    the same law with a direct sd of at least ``scale`` (for annealing);
``curvature(value, floor)``
    a non-negative curvature of ``-log_prob`` along the residual (for Gauss-Newton steps).

References
----------
Campbell, Shry, Lundberg, Calles & Holker (2025) A population Monte Carlo model for underwater
acoustic telemetry positioning in reflective environments. Methods Ecol. Evol. 16(4): 775-785.
"""

from __future__ import annotations

import math

import numpyro.distributions as dist
from jax.scipy.special import gammainc, gammaln
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp

__all__ = ["DDetect", "Gaussian", "GeneralizedNormal", "Student"]

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
_T3_PEAK = 2 / (math.pi * math.sqrt(3))  # density of Student's t with 3 df at 0
_MAX_LOG_POWER = 45.0  # |z|^beta is cut at e^45: far beyond any density that matters, no overflow


def _power(z, beta):
    """|z|^beta with finite value and gradient everywhere; fast where beta is an even integer."""
    if isinstance(beta, (int, float)) and float(beta).is_integer() and int(beta) % 2 == 0:
        limit = math.exp(_MAX_LOG_POWER / beta)
        return jnp.clip(z, -limit, limit) ** int(beta)
    size = jnp.abs(z)
    nonzero = size > 0
    log_size = jnp.log(jnp.where(nonzero, size, 1.0))
    return jnp.where(nonzero, jnp.exp(jnp.minimum(beta * log_size, _MAX_LOG_POWER)), 0.0)


class GeneralizedNormal(dist.Distribution):
    """Generalized normal (exponential power) distribution.

    f(x) = beta / (2 alpha Gamma(1/beta)) exp(-(|x - loc| / alpha)^beta); beta 2 is Gaussian with
    sd alpha / sqrt 2, large beta approaches a uniform on loc +- alpha.

    Parameters
    ----------
    loc, alpha : float or array
        Centre and scale, in the unit of the value.
    beta : float
        Shape, positive.

    References
    ----------
    Nadarajah (2005) A generalized normal distribution. J. Appl. Stat. 32(7): 685-694.
    """

    arg_constraints = {
        "loc": constraints.real,
        "alpha": constraints.positive,
        "beta": constraints.positive,
    }
    support = constraints.real
    reparametrized_params = ["loc", "alpha"]
    pytree_aux_fields = ("_even",)

    def __init__(self, loc=0.0, alpha=1.0, beta=32.0, *, validate_args=None):
        self._even = beta if isinstance(beta, (int, float)) else None
        self.loc, self.alpha, self.beta = promote_shapes(loc, alpha, beta)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(alpha), jnp.shape(beta))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log density; gradients are finite at the centre and far out."""
        z = (value - self.loc) / self.alpha
        shape = self.beta if self._even is None else self._even
        norm = jnp.log(self.beta / (2 * self.alpha)) - gammaln(1 / self.beta)
        return norm - _power(z, shape)

    def sample(self, key, sample_shape=()):
        """Draw by the gamma representation |z|^beta ~ Gamma(1/beta)."""
        key_size, key_sign = jax.random.split(key)
        shape = self.shape(sample_shape)
        size = jax.random.gamma(key_size, 1 / jnp.broadcast_to(self.beta, shape)) ** (1 / self.beta)
        sign = jax.random.rademacher(key_sign, shape, dtype=size.dtype)
        return self.loc + self.alpha * sign * size

    def cdf(self, value):
        """Distribution function."""
        z = (value - self.loc) / self.alpha
        inside = gammainc(1 / self.beta, jnp.abs(z) ** self.beta)
        return 0.5 + 0.5 * jnp.sign(z) * inside

    @property
    def mean(self):
        """Mean: loc."""
        return jnp.broadcast_to(self.loc, self.batch_shape)

    @property
    def variance(self):
        """Variance: alpha^2 Gamma(3/beta) / Gamma(1/beta)."""
        ratio = jnp.exp(gammaln(3 / self.beta) - gammaln(1 / self.beta))
        return jnp.broadcast_to(self.alpha**2 * ratio, self.batch_shape)


class _ArrivalError(dist.Distribution):
    """What the engine asks of an arrival-time error beyond a distribution (module docstring)."""

    support = constraints.real

    def p_direct(self, value):
        """Posterior probability that the arrival came by the direct path: 1 here."""
        return jnp.ones(jnp.broadcast_shapes(jnp.shape(value), self.batch_shape))

    def curvature(self, value, floor=0.1):
        """Non-negative curvature of ``-log_prob`` in the residual, shape of the broadcast value.

        The exact second derivative where it is positive, else ``floor`` times the direct law's.
        """
        raise NotImplementedError

    def robust_curvature(self, value):
        """Curvature of the majorising quadratic (iteratively reweighted least squares)."""
        return self.curvature(value)

    @property
    def mean(self):
        """Mean."""
        return jnp.broadcast_to(self.loc, self.batch_shape)


class Gaussian(_ArrivalError):
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

    def __init__(self, loc=0.0, sigma=1.0, *, validate_args=None):
        self.loc, self.sigma = promote_shapes(loc, sigma)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(sigma))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log density."""
        z = (value - self.loc) / self.sigma
        return -0.5 * z**2 - jnp.log(self.sigma) - _HALF_LOG_2PI

    def sample(self, key, sample_shape=()):
        """Draw."""
        return self.loc + self.sigma * jax.random.normal(key, self.shape(sample_shape))

    def cdf(self, value):
        """Distribution function."""
        return jax.scipy.special.ndtr((value - self.loc) / self.sigma)

    def icdf(self, q):
        """Quantile function."""
        return self.loc + self.sigma * jax.scipy.special.ndtri(q)

    @property
    def variance(self):
        """Variance."""
        return jnp.broadcast_to(self.sigma**2, self.batch_shape)

    def widened(self, scale):
        """The same law with a standard deviation of at least ``scale``."""
        return Gaussian(self.loc, jnp.maximum(self.sigma, scale))

    def curvature(self, value, floor=0.1):
        """Exact curvature, 1 / sigma^2."""
        return jnp.broadcast_to(self.sigma**-2, jnp.broadcast_shapes(jnp.shape(value)))


class Student(_ArrivalError):
    """Student t arrival error: symmetric heavy tails, no reflections of their own.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Scale, in the unit of the value.
    df : float
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
    reparametrized_params = ["loc", "sigma"]

    def __init__(self, loc=0.0, sigma=1.0, df=3.0, *, validate_args=None):
        self.loc, self.sigma, self.df = promote_shapes(loc, sigma, df)
        shape = jax.lax.broadcast_shapes(jnp.shape(loc), jnp.shape(sigma), jnp.shape(df))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log density."""
        z2 = ((value - self.loc) / self.sigma) ** 2
        norm = gammaln((self.df + 1) / 2) - gammaln(self.df / 2) - 0.5 * jnp.log(self.df * jnp.pi)
        return norm - jnp.log(self.sigma) - (self.df + 1) / 2 * jnp.log1p(z2 / self.df)

    def sample(self, key, sample_shape=()):
        """Draw."""
        return self.loc + self.sigma * jax.random.t(key, self.df, self.shape(sample_shape))

    def cdf(self, value):
        """Distribution function."""
        return dist.StudentT(self.df, self.loc, self.sigma).cdf(value)

    def icdf(self, q):
        """Quantile function."""
        return dist.StudentT(self.df, self.loc, self.sigma).icdf(q)

    @property
    def variance(self):
        """Variance; infinite for df <= 2."""
        df = self.df
        factor = jnp.where(df > 2, df / jnp.where(df > 2, df - 2, 1.0), jnp.inf)
        return jnp.broadcast_to(self.sigma**2 * factor, self.batch_shape)

    def widened(self, scale):
        """The same law with a scale of at least ``scale``."""
        return Student(self.loc, jnp.maximum(self.sigma, scale), self.df)

    def curvature(self, value, floor=0.1):
        """Exact curvature where positive, else ``floor`` times the weight of the t law."""
        z2 = ((value - self.loc) / self.sigma) ** 2 / self.df
        weight = (self.df + 1) / self.df / self.sigma**2 / (1 + z2)
        return jnp.maximum(weight * (1 - z2) / (1 + z2), floor * weight)

    def robust_curvature(self, value):
        """Weight of iteratively reweighted least squares."""
        z2 = ((value - self.loc) / self.sigma) ** 2 / self.df
        return (self.df + 1) / self.df / self.sigma**2 / (1 + z2)


class DDetect(_ArrivalError):
    """Direct and reflected arrivals: kaltoa's ddetect as a distribution.

    f(e) = (1 - w) N(e; 0, sigma) + w GN(e; phi/2, phi/2, beta) for e = value - loc: a direct
    arrival is Gaussian, a reflected one is late by up to ``phi``, nearly uniformly. A share
    ``background`` of all arrivals may be anything (Student t, 3 df, centre phi/2, scale 10 phi): without it
    one arrival later
    than phi breaks a fit.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Standard deviation of direct arrivals, in the unit of the value.
    phi : float or array
        Largest lateness of a reflected arrival, same unit.
    w : float or array
        Probability that an arrival is reflected, in (0, 1).
    beta : float
        Shape of the generalized normal; larger is closer to uniform.
    background : float
        Share of wild arrivals, 0 for kaltoa's ddetect to the letter.

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

    def __init__(
        self, loc=0.0, sigma=1.0, phi=100.0, w=0.1, beta=32.0, background=0.0, *, validate_args=None
    ):
        self.beta, self.background = float(beta), float(background)
        self.loc, self.sigma, self.phi, self.w = promote_shapes(loc, sigma, phi, w)
        shape = jax.lax.broadcast_shapes(*(jnp.shape(a) for a in (loc, sigma, phi, w)))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def _log_norms(self):
        """Log weights over scales of the direct, reflected and wild densities."""
        keep = math.log1p(-self.background)
        shape = math.log(self.beta) - math.lgamma(1 / self.beta)
        direct = jnp.log1p(-self.w) + keep - jnp.log(self.sigma) - _HALF_LOG_2PI
        reflected = jnp.log(self.w) + keep + shape - jnp.log(self.phi)
        return direct, reflected

    def _exponents(self, value):
        """Exponents of the direct and reflected densities."""
        error = value - self.loc
        half = self.phi / 2
        return -0.5 * (error / self.sigma) ** 2, -_power((error - half) / half, self.beta)

    def _wild(self, value):
        """Density of wild arrivals: Student t, 3 df, scale 10 phi (rational: no underflow)."""
        t = (value - self.loc - self.phi / 2) / (10 * self.phi)
        return self.background * _T3_PEAK / (10 * self.phi) / (1 + t**2 / 3) ** 2

    def _parts(self, value):
        """Densities of the parts; safe to add up because the wild one never vanishes."""
        direct_norm, reflected_norm = self._log_norms()
        direct, reflected = self._exponents(value)
        parts = jnp.exp(direct_norm) * jnp.exp(direct), jnp.exp(reflected_norm) * jnp.exp(reflected)
        return *parts, self._wild(value)

    def log_prob(self, value):
        """Log density; gradients finite everywhere."""
        if self.background:
            direct, reflected, wild = self._parts(value)
            return jnp.log(direct + reflected + wild)
        direct_norm, reflected_norm = self._log_norms()
        direct, reflected = self._exponents(value)
        return jnp.logaddexp(direct_norm + direct, reflected_norm + reflected)

    def p_direct(self, value):
        """Posterior probability that each arrival is direct."""
        if self.background:
            direct, reflected, wild = self._parts(value)
            return direct / (direct + reflected + wild)
        direct_norm, reflected_norm = self._log_norms()
        direct, reflected = self._exponents(value)
        return jax.nn.sigmoid(direct_norm + direct - reflected_norm - reflected)

    def sample(self, key, sample_shape=()):
        """Draw."""
        keys = jax.random.split(key, 5)
        shape = self.shape(sample_shape)
        half = self.phi / 2
        direct = self.sigma * jax.random.normal(keys[0], shape)
        reflected = GeneralizedNormal(half, half, self.beta).expand(self.batch_shape)
        reflected = reflected.sample(keys[1], sample_shape)
        wild = half + 10 * self.phi * jax.random.t(keys[4], 3.0, shape)
        error = jnp.where(jax.random.uniform(keys[2], shape) < self.w, reflected, direct)
        error = jnp.where(jax.random.uniform(keys[3], shape) < self.background, wild, error)
        return self.loc + error

    def cdf(self, value):
        """Distribution function."""
        error = value - self.loc
        half = self.phi / 2
        inside = (1 - self.w) * jax.scipy.special.ndtr(error / self.sigma)
        inside = inside + self.w * GeneralizedNormal(half, half, self.beta).cdf(error)
        wild = dist.StudentT(3.0, half, 10 * self.phi).cdf(error)
        return (1 - self.background) * inside + self.background * wild

    def icdf(self, q):
        """Quantile function, by bisection of the distribution function (80 halvings)."""
        half = self.phi / 2
        reach = 40 * jnp.maximum(self.sigma, 10 * self.phi if self.background else half)
        q = jnp.broadcast_to(q, jnp.broadcast_shapes(jnp.shape(q), self.batch_shape))
        low = jnp.broadcast_to(self.loc - reach, q.shape)
        high = jnp.broadcast_to(self.loc + 2 * half + reach, q.shape)

        def halve(_, bounds):
            low, high = bounds
            middle = 0.5 * (low + high)
            below = self.cdf(middle) < q
            return jnp.where(below, middle, low), jnp.where(below, high, middle)

        low, high = jax.lax.fori_loop(0, 80, halve, (low, high))
        return 0.5 * (low + high)

    @property
    def mean(self):
        """Mean: loc plus the share that is late times half of phi."""
        late = (1 - self.background) * self.w + self.background
        return jnp.broadcast_to(self.loc + late * self.phi / 2, self.batch_shape)

    @property
    def variance(self):
        """Variance of the mixture."""
        half = self.phi / 2
        reflected = GeneralizedNormal(half, half, self.beta).variance + half**2
        wild = half**2 + 3 * (10 * self.phi) ** 2
        keep = 1 - self.background
        second = keep * ((1 - self.w) * self.sigma**2 + self.w * reflected) + self.background * wild
        return jnp.broadcast_to(second - (self.mean - self.loc) ** 2, self.batch_shape)

    def widened(self, scale):
        """The same law with a direct standard deviation of at least ``scale``."""
        sigma = jnp.maximum(self.sigma, scale)
        return DDetect(self.loc, sigma, self.phi, self.w, self.beta, self.background)

    def _late_curvature(self, value):
        """Curvature of the reflected part alone, >= 0."""
        half = self.phi / 2
        z = jnp.clip((value - self.loc - half) / half, -2.0, 2.0)
        return self.beta * (self.beta - 1) * jnp.abs(z) ** (self.beta - 2) / half**2

    def robust_curvature(self, value):
        """p/sigma^2 + (1 - p) (-g'')+, p the probability of the direct path."""
        p = self.p_direct(value)
        late = jnp.where(p < 1 - 1e-12, (1 - p) * self._late_curvature(value), 0.0)
        return p / self.sigma**2 + late

    def curvature(self, value, floor=0.1):
        """Exact curvature where larger than ``floor`` p / sigma^2, else that."""
        error = value - self.loc
        p = self.p_direct(value)
        slope = -error / self.sigma**2
        half = self.phi / 2
        z = jnp.clip((error - half) / half, -2.0, 2.0)
        late_slope = -self.beta * jnp.abs(z) ** (self.beta - 1) * jnp.sign(z) / half
        if self.background:
            _, reflected, wild = self._parts(value)
            share = reflected / (reflected + wild)
            late_curv = -share * self._late_curvature(value) + share * (1 - share) * late_slope**2
            late_slope = share * late_slope
        else:
            late_curv = -self._late_curvature(value)
        q = jnp.where(p < 1 - 1e-12, 1 - p, 0.0)
        second = -p / self.sigma**2 + q * late_curv + p * q * (slope - late_slope) ** 2
        return jnp.maximum(-second, floor * p / self.sigma**2)
