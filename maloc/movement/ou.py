"""Home-range movement: the position itself is an Ornstein-Uhlenbeck process around a centre."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp
from maloc.movement.path import LOG_2PI, MarkovPath, by_tag, column

__all__ = ["OU"]


class OU(MarkovPath):
    """Path of an animal that keeps to a home range, at given times.

    Parameters
    ----------
    dt : (..., T - 1) array
        Seconds from each state to the next, positive.
    sd : float or (...) array
        Standard deviation of the position around the centre, in each axis (m): the home range.
    t05 : float or (...) array
        Time after which the position's autocorrelation is .05 (s).
    centre : (..., A) array
        Centre of the home range (m); with ``tag`` also (N, A), one a tag.
    tag : (T,) array of int, optional
        Whose state each one is, where tags are laid end to end (N of them, grouped).

    Notes
    -----
    A value has shape (..., T, A): positions (m). The first one is stationary: Normal(centre, sd).
    With e = .05^(dt / t05) a step takes x to centre + e (x - centre) + N(0, sd^2 (1 - e^2)).

    References
    ----------
    Dunn & Gipson (1977) Analysis of radio telemetry data in studies of home range. Biometrics 33:
    85-101; Blackwell (1997) Random diffusion models for animal movement. Ecol. Model. 100: 87-102.
    """

    arg_constraints = {
        "dt": constraints.independent(constraints.positive, 1),
        "sd": constraints.positive,
        "t05": constraints.positive,
        "centre": constraints.real_vector,
    }
    support: Any = constraints.independent(constraints.real, 2)
    sd: Any
    t05: Any
    reparametrized_params = ["dt", "sd", "t05", "centre"]
    scale_names = ("sd", "t05")
    turn = (1.0,)

    def __init__(self, dt, sd, t05, centre, *, tag=None, validate_args=None):
        homes = None
        if tag is not None and jnp.ndim(centre) == 2:
            homes, centre = by_tag(centre, jnp.asarray(tag)), jnp.asarray(centre)[0]
        self._set(dt, centre, {"sd": sd, "t05": t05}, (), tag, None, validate_args)
        if homes is not None:
            self.centre = homes

    @staticmethod
    def step(dt, sd, t05):
        """Transition matrix and covariance (..., 1, 1) over dt (...), of x - centre."""
        x = -math.log(0.05) * np.asarray(dt) / t05
        a, q = np.broadcast_arrays(np.exp(-x), -np.expm1(-2 * x) * sd**2)
        return a[..., None, None], q[..., None, None]

    def _shrink(self):
        """Autocorrelation over each step, and the share of variance that is new, (..., T - 1)."""
        x = -math.log(0.05) * self.dt / self._by_step(self.t05)
        return jnp.exp(-x), -jnp.expm1(-2 * x)

    def _home(self):
        """Centres as they go with states (..., T or 1, A)."""
        by_state = jnp.ndim(self.centre) > 1 + len(self.batch_shape)
        return self.centre if by_state else self.centre[..., None, :]

    def _log_density(self, value: Float[Array, "... time axis"]):
        sd = self._by_first(self.sd)
        off = (value - self._home()) / column(sd)
        e, new = self._shrink()
        steps = (off[..., 1:, :] - e[..., None] * off[..., :-1, :]) / jnp.sqrt(new)[..., None]
        n_axes = self.event_shape[-1]
        size = n_axes * (jnp.log(sd) + 0.5 * LOG_2PI)  # (), (..., 1), or with tags (T,)
        first = -0.5 * jnp.sum(self._firsts(off) ** 2, -1) - size
        later = size if self.tag is None or jnp.ndim(size) == 0 else size[1:]
        steps = -0.5 * jnp.sum(steps**2, -1) - later - 0.5 * n_axes * jnp.log(new)
        return self._join(first, steps)

    def _path(self, noise: Float[Array, "... time axis"], firsts):
        e, new = self._shrink()
        start = self._own_start() == jnp.arange(self.event_shape[0])
        inputs = [jnp.moveaxis(x[..., None], -2, 0) for x in (e, jnp.sqrt(new))]
        z = jnp.moveaxis(noise, -2, 0)

        def step(off, now):
            z, starts, e, root = now
            off = jnp.where(starts, z, e * off + root * z)
            return off, off

        _, later = jax.lax.scan(step, z[0], (z[1:], start[1:], *inputs))
        off = jnp.moveaxis(jnp.concatenate([z[:1], later]), 0, -2)
        return self._home() + column(self._by_first(self.sd)) * off

    @property
    def mean(self):
        """Mean path (..., T, A): the centre."""
        return self._broadcast(self._home())

    @property
    def variance(self):
        """Marginal variances (..., T, A), m2."""
        return self._broadcast(column(self._by_first(self.sd)) ** 2)
