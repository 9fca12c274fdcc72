"""Places that a few arrivals of a ping fit exactly: what consensus and clustering choose from."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from maloc._jax import jnp
from maloc.points._closed import minimal
from maloc.points._problem import Problem

__all__ = ["allowed", "hypotheses", "sets"]


@cache
def sets(width: int, size: int, most: int) -> np.ndarray:
    """Index sets (K, size) of the first arrivals, ordered by the worst of each (colexicographic).

    Arrivals stand best first, so sets of small variance come first, and the sets of m arrivals
    come before any with a later one. `most` bounds K.
    """
    last = size
    while last < width and comb(last, size) < most:
        last += 1
    found = sorted(combinations(range(last), size), key=lambda s: s[::-1])
    return np.array(found[:most], dtype=np.int32).reshape(-1, size)


def hypotheses(ping: Problem, d: int, most: int) -> tuple[Any, Any, Any]:
    """Both roots of the minimal sets of one ping.

    Parameters
    ----------
    ping : Problem
        One ping of width M.
    d : int
        2 or 3.
    most : int
        Largest number of sets.

    Returns
    -------
    position : array (d, 2 K)
        Metres; NaN where there is none.
    emission : array (2 K,)
        Range, m.
    exact : array (2 K,) bool
        Solves its set's equations.
    """
    chosen = sets(ping.heard.shape[0], d + 1, most)
    arrival = ping.range[chosen.T]
    place = jnp.moveaxis(ping.place[chosen.T], 2, 1)
    heard = jnp.all(ping.heard[chosen.T], axis=0)
    roots = minimal(arrival, place, d)
    position = jnp.where(heard[None, None], roots.position, jnp.nan)
    return (
        jnp.concatenate([position[0], position[1]], axis=1),
        roots.emission.reshape(-1),
        (roots.exact & heard[None]).reshape(-1),
    )


def allowed(ping: Problem, position: Any, reach: Any, region: Any) -> Any:
    """Hypotheses (d, H) within reach of a receiver that heard the ping, and in the region."""
    square = sum((position[i][None] - ping.place[:, i, None]) ** 2 for i in range(2))
    near = jnp.min(jnp.where(ping.heard[:, None], square, jnp.inf), axis=0) <= reach**2
    near = near & jnp.isfinite(position[0])
    if not region.shape[0]:
        return near
    x, y = position[0][None], position[1][None]
    following = jnp.roll(region, -1, axis=0)
    ax, ay, bx, by = (c[:, None] for c in (*region.T, *following.T))
    crosses = (ay > y) != (by > y)  # even-odd rule
    rise = jnp.where(by == ay, 1.0, by - ay)
    return near & (jnp.sum(crosses & (x < ax + (y - ay) * (bx - ax) / rise), axis=0) % 2 == 1)
