"""How animals move: Gauss-Markov path distributions over the states at the pings.

Convention: time is axis 0 and always there; element ``t`` of ``dt`` is the time from state ``t`` to
state ``t + 1``, so a path of ``T`` states takes ``T - 1`` steps. Axes (x, y) are independent.

References
----------
Johnson, London, Lea & Durban (2008) Continuous-time correlated random walk model for animal
telemetry data. Ecology 89(5): 1208-1215.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp

__all__ = ["CTCRW", "Brownian", "Transition", "ctcrw_beta", "ctcrw_transition"]

_SERIES_BELOW = 0.3
# 2x - 3 + 4 e^-x - e^-2x = sum_n (-1)^n (4 - 2^n) x^n / n!, n >= 3
_SERIES = [(-1.0) ** n * (4 - 2.0**n) / math.factorial(n) for n in range(3, 19)]


class Transition(NamedTuple):
    """One axis of a CTCRW step: state (position, velocity) is taken to ``A state + N(0, Q)``.

    ``a12`` (s) and ``a22`` are the free elements of A = [[1, a12], [0, a22]]; ``q11`` (m2), ``q12``
    (m2/s) and ``q22`` (m2/s2) those of Q. All share the shape of ``dt``.
    """

    a12: Array
    a22: Array
    q11: Array
    q12: Array
    q22: Array


def ctcrw_beta(t05):
    """Velocity decay rate beta (1/s) from ``t05`` (s), the time after which correlation is 5 %."""
    return -jnp.log(0.05) / t05


def _position_variance(x):
    """2x - 3 + 4 e^-x - e^-2x without cancellation at small x."""
    small = jnp.minimum(x, _SERIES_BELOW)
    series = jnp.zeros_like(x)
    for c in reversed(_SERIES):
        series = series * small + c
    e = jnp.exp(-x)
    return jnp.where(x < _SERIES_BELOW, series * small**3, 2 * x - 3 + 4 * e - e * e)


def ctcrw_transition(dt, sigma_vel, beta) -> Transition:
    """Transition of the continuous-time correlated random walk over ``dt``.

    Parameters
    ----------
    dt : (...,) array
        Time steps (s), positive.
    sigma_vel : float or array
        Stationary standard deviation of the velocity, one axis (m/s): alpha / sqrt(2 beta).
    beta : float or array
        Velocity decay rate (1/s).

    Returns
    -------
    Transition
        Right to 1e-10 relative for ``beta dt`` from 1e-8 to 1e3.

    References
    ----------
    Johnson et al. (2008), equations 5-7; alpha and beta as in kaltoa.
    """
    x = beta * dt
    one_minus_e = -jnp.expm1(-x)
    var = sigma_vel**2
    return Transition(
        a12=one_minus_e / beta,
        a22=jnp.exp(-x),
        q11=var / beta**2 * _position_variance(x),
        q12=var / beta * one_minus_e**2,
        q22=-var * jnp.expm1(-2 * x),
    )


class CTCRW(dist.Distribution):
    """Path of a continuous-time correlated random walk at given times.

    Parameters
    ----------
    dt : (T - 1,) array
        Seconds from each state to the next, positive.
    sigma_vel : float
        Stationary sd of the velocity in each axis (m/s).
    t05 : float
        Time after which the velocity's autocorrelation is .05 (s).
    centre : (A,) array
        Mean of the first position (m).
    spread : float
        Standard deviation of the first position in each axis (m); velocity starts stationary.

    Notes
    -----
    A value has shape (T, 2, A): ``value[:, 0]`` positions (m), ``value[:, 1]`` velocities (m/s).
    """

    arg_constraints = {
        "dt": constraints.independent(constraints.positive, 1),
        "sigma_vel": constraints.positive,
        "t05": constraints.positive,
        "centre": constraints.real_vector,
        "spread": constraints.positive,
    }
    support = constraints.independent(constraints.real, 3)
    reparametrized_params = ["sigma_vel", "t05", "centre", "spread"]
    is_chain = True

    def __init__(self, dt, sigma_vel, t05, centre, spread=1e3, *, validate_args=None):
        self.dt, self.sigma_vel, self.t05 = jnp.asarray(dt), sigma_vel, t05
        self.centre, self.spread = jnp.asarray(centre), spread
        shape = (self.dt.shape[-1] + 1, 2, self.centre.shape[-1])
        super().__init__(batch_shape=(), event_shape=shape, validate_args=validate_args)

    @property
    def transition(self) -> Transition:
        """The steps' transitions, each element (T - 1,)."""
        return ctcrw_transition(self.dt, self.sigma_vel, ctcrw_beta(self.t05))

    def log_prob(self, value: Float[Array, "time 2 axis"]):
        """Log density of a path (T, 2, A)."""
        position, velocity = value[:, 0], value[:, 1]
        a12, a22, q11, q12, q22 = self.transition
        l11 = jnp.sqrt(q11)
        l21 = q12 / l11
        l22 = jnp.sqrt(q22 - l21**2)
        r1 = (position[1:] - position[:-1] - a12[:, None] * velocity[:-1]) / l11[:, None]
        r2 = (velocity[1:] - a22[:, None] * velocity[:-1] - l21[:, None] * r1) / l22[:, None]
        r0 = (position[0] - self.centre) / self.spread
        v0 = velocity[0] / self.sigma_vel
        n_axes = self.centre.shape[-1]
        log_det = jnp.sum(jnp.log(l11 * l22)) + jnp.log(self.spread * self.sigma_vel)
        squares = jnp.sum(r1**2) + jnp.sum(r2**2) + jnp.sum(r0**2) + jnp.sum(v0**2)
        dims = self.event_shape[0] * 2 * n_axes
        return -0.5 * squares - n_axes * log_det - 0.5 * dims * jnp.log(2 * jnp.pi)

    def sample(self, key, sample_shape=()):
        """Draw paths, shape ``sample_shape + (T, 2, A)``."""
        noise = jax.random.normal(key, (*sample_shape, *self.event_shape))
        a12, a22, q11, q12, q22 = self.transition
        l11 = jnp.sqrt(q11)
        l21 = q12 / l11
        l22 = jnp.sqrt(q22 - l21**2)

        def step(state, inputs):
            position, velocity = state
            z, a12, a22, l11, l21, l22 = inputs
            position = position + a12 * velocity + l11 * z[..., 0, :]
            velocity = a22 * velocity + l21 * z[..., 0, :] + l22 * z[..., 1, :]
            return (position, velocity), (position, velocity)

        first = (
            self.centre + self.spread * noise[..., 0, 0, :],
            self.sigma_vel * noise[..., 0, 1, :],
        )
        rest = jnp.moveaxis(noise[..., 1:, :, :], -3, 0)
        _, (position, velocity) = jax.lax.scan(step, first, (rest, a12, a22, l11, l21, l22))
        path = jnp.stack([position, velocity], axis=-2)
        path = jnp.concatenate([jnp.stack(first, axis=-2)[None], path])
        return jnp.moveaxis(path, 0, -3)

    @property
    def mean(self):
        """Mean path (T, 2, A): the centre, standing still."""
        still = jnp.zeros_like(self.centre)
        return jnp.broadcast_to(jnp.stack([self.centre, still]), self.event_shape)

    @property
    def variance(self):
        """Marginal variances (T, 2, A)."""
        a12, _, q11, q12, _ = self.transition
        a22 = jnp.exp(-ctcrw_beta(self.t05) * self.dt)
        var_v = self.sigma_vel**2

        def step(state, inputs):
            var_x, cov = state
            a12, a22, q11, q12 = inputs
            var_x = var_x + 2 * a12 * cov + a12**2 * var_v + q11
            cov = a22 * (cov + a12 * var_v) + q12
            return (var_x, cov), var_x

        first = jnp.asarray(self.spread**2, float)
        _, rest = jax.lax.scan(step, (first, jnp.zeros(())), (a12, a22, q11, q12))
        var_x = jnp.concatenate([first[None], rest])
        both = jnp.stack([var_x, jnp.broadcast_to(var_v, var_x.shape)], axis=1)
        return jnp.broadcast_to(both[..., None], self.event_shape)


