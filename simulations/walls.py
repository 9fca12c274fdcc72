"""Tags among receivers of which some hear only a reflection, for good, as in canals with walls.

Two kinds: a walker on both sides of a wall, whose pings reach the receivers of the other side by a
detour of their own; and a tag that lies still, which some receivers hear by a detour and the
others directly. Everything is made up; `WallWorld` says how.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.data import ArrivalTimes
from simulations._walk import arrivals, walk

__all__ = ["WallWorld", "wall_world"]


@dataclass(frozen=True)
class WallWorld:
    """A canal with a wall.

    Parameters
    ----------
    pings : int
    fixed : bool
        The tag lies still; which receivers are late is drawn. Else it walks, and those on the
        other side of the wall are.
    share : float
        Of the receivers: late for good (fixed), or beyond the wall.
    late : pair of float
        A receiver's detour, uniform, m.
    spread : pair of float
        Standard deviation of its detour from ping to ping, uniform, m.
    sigma : float
        Standard deviation of a direct arrival, m.
    heard : pair of float
        Chance that a direct and a late arrival is heard.
    interval : pair of float
        Burst interval, s.
    receivers : int
    """

    pings: int = 300
    fixed: bool = False
    share: float = 0.45
    late: tuple[float, float] = (12.0, 40.0)
    spread: tuple[float, float] = (0.5, 2.5)
    sigma: float = 0.25
    heard: tuple[float, float] = (0.92, 0.5)
    interval: tuple[float, float] = (20.0, 40.0)
    receivers: int = 12


def wall_world(rng: np.random.Generator, world: WallWorld) -> tuple[ArrivalTimes, np.ndarray]:
    """Arrival times and the true positions (P, 2), m, of a world drawn by its seed."""
    n, size = world.receivers, np.array([240.0, 90.0])
    x = size[0] * (np.arange(n) + 0.5) / n
    y = size[1] * (np.arange(n) % 3) / 2  # three rows, as along both shores and amid them
    xy = np.column_stack([x, y]) + rng.uniform(-8, 8, (n, 2))
    time = np.cumsum(rng.uniform(*world.interval, world.pings))
    if world.fixed:
        place = np.broadcast_to(size * rng.uniform(0.3, 0.7, 2), (world.pings, 2))
        late = rng.permutation(n) < round(world.share * n)
        beyond = np.broadcast_to(late, (world.pings, n))
    else:
        place = _inside(walk(rng, time, 0.13, 600.0, size * rng.uniform(0.3, 0.7, 2)), size)
        direction = rng.uniform(-0.6, 0.6)  # of the wall's normal, from along the canal
        normal = np.array([np.cos(direction), np.sin(direction)])
        wall = np.quantile(xy @ normal, 1 - world.share)
        beyond = (place @ normal > wall)[:, None] != (xy @ normal > wall)
    detour = rng.uniform(*world.late, n) + rng.uniform(*world.spread, n) * rng.standard_normal(
        beyond.shape
    )
    far = np.linalg.norm(place[:, None] - xy, axis=-1) + np.where(beyond, detour.clip(0.3), 0.0)
    far = far + world.sigma * rng.standard_normal(far.shape)
    heard = rng.random(far.shape) < np.where(beyond, *world.heard[::-1])
    toa, known = arrivals(time, far, heard, xy)
    return toa, place[known]


def _inside(place: np.ndarray, size: np.ndarray) -> np.ndarray:
    """A walk folded at the shores, which it does not leave."""
    period = 2 * size
    folded = np.mod(place, period)
    return np.minimum(folded, period - folded)
