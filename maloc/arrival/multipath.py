"""Direct, late and wild arrivals in water; public as `maloc.arrival.Multipath`."""

from __future__ import annotations

import math
from typing import Any

from jax.scipy.special import betainc, digamma, gammaln, polygamma
from jaxtyping import Array
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp
from maloc.arrival.error import ArrivalError
from maloc.arrival.gennorm import GeneralizedNormal, power, quantile

__all__ = ["Multipath"]

_MAX_LOG_POWER = 150.0
_EDGE = 0.55  # of sigma: the logistic curve nearest to the normal one
_LEAST = 2.0  # sigma; a lateness that decays faster is an error of the direct path
_WILD = 0.2  # of phi: scale of wild arrivals
_LOST = 25.0  # edges
_T3_PEAK = 2 / (math.pi * math.sqrt(3))  # density of Student's t with 3 df at 0


class Multipath(ArrivalError):
    """Arrivals by the direct path, by reflections, and wild ones, early or late.

    With e = value - loc, the density is

    (1 - wild) [(1 - w) t(e; df, sigma) + w (near E(e) + (1 - near) GN(e))] + wild t(e; 3, phi/5).

    E: late by a decaying law, exp(-e/l) / (1 + exp(-e/s)) up to its integral pi s / sin(pi s/l),
    s = .55 sigma, l^2 = scale^2 + 4 sigma^2. GN: late by anything up to ``phi``, ddetect's
    generalized normal.

    Parameters
    ----------
    loc : array
        Predicted arrival.
    sigma : float or array
        Scale of direct arrivals, in the unit of the value.
    df : float or array
        Degrees of freedom of their Student t.
    w : float or array
        Share of reflected arrivals, in [0, 1].
    near : float or array
        Share of the reflected whose lateness decays, in [0, 1].
    scale : float or array
        Scale of that lateness, in the unit of the value.
    wild : float or array
        Share of wild arrivals, above 0 and below 1.
    phi : float or array
        Largest lateness, in the unit of the value.
    beta : float
        Shape of the generalized normal, at least 1.

    Raises
    ------
    ValueError
        If ``beta`` is below 1.

    References
    ----------
    The late part up to ``phi``: Campbell et al. (2025). The decaying one: a logistic edge in place
    of the normal one of an exponentially modified Gaussian; e/s is the logit of a Beta(1 - s/l,
    s/l).
    """

    arg_constraints = {
        "loc": constraints.real,
        "sigma": constraints.positive,
        "df": constraints.positive,
        "w": constraints.unit_interval,
        "near": constraints.unit_interval,
        "scale": constraints.positive,
        "wild": constraints.unit_interval,
        "phi": constraints.positive,
    }
    reparametrized_params = ["loc", "sigma", "scale", "phi"]
    pytree_aux_fields = ("beta",)
    sigma: Any
    df: Any
    w: Any
    near: Any
    scale: Any
    wild: Any
    phi: Any

    def __init__(
        self,
        loc: Any = 0.0,
        sigma: Any = 1.0,
        df: Any = 100.0,
        w: Any = 0.1,
        near: Any = 0.7,
        scale: Any = 10.0,
        wild: Any = 2e-3,
        phi: Any = 100.0,
        beta: float = 32.0,
        *,
        validate_args=None,
    ):
        self.beta = float(beta)
        if not self.beta >= 1:
            raise ValueError(f"beta {self.beta:g} is below 1")
        given = (loc, sigma, df, w, near, scale, wild, phi)
        names = ("loc", "sigma", "df", "w", "near", "scale", "wild", "phi")
        for name, value in zip(names, promote_shapes(*given), strict=True):
            setattr(self, name, value)
        shape = jax.lax.broadcast_shapes(*(jnp.shape(a) for a in given))
        super().__init__(batch_shape=shape, validate_args=validate_args)

    def _edge(self):
        """Width of the decaying part's edge, and its length."""
        return _EDGE * self.sigma, jnp.sqrt(self.scale**2 + (_LEAST * self.sigma) ** 2)

    def _densities(self, value):
        """Densities of the four parts, each times its share; the wild one never vanishes."""
        e, keep = value - self.loc, 1 - self.wild
        df, late = self.df, keep * self.w
        peak = jnp.exp(gammaln((df + 1) / 2) - gammaln(df / 2)) / jnp.sqrt(df * jnp.pi)
        z2 = (e / self.sigma) ** 2
        direct = keep * (1 - self.w) * peak / self.sigma
        direct = direct * jnp.exp(-(df + 1) / 2 * jnp.log1p(z2 / df))
        edge, length = self._edge()
        # of early arrivals exp(-e/l) would overflow before the edge is felt
        near = jnp.exp(-e / length - jax.nn.softplus(-e / edge))
        near = late * self.near * near * jnp.sin(jnp.pi * edge / length) / (jnp.pi * edge)
        half = self.phi / 2
        height = self.beta / math.gamma(1 / self.beta) / self.phi
        far = late * (1 - self.near) * height
        far = far * jnp.exp(-power((e - half) / half, self.beta, _MAX_LOG_POWER))
        wide = _WILD * self.phi
        wild = self.wild * _T3_PEAK / wide / (1 + (e / wide) ** 2 / 3) ** 2
        return direct, near, far, wild

    def log_prob(self, value):
        """Log density; finite gradients everywhere."""
        return jnp.log(sum(self._densities(value)))

    def _shares(self, value):
        """Probability of each part given the value."""
        parts = self._densities(value)
        total = sum(parts)
        return [part / total for part in parts]

    def p_direct(self, value):
        """Posterior probability that each arrival is direct."""
        return self._shares(value)[0]

    def _derivatives(self, value):
        """Slope and second derivative of each part's log density."""
        e, half, wide = value - self.loc, self.phi / 2, _WILD * self.phi
        edge, length = self._edge()
        size = self.df * self.sigma**2 + e**2
        far = 3 * wide**2 + e**2
        after = jax.nn.sigmoid(e / edge)
        # beyond |z| = 3 the share is 0, and the wall would overflow
        z = jnp.clip((e - half) / half, -3.0, 3.0)
        if self.beta == 1:
            wall = -jnp.sign(z) / half, jnp.zeros_like(z)
        else:
            flat = self.beta * power(z, self.beta - 2, _MAX_LOG_POWER) / half
            wall = -flat * z, -(self.beta - 1) * flat / half
        return (
            (-(self.df + 1) * e / size, -(self.df + 1) * (size - 2 * e**2) / size**2),
            ((1 - after) / edge - 1 / length, -after * (1 - after) / edge**2),
            wall,
            (-4 * e / far, -4 * (far - 2 * e**2) / far**2),
        )

    def _second(self, value):
        """Second derivative of ``log_prob``: mean of the parts' plus the variance of the slopes."""
        shares, parts = self._shares(value), self._derivatives(value)
        mean = sum(p * g for p, (g, _) in zip(shares, parts, strict=True))
        return sum(p * (s + (g - mean) ** 2) for p, (g, s) in zip(shares, parts, strict=True))

    def _weights(self, value):
        """Weights of the direct and of the wild part in reweighted least squares."""
        e2, wide = (value - self.loc) ** 2, _WILD * self.phi
        return (self.df + 1) / (self.df * self.sigma**2 + e2), 4 / (3 * wide**2 + e2)

    def direct_curvature(self, value):
        """Probability of the direct path times the weight of its Student t."""
        return self.p_direct(value) * self._weights(value)[0]

    def robust_curvature(self, value):
        """Sum over the parts of probability times curvature: EM's surrogate."""
        shares, parts = self._shares(value), self._derivatives(value)
        direct, wild = self._weights(value)
        late = -shares[1] * parts[1][1] - shares[2] * parts[2][1]
        return shares[0] * direct + late + shares[3] * wild

    def widened(self, scale) -> Multipath:
        """The same law with a direct scale of at least ``scale``."""
        sigma, rest = jnp.maximum(self.sigma, scale), (self.w, self.near, self.scale, self.wild)
        return Multipath(self.loc, sigma, self.df, *rest, self.phi, self.beta)

    def sample(self, key: Array, sample_shape=()):
        """Draw."""
        keys, shape = jax.random.split(key, 7), self.shape(sample_shape)
        edge, length = self._edge()
        ratio = jnp.broadcast_to(edge / length, shape)
        direct = self.sigma * jax.random.t(keys[0], jnp.broadcast_to(self.df, shape))
        early, after = jax.random.split(keys[1])  # logs: a beta near 1 would lose the tail
        near = jax.random.loggamma(early, 1 - ratio) - jax.random.loggamma(after, ratio)
        near = edge * near
        far = self._far().sample(keys[2], sample_shape)
        late = jnp.where(jax.random.uniform(keys[3], shape) < self.near, near, far)
        error = jnp.where(jax.random.uniform(keys[4], shape) < self.w, late, direct)
        wild = _WILD * self.phi * jax.random.t(keys[5], 3.0, shape)
        return self.loc + jnp.where(jax.random.uniform(keys[6], shape) < self.wild, wild, error)

    def _far(self):
        half = jnp.broadcast_to(self.phi / 2, self.batch_shape)
        return GeneralizedNormal(half, half, self.beta)

    def cdf(self, value):
        """Distribution function."""
        e = value - self.loc
        edge, length = self._edge()
        near = _near_cdf(e / edge, edge / length)
        late = self.near * near + (1 - self.near) * self._far().cdf(e)
        direct = _t_cdf(e / self.sigma, self.df)
        inside = (1 - self.w) * direct + self.w * late
        return (1 - self.wild) * inside + self.wild * _t_cdf(e / (_WILD * self.phi), 3.0)

    def _parts(self):
        """Share, mean and variance of each part's error."""
        edge, length = self._edge()
        a, keep = edge / length, 1 - self.wild
        near = edge * (digamma(1 - a) - digamma(a))
        spread = edge**2 * (polygamma(1, 1 - a) + polygamma(1, a))
        heavy = self.df <= 2
        own = self.sigma**2 * self.df / jnp.where(heavy, 1.0, self.df - 2)
        half, wide = self.phi / 2, 3 * (_WILD * self.phi) ** 2
        return (
            (keep * (1 - self.w), 0.0, jnp.where(heavy, jnp.inf, own)),
            (keep * self.w * self.near, near, spread),
            (keep * self.w * (1 - self.near), half, self._far().variance),
            (self.wild, 0.0, wide),
        )

    @property
    def mean(self):
        """Mean."""
        late = sum(share * mean for share, mean, _ in self._parts())
        return jnp.broadcast_to(self.loc + late, self.batch_shape)

    @property
    def variance(self):
        """Variance of the mixture; infinite for df <= 2."""
        parts = self._parts()
        middle = sum(share * mean for share, mean, _ in parts)
        each = sum(share * (spread + (mean - middle) ** 2) for share, mean, spread in parts)
        return jnp.broadcast_to(each, self.batch_shape)

    def icdf(self, q):
        """Quantile function, by bisection; differentiable."""
        return quantile(self.cdf, q, self.loc, self.sigma)


def _near_cdf(z, a):
    """Distribution function of the logit of a Beta(1 - a, a).

    Beyond the edge it is an exponential on either side, in which the beta's argument is lost.
    """
    inside = abs(z) < _LOST
    middle = betainc(1 - a, a, jax.nn.sigmoid(jnp.where(inside, z, 0.0)))
    peak = jnp.sin(jnp.pi * a) / jnp.pi
    below = peak / (1 - a) * jnp.exp(jnp.minimum(z, -_LOST) * (1 - a))
    above = 1 - peak / a * jnp.exp(-jnp.maximum(z, _LOST) * a)
    return jnp.where(inside, middle, jnp.where(z < 0, below, above))


def _t_cdf(z, df):
    """Distribution function of Student's t."""
    df = jnp.broadcast_to(df, jnp.shape(z))
    tail = 0.5 * betainc(df / 2, jnp.full_like(df, 0.5), df / (df + z**2))
    return jnp.where(z < 0, tail, 1 - tail)
