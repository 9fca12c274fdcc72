"""How animals move: Gauss-Markov path distributions over the states at the pings.

Convention: time is axis 0 and always there; element ``t`` of ``dt`` is the time from state ``t`` to
state ``t + 1``, so a path of ``T`` states takes ``T - 1`` steps. Axes (x, y) are independent.

Batches: parameters with leading dimensions make a batch of paths (one tag each, say), as in any
NumPyro distribution: ``dt`` (..., T - 1), ``centre`` (..., A), the scalars (...).

Several tags of different lengths make one path instead, laid end to end: ``tag`` (T,) says whose
state each one is, the first state of every tag starts afresh, and the scalars may be arrays (N,)
with one value a tag.

Every path distribution also says how it moves between any two times: ``step(dt, ...)`` is one
axis's transition matrix and covariance, ``scale_names`` the parameters it takes, and ``turn`` the
signs that turn a state round in time. Bridges between states are made of these.

References
----------
Johnson, London, Lea & Durban (2008) Continuous-time correlated random walk model for animal
telemetry data. Ecology 89(5): 1208-1215.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp
from maloc.movement.ou import OU
from maloc.movement.path import LOG_2PI, MarkovPath, column

__all__ = ["CTCRW", "OU", "Brownian", "Transition", "ctcrw_beta", "ctcrw_transition"]

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
    return -math.log(0.05) / t05


def _position_variance(x, xp: Any = jnp):
    """2x - 3 + 4 e^-x - e^-2x without cancellation at small x: 2/3 x^3 there."""
    small = xp.minimum(x, _SERIES_BELOW)
    series = xp.zeros_like(x)
    for c in reversed(_SERIES):
        series = series * small + c
    e = xp.exp(-x)
    return xp.where(x < _SERIES_BELOW, series * small**3, 2 * x - 3 + 4 * e - e * e)


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
    # NumPy where nothing is JAX's: JAX would compile anew for every shape
    xp: Any = jnp if any(isinstance(v, jax.Array) for v in (dt, sigma_vel, beta)) else np
    x = beta * dt
    one_minus_e = -xp.expm1(-x)
    var = sigma_vel**2
    return Transition(
        a12=one_minus_e / beta,
        a22=xp.exp(-x),
        q11=var / beta**2 * _position_variance(x, xp),
        q12=var / beta * one_minus_e**2,
        q22=-var * xp.expm1(-2 * x),
    )


def _step_factor(transition: Transition):
    """Cholesky factor (l11, l21, l22) of each step's Q.

    l22^2 = q22 - q12^2 / q11 falls from q22 to q22 / 4 as beta dt goes to 0: no digits are lost.
    """
    l11 = jnp.sqrt(transition.q11)
    l21 = transition.q12 / l11
    return l11, l21, jnp.sqrt(transition.q22 - l21**2)


class CTCRW(MarkovPath):
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
    tag : (T,) array of int, optional
        Whose state each one is, where tags are laid end to end (N of them, grouped).
    start : distribution, optional
        Law of first positions (A,) in place of Normal(centre, spread): `maloc.statespace.SoftBox`.

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
    scale_names = ("sigma_vel", "t05")
    turn = (1.0, -1.0)

    def __init__(
        self, dt, sigma_vel, t05, centre, spread=1e3, *, tag=None, start=None, validate_args=None
    ):
        scalars = {"sigma_vel": sigma_vel, "t05": t05, "spread": spread}
        self._set(dt, centre, scalars, (2,), tag, start, validate_args)

    @staticmethod
    def step(dt, sigma_vel, t05):
        """Transition matrix and covariance (..., 2, 2) of position and velocity over dt (...)."""
        parts = ctcrw_transition(np.asarray(dt, float), sigma_vel, ctcrw_beta(t05))
        a12, a22, q11, q12, q22 = map(np.asarray, parts)
        a, q = np.zeros((*a12.shape, 2, 2)), np.empty((*a12.shape, 2, 2))
        a[..., 0, 0], a[..., 0, 1], a[..., 1, 1] = 1.0, a12, a22
        q[..., 0, 0], q[..., 0, 1], q[..., 1, 0], q[..., 1, 1] = q11, q12, q12, q22
        return a, q

    @property
    def transition(self) -> Transition:
        """The steps' transitions, each element (..., T - 1)."""
        beta = ctcrw_beta(self.t05)
        return ctcrw_transition(self.dt, self._by_step(self.sigma_vel), self._by_step(beta))

    def _log_density(self, value: Float[Array, "... time 2 axis"]):
        position, velocity = value[..., 0, :], value[..., 1, :]
        transition = self.transition
        l11, l21, l22 = _step_factor(transition)
        a12, a22 = transition.a12[..., None], transition.a22[..., None]
        r1 = position[..., 1:, :] - position[..., :-1, :] - a12 * velocity[..., :-1, :]
        r1 = r1 / l11[..., None]
        r2 = velocity[..., 1:, :] - a22 * velocity[..., :-1, :] - l21[..., None] * r1
        r2 = r2 / l22[..., None]
        n_axes = self.event_shape[-1]
        steps = -0.5 * jnp.sum(r1**2 + r2**2, -1) - n_axes * (jnp.log(l11 * l22) + LOG_2PI)
        sd = self._by_first(self.sigma_vel)
        v0 = self._firsts(velocity) / column(sd)
        at_rest = -0.5 * jnp.sum(v0**2, -1) - n_axes * (jnp.log(sd) + 0.5 * LOG_2PI)
        return self._join(self._place(position) + at_rest, steps)

    def _path(self, noise: Float[Array, "... time 2 axis"], firsts):
        transition = self.transition
        factor = (transition.a12, transition.a22, *_step_factor(transition))
        steps = [jnp.moveaxis(jnp.asarray(x)[..., None], -2, 0) for x in factor]
        if firsts is None:
            firsts = self.centre[..., None, :] + column(column(self.spread)) * noise[..., 0, :]
        sd = self._by_first(self.sigma_vel)
        rest = jnp.broadcast_to(column(sd), noise[..., 1, :].shape) * noise[..., 1, :]
        start = self._own_start() == jnp.arange(self.event_shape[0])

        def step(state, inputs):
            position, velocity = state
            z, starts, place, at_rest, a12, a22, l11, l21, l22 = inputs
            position = position + a12 * velocity + l11 * z[..., 0, :]
            velocity = a22 * velocity + l21 * z[..., 0, :] + l22 * z[..., 1, :]
            position = jnp.where(starts, place, position)
            velocity = jnp.where(starts, at_rest, velocity)
            return (position, velocity), (position, velocity)

        first = (firsts[..., 0, :], rest[..., 0, :])
        inputs = [jnp.moveaxis(x[..., 1:, :], -2, 0) for x in (firsts, rest)]
        z = jnp.moveaxis(noise[..., 1:, :, :], -3, 0)
        _, (position, velocity) = jax.lax.scan(step, first, (z, start[1:], *inputs, *steps))
        path = jnp.stack([position, velocity], axis=-2)
        path = jnp.concatenate([jnp.stack(first, axis=-2)[None], path])
        return jnp.moveaxis(path, 0, -3)

    @property
    def mean(self):
        """Mean path (..., T, 2, A): the first position's mean, standing still."""
        centre = self._first_law().mean
        both = jnp.stack([centre, jnp.zeros_like(centre)], axis=-2)
        return self._broadcast(both[..., None, :, :])

    @property
    def variance(self):
        """Marginal variances (..., T, 2, A): m2 and m2/s2."""
        beta = self._by_first(ctcrw_beta(self.t05))
        x = beta * self._elapsed()
        stationary = self._by_first(self.sigma_vel) ** 2
        # 2 (x - 1 + e^-x) as a sum of two positive terms: no cancellation
        moved = stationary / beta**2 * (_position_variance(x) + jnp.expm1(-x) ** 2)
        position = self._first_law().variance[..., None, :] + moved[..., None]
        still = jnp.broadcast_to(column(stationary), position.shape)
        return self._broadcast(jnp.stack([position, still], axis=-2))


