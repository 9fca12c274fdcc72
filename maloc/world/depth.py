"""How deep an animal swims: a path between surface and bottom, and what a pressure sensor says.

A depth is bounded. A free path that drifts (Brownian, CTCRW) would end up beyond surface or bottom
wherever no sensor holds it, so the depth's path z (m) is stationary, an Ornstein-Uhlenbeck process
about a mean that lies between the two; and as the bounds cannot cut a normal law, the depth is a
function of it that is z between them and comes to rest on them:

    depth = s log(1 + exp(z / s)) - s log(1 + exp((z - bottom) / s)),

with s a hundredth of the water's depth, at most half a metre.

A path beyond a bound is an animal that keeps to the surface or the bottom. Where nothing is known
the mean is uniform between the two, and so is the depth but for what lies on the bounds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpyro.distributions as dist
from jaxtyping import Array
from numpyro.distributions import constraints

from maloc._jax import jax, jnp
from maloc.movement.ou import OU
from maloc.world.depth_data import DepthData
from maloc.world.habitat import _spline

__all__ = ["DepthPath", "PressureSensor", "bottom_at", "depth_of", "path_at"]

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
_SOFT, _SOFTEST = 0.01, 0.5  # of the water column, and m at most: width of the bounds
_NEAR = 0.02  # of the water column: starts keep this far from surface and bottom


class DepthPath(OU):
    """Path z of a depth, see the module: an `OU` path with one axis, a value (T, 1) in m."""


def bottom_at(water: DepthData, position):
    """Depth of the water (T,) or () m at positions (T, 2)."""
    if water.grid is None:
        return water.bottom
    field = jnp.asarray(water.grid)[None]
    rows, columns = field.shape[1:]
    at = (position - jnp.asarray(water.origin)[None]) / water.step
    at = jnp.clip(at, 0.0, jnp.array([[columns - 1.0, rows - 1.0]]))
    return jax.vmap(lambda one: _spline(field, one)[0])(at)


def depth_of(path, bottom):
    """Depths (...) m of z (...) m where the water is so deep (m)."""
    # NumPy where nothing is JAX's: JAX would compile anew for every shape
    xp: Any = jnp if isinstance(path, jax.Array) else np
    soft = xp.minimum(_SOFT * bottom, _SOFTEST)
    return soft * (xp.logaddexp(0.0, path / soft) - xp.logaddexp(0.0, (path - bottom) / soft))


def path_at(depth: np.ndarray, bottom: np.ndarray | float) -> np.ndarray:
    """The path (...) m at depths (...) m, kept off surface and bottom."""
    return np.clip(depth, _NEAR * np.asarray(bottom), (1 - _NEAR) * np.asarray(bottom))


class PressureSensor(dist.Distribution):
    """Depth that a tag's sensor says: normal around the true one.

    Parameters
    ----------
    loc : (T,) array
        True depth, m.
    sd : ()
        Standard deviation of the sensor's error, m.

    Notes
    -----
    The engine takes its curvature for Gauss-Newton steps, since depth bends with the path.
    """

    arg_constraints: Any = {}
    support: Any = constraints.real
    reparametrized_params = ["loc", "sd"]

    def __init__(self, loc, sd, *, validate_args=None) -> None:
        self.loc, self.sd = loc, sd
        super().__init__(jnp.shape(loc), (), validate_args=validate_args)

    def log_prob(self, value):
        """Log density of each sensed depth (T,)."""
        return -0.5 * ((value - self.loc) / self.sd) ** 2 - jnp.log(self.sd) - _HALF_LOG_2PI

    def sample(self, key: Array, sample_shape=()):
        """Draw sensed depths, m."""
        return self.loc + self.sd * jax.random.normal(key, self.shape(sample_shape))

    def widened(self, scale) -> PressureSensor:
        """Itself: no arrival is late here."""
        return self

    def curvature(self, value):
        """1 / sd^2."""
        return jnp.broadcast_to(1 / self.sd**2, jnp.shape(value))

    robust_curvature = curvature
