"""Sound along straight lines through water whose sound speed changes with depth.

A straight ray spends the same share of its length on each metre down, so that its travel time is
that length times the mean of 1 / c between the depths at its ends. With c linear between the depths
of a profile the integral S(z) of 1 / c from the top is known in closed form: across a layer of
thickness h from speed a to speed b it is

    h log(b / a) / (b - a) = 2 h / (a + b) (1 + u^2 / 3 + u^4 / 5 + ...),    u = (b - a) / (b + a),

whose series needs no case of its own where the speeds agree. The mean from depth y to depth z is
(S(z) - S(y)) / (z - y). Speeds differ by a tenth at most, so that the terms kept leave 1e-13.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from maloc._jax import jax, jnp
from maloc.data.sound_profile import SoundProfile

Numbers = Array | np.ndarray

__all__ = ["RayData", "mean_slowness", "profile_ray", "ray_data"]

_NEAR = 1e-2  # m; depths that differ by less: 1 / c halfway
_BEYOND = 1.0  # m; the last layer, of one speed, whose line goes on


class RayData(NamedTuple):
    """A profile as models see it: a pytree of arrays.

    Attributes
    ----------
    knot : (K,) m
        Depths.
    speed : (S, K) m/s
        A row a state, or one for all.
    whole : (S, K) s
        Integral of 1 / c from the first depth.
    reference : (T,) m/s
        Sound speed that ranges are counted in.
    """

    knot: Float[Numbers, " knot"]
    speed: Float[Numbers, "cast knot"]
    whole: Float[Numbers, "cast knot"]
    reference: Float[Numbers, " state"]


def ray_data(depth: np.ndarray, speed: np.ndarray, reference: np.ndarray) -> RayData:
    """Bring a profile into the form that models read.

    Parameters
    ----------
    depth : (K,) array
        m, ascending.
    speed : (S, K) array
        m/s; S is 1 or T.
    reference : (T,) array
        m/s.
    """
    knot = np.concatenate([[depth[0] - _BEYOND], depth, [depth[-1] + _BEYOND]])
    speed = np.concatenate([speed[:, :1], speed, speed[:, -1:]], axis=1)
    layer = _layer(np.diff(knot), speed[:, :-1], speed[:, 1:])
    whole = np.concatenate([np.zeros((len(speed), 1)), np.cumsum(layer, axis=1)], axis=1)
    return RayData(knot, speed, whole, np.asarray(reference, float))


def profile_ray(
    profile: SoundProfile | None, time: np.ndarray, reference: np.ndarray
) -> RayData | None:
    """Rays by a profile at times (t,), s since 1970 UTC, padded to T states; None without one.

    Parameters
    ----------
    profile : SoundProfile or None
    time : (t,) array
        s; at most T.
    reference : (T,) array
        Sound speed that ranges are counted in, m/s.
    """
    if profile is None:
        return None
    rows = profile.at(time)
    if len(rows) > 1:
        rows = np.pad(rows, ((0, len(reference) - len(rows)), (0, 0)), mode="edge")
    return ray_data(profile.depth, rows, reference)


def mean_slowness(ray: RayData, depth: Any, receiver: Any):
    """Mean of c / c(z), without unit, between the tag's depths and the receivers'.

    Parameters
    ----------
    ray : RayData
        Of T states.
    depth : (T,) array
        The tag's, m.
    receiver : (R,) array
        The receivers', m.

    Returns
    -------
    (T, R) array
        By how much a straight ray takes longer than at the reference speed c.
    """
    # NumPy where nothing is JAX's: JAX would compile anew for every shape
    xp: Any = jnp if isinstance(depth, jax.Array) or isinstance(ray.knot, jax.Array) else np
    tag = xp.asarray(depth)[:, None]
    there = xp.broadcast_to(xp.asarray(receiver)[None], (tag.shape[0], len(receiver)))
    down = there - tag
    near = xp.abs(down) < _NEAR
    whole = _within(ray, there, xp)[0] - _within(ray, tag, xp)[0]
    half = 1 / _within(ray, 0.5 * (there + tag), xp)[1]
    slowness = xp.where(near, half, whole / xp.where(near, 1.0, down))
    return xp.asarray(ray.reference)[:, None] * slowness


def _layer(thickness, above, below):
    """Integral of 1 / c across a layer, s."""
    square = ((below - above) / (below + above)) ** 2
    series = 1 + square * (1 / 3 + square * (1 / 5 + square * (1 / 7 + square / 9)))
    return 2 * thickness / (above + below) * series


def _within(ray: RayData, z, xp):
    """Integral of 1 / c down to depths (T, M), s, and the speed there."""
    knot, speed = xp.asarray(ray.knot), xp.asarray(ray.speed)
    k = xp.clip(xp.searchsorted(knot, z, side="right") - 1, 0, len(knot) - 2)

    def row(values, k):
        if len(values) == 1:
            return values[0][k]
        return xp.take_along_axis(values, k, axis=1)

    above, below = row(speed, k), row(speed, k + 1)
    deeper = z - knot[k]
    here = above + (below - above) * deeper / (knot[k + 1] - knot[k])
    return row(xp.asarray(ray.whole), k) + _layer(deeper, above, here), here