class Brownian(MarkovPath):
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
    tag : (T,) array of int, optional
        Whose state each one is, where tags are laid end to end (N of them, grouped).
    start : distribution, optional
        Law of first positions (A,) in place of Normal(centre, spread): `maloc.statespace.SoftBox`.

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
    scale_names = ("sigma",)
    turn = (1.0,)

    def __init__(self, dt, sigma, centre, spread=1e3, *, tag=None, start=None, validate_args=None):
        scalars = {"sigma": sigma, "spread": spread}
        self._set(dt, centre, scalars, (), tag, start, validate_args)

    @staticmethod
    def step(dt, sigma):
        """Transition matrix and covariance (..., 1, 1) over dt (...)."""
        q = np.asarray(sigma**2 * np.asarray(dt, float))
        return np.ones((*q.shape, 1, 1)), q[..., None, None]

    def _step_sd(self):
        return self._by_step(self.sigma) * jnp.sqrt(self.dt)

    def _log_density(self, value: Float[Array, "... time axis"]):
        scale = self._step_sd()
        steps = (value[..., 1:, :] - value[..., :-1, :]) / scale[..., None]
        n_axes = self.event_shape[-1]
        steps = -0.5 * jnp.sum(steps**2, -1) - n_axes * (jnp.log(scale) + 0.5 * LOG_2PI)
        return self._join(self._place(value), steps)

    def _path(self, noise: Float[Array, "... time axis"], firsts):
        if firsts is None:
            firsts = self.centre[..., None, :] + column(column(self.spread)) * noise
        steps = noise[..., 1:, :] * self._step_sd()[..., None]
        moved = jnp.cumsum(jnp.concatenate([jnp.zeros_like(steps[..., :1, :]), steps], -2), -2)
        own = self._own_start()
        return firsts[..., own, :] + moved - moved[..., own, :]

    @property
    def mean(self):
        """Mean path (..., T, A): the first position's mean."""
        return self._broadcast(self._first_law().mean[..., None, :])

    @property
    def variance(self):
        """Marginal variances (..., T, A), m2."""
        moved = self._by_first(self.sigma) ** 2 * self._elapsed()
        return self._broadcast(self._first_law().variance[..., None, :] + moved[..., None])
