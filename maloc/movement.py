"""How animals move: Gauss-Markov path distributions over the states at the pings.

Convention: time is axis 0 and always there; element ``t`` of ``dt`` is the time from state ``t`` to
state ``t + 1``, so a path of ``T`` states takes ``T - 1`` steps. Axes (x, y) are independent.

Batches: parameters with leading dimensions make a batch of paths (one tag each, say), as in any
NumPyro distribution: ``dt`` (..., T - 1), ``centre`` (..., A), the scalars (...).

References
----------
Johnson, London, Lea & Durban (2008) Continuous-time correlated random walk model for animal
telemetry data. Ecology 89(5): 1208-1215.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp

__all__ = ["CTCRW", "Brownian", "Transition", "ctcrw_beta", "ctcrw_transition"]

_LOG_2PI = math.log(2 * math.pi)
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
    """2x - 3 + 4 e^-x - e^-2x without cancellation at small x: 2/3 x^3 there."""
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


def _step_factor(transition: Transition):
    """Cholesky factor (l11, l21, l22) of each step's Q.

    l22^2 = q22 - q12^2 / q11 falls from q22 to q22 / 4 as beta dt goes to 0: no digits are lost.
    """
    l11 = jnp.sqrt(transition.q11)
    l21 = transition.q12 / l11
    return l11, l21, jnp.sqrt(transition.q22 - l21**2)


def _total(x):
    """Sum over the last two axes (time and axis of a path)."""
    return jnp.sum(x, axis=(-2, -1))


class _Path(dist.Distribution):
    """What both path distributions share: shapes, and a start around a centre."""

    is_chain = True
    support: Any
    dt: Any
    centre: Any
    spread: Any
    _log_density: Any  # (batch + event) -> (batch)
    _path: Any  # standard normal noise (batch + event) -> path

    def _set(self, dt, centre, scalars: dict, tail: tuple[int, ...], validate_args) -> None:
        """Keep the parameters, all with the batch's number of dimensions (plus their own)."""
        dt, centre = jnp.asarray(dt), jnp.asarray(centre)
        shapes = [jnp.shape(v) for v in scalars.values()]
        batch = jax.lax.broadcast_shapes(dt.shape[:-1], centre.shape[:-1], *shapes)
        (self.dt,) = promote_shapes(dt, shape=(*batch, dt.shape[-1]))
        (self.centre,) = promote_shapes(centre, shape=(*batch, centre.shape[-1]))
        for name, value in scalars.items():
            (value,) = promote_shapes(value, shape=batch)
            setattr(self, name, value)
        event = (dt.shape[-1] + 1, *tail, centre.shape[-1])
        super().__init__(batch_shape=batch, event_shape=event, validate_args=validate_args)

    def _over(self, function, value):
        """``function(value)``, mapped over the value's sample dimensions."""
        for _ in range(jnp.ndim(value) - len(self.batch_shape) - len(self.event_shape)):
            function = jax.vmap(function)
        return function(value)

    def log_prob(self, value: Float[Array, ...]):
        """Log density of a path; the value's shape ends in batch_shape + event_shape."""
        return self._over(self._log_density, value)

    def sample(self, key: Array, sample_shape=()):
        """Draw paths, shape ``sample_shape + batch_shape + event_shape``."""
        noise = jax.random.normal(key, self.shape(sample_shape))
        return self._over(self._path, noise)

    def _broadcast(self, x):
        return jnp.broadcast_to(x, self.batch_shape + self.event_shape)


def _column(x):
    """A parameter (...) as (..., 1), to go with an array over time; a scalar as it is (faster)."""
    return x if jnp.ndim(x) == 0 else x[..., None]