class Brownian(dist.Distribution):
    """Path of Brownian motion (a random walk) at given times.

    Parameters
    ----------
    dt : (T - 1,) array
        Seconds from each state to the next, positive.
    sigma : float
        Standard deviation of a one-second step in each axis (m / sqrt(s)).
    centre : (A,) array
        Mean of the first position (m).
    spread : float
        Standard deviation of the first position in each axis (m).

    Notes
    -----
    A value has shape (T, A): positions (m).
    """

    arg_constraints = {
        "dt": constraints.independent(constraints.positive, 1),
        "sigma": constraints.positive,
        "centre": constraints.real_vector,
        "spread": constraints.positive,
    }
    support = constraints.independent(constraints.real, 2)
    reparametrized_params = ["sigma", "centre", "spread"]
    is_chain = True

    def __init__(self, dt, sigma, centre, spread=1e3, *, validate_args=None):
        self.dt, self.sigma = jnp.asarray(dt), sigma
        self.centre, self.spread = jnp.asarray(centre), spread
        shape = (self.dt.shape[-1] + 1, self.centre.shape[-1])
        super().__init__(batch_shape=(), event_shape=shape, validate_args=validate_args)

    def log_prob(self, value: Float[Array, "time axis"]):
        """Log density of a path (T, A)."""
        scale = self.sigma * jnp.sqrt(self.dt)
        steps = (value[1:] - value[:-1]) / scale[:, None]
        start = (value[0] - self.centre) / self.spread
        n_axes = self.centre.shape[-1]
        log_det = jnp.sum(jnp.log(scale)) + jnp.log(self.spread)
        dims = self.event_shape[0] * n_axes
        squares = jnp.sum(steps**2) + jnp.sum(start**2)
        return -0.5 * squares - n_axes * log_det - 0.5 * dims * jnp.log(2 * jnp.pi)

    def sample(self, key, sample_shape=()):
        """Draw paths, shape ``sample_shape + (T, A)``."""
        noise = jax.random.normal(key, (*sample_shape, *self.event_shape))
        scale = jnp.concatenate([jnp.atleast_1d(self.spread), self.sigma * jnp.sqrt(self.dt)])
        return self.centre + jnp.cumsum(noise * scale[:, None], axis=-2)

    @property
    def mean(self):
        """Mean path (T, A): the centre."""
        return jnp.broadcast_to(self.centre, self.event_shape)

    @property
    def variance(self):
        """Marginal variances (T, A)."""
        steps = jnp.concatenate([jnp.atleast_1d(self.spread**2), self.sigma**2 * self.dt])
        return jnp.broadcast_to(jnp.cumsum(steps)[:, None], self.event_shape)