class CTCRW(_Path):
    """Path of a continuous-time correlated random walk at given times.

    Parameters
    ----------
    dt : (..., T - 1) array
        Seconds from each state to the next, positive.
    sigma_vel : float or (...) array
        Stationary sd of the velocity in each axis (m/s).
    t05 : float or (...) array
        Time after which the velocity's autocorrelation is .05 (s).
    centre : (..., A) array
        Mean of the first position (m).
    spread : float or (...) array
        Standard deviation of the first position in each axis (m); velocity starts stationary.

    Notes
    -----
    A value has shape (..., T, 2, A): ``value[..., 0, :]`` positions (m), ``value[..., 1, :]``
    velocities (m/s).

    References
    ----------
    Johnson et al. (2008), equations 5-7.
    """

    arg_constraints = {
        "dt": constraints.independent(constraints.positive, 1),
        "sigma_vel": constraints.positive,
        "t05": constraints.positive,
        "centre": constraints.real_vector,
        "spread": constraints.positive,
    }
    support: Any = constraints.independent(constraints.real, 3)
    sigma_vel: Any
    t05: Any
    reparametrized_params = ["dt", "sigma_vel", "t05", "centre", "spread"]

    def __init__(self, dt, sigma_vel, t05, centre, spread=1e3, *, validate_args=None):
        scalars = {"sigma_vel": sigma_vel, "t05": t05, "spread": spread}
        self._set(dt, centre, scalars, (2,), validate_args)

    @property
    def transition(self) -> Transition:
        """The steps' transitions, each element (..., T - 1)."""
        return ctcrw_transition(self.dt, _column(self.sigma_vel), _column(ctcrw_beta(self.t05)))

    def _log_density(self, value: Float[Array, "... time 2 axis"]):
        position, velocity = value[..., 0, :], value[..., 1, :]
        transition = self.transition
        l11, l21, l22 = _step_factor(transition)
        a12, a22 = transition.a12[..., None], transition.a22[..., None]
        r1 = position[..., 1:, :] - position[..., :-1, :] - a12 * velocity[..., :-1, :]
        r1 = r1 / l11[..., None]
        r2 = velocity[..., 1:, :] - a22 * velocity[..., :-1, :] - l21[..., None] * r1
        r2 = r2 / l22[..., None]
        r0 = (position[..., 0, :] - self.centre) / _column(self.spread)
        v0 = velocity[..., 0, :] / _column(self.sigma_vel)
        squares = _total(r1**2) + _total(r2**2) + jnp.sum(r0**2, -1) + jnp.sum(v0**2, -1)
        log_det = jnp.sum(jnp.log(l11 * l22), -1) + jnp.log(self.spread * self.sigma_vel)
        n_times, _, n_axes = self.event_shape
        return -0.5 * squares - n_axes * (log_det + n_times * _LOG_2PI)

    def _path(self, noise: Float[Array, "... time 2 axis"]):
        transition = self.transition
        factor = (transition.a12, transition.a22, *_step_factor(transition))
        steps = [jnp.moveaxis(jnp.asarray(x)[..., None], -2, 0) for x in factor]

        def step(state, inputs):
            position, velocity = state
            z, a12, a22, l11, l21, l22 = inputs
            position = position + a12 * velocity + l11 * z[..., 0, :]
            velocity = a22 * velocity + l21 * z[..., 0, :] + l22 * z[..., 1, :]
            return (position, velocity), (position, velocity)

        first = (
            self.centre + _column(self.spread) * noise[..., 0, 0, :],
            _column(self.sigma_vel) * noise[..., 0, 1, :],
        )
        rest = jnp.moveaxis(noise[..., 1:, :, :], -3, 0)
        _, (position, velocity) = jax.lax.scan(step, first, (rest, *steps))
        path = jnp.stack([position, velocity], axis=-2)
        path = jnp.concatenate([jnp.stack(first, axis=-2)[None], path])
        return jnp.moveaxis(path, 0, -3)

    @property
    def mean(self):
        """Mean path (..., T, 2, A): the centre, standing still."""
        both = jnp.stack([self.centre, jnp.zeros_like(self.centre)], axis=-2)
        return self._broadcast(both[..., None, :, :])

    @property
    def variance(self):
        """Marginal variances (..., T, 2, A): m2 and m2/s2."""
        beta = _column(ctcrw_beta(self.t05))
        elapsed = jnp.cumsum(self.dt, axis=-1)
        elapsed = jnp.concatenate([jnp.zeros_like(elapsed[..., :1]), elapsed], axis=-1)
        x = beta * elapsed
        stationary = _column(self.sigma_vel) ** 2
        # 2 (x - 1 + e^-x) as a sum of two positive terms: no cancellation
        moved = stationary / beta**2 * (_position_variance(x) + jnp.expm1(-x) ** 2)
        position = _column(self.spread) ** 2 + moved
        both = jnp.stack([position, jnp.broadcast_to(stationary, position.shape)], axis=-1)
        return self._broadcast(both[..., None])


class Brownian(_Path):
    """Path of Brownian motion (a random walk) at given times.

    Parameters
    ----------
    dt : (..., T - 1) array
        Seconds from each state to the next, positive.
    sigma : float or (...) array
        Standard deviation of a one-second step in each axis (m / sqrt(s)).
    centre : (..., A) array
        Mean of the first position (m).
    spread : float or (...) array
        Standard deviation of the first position in each axis (m).

    Notes
    -----
    A value has shape (..., T, A): positions (m).
    """

    arg_constraints = {
        "dt": constraints.independent(constraints.positive, 1),
        "sigma": constraints.positive,
        "centre": constraints.real_vector,
        "spread": constraints.positive,
    }
    support: Any = constraints.independent(constraints.real, 2)
    sigma: Any
    reparametrized_params = ["dt", "sigma", "centre", "spread"]

    def __init__(self, dt, sigma, centre, spread=1e3, *, validate_args=None):
        self._set(dt, centre, {"sigma": sigma, "spread": spread}, (), validate_args)

    def _log_density(self, value: Float[Array, "... time axis"]):
        scale = _column(self.sigma) * jnp.sqrt(self.dt)
        steps = (value[..., 1:, :] - value[..., :-1, :]) / scale[..., None]
        start = (value[..., 0, :] - self.centre) / _column(self.spread)
        squares = _total(steps**2) + jnp.sum(start**2, -1)
        log_det = jnp.sum(jnp.log(scale), -1) + jnp.log(self.spread)
        n_times, n_axes = self.event_shape
        return -0.5 * squares - n_axes * (log_det + 0.5 * n_times * _LOG_2PI)

    def _steps_sd(self):
        """Sd (..., T) of the start and of each step."""
        steps = _column(self.sigma) * jnp.sqrt(self.dt)
        start = jnp.broadcast_to(_column(self.spread), (*steps.shape[:-1], 1))
        return jnp.concatenate([start, steps], axis=-1)

    def _path(self, noise: Float[Array, "... time axis"]):
        steps = noise * self._steps_sd()[..., None]
        return self.centre[..., None, :] + jnp.cumsum(steps, axis=-2)

    @property
    def mean(self):
        """Mean path (..., T, A): the centre."""
        return self._broadcast(self.centre[..., None, :])

    @property
    def variance(self):
        """Marginal variances (..., T, A), m2."""
        return self._broadcast(jnp.cumsum(self._steps_sd() ** 2, axis=-1)[..., None])
