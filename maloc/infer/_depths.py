"""Depths at any times: the bridge of the depth's path, or lines between depths that are known."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc.world.depth import bottom_at, depth_of

__all__ = ["COLUMNS", "DepthDraws", "draw_depths", "expected_depths", "summed_up"]

COLUMNS = "z", "sd_z", "z_lo", "z_hi"  # of tables: m


class DepthDraws(NamedTuple):
    """Draws of the depth of one tag.

    Attributes
    ----------
    path : PathDraws or None
        Of the depth's path, one axis; None where every depth is known.
    water : DepthData
        The bottom.
    clock, known : (T,) arrays
        Times (s) of the states and, where there is no path, depths (m) there.
    """

    path: Any
    water: Any
    clock: np.ndarray
    known: np.ndarray

    def take(self, which) -> DepthDraws:
        """Some of the draws."""
        return self if self.path is None else self._replace(path=self.path.take(which))


def draw_depths(
    rng: np.random.Generator, depths: DepthDraws, times: np.ndarray, xy: np.ndarray
) -> np.ndarray:
    """Draw depths (D, n) m at ascending times (D, n) s and positions (D, n, 2) m."""
    from maloc.infer._bridge import draw

    if depths.path is None:
        return np.interp(times, depths.clock, depths.known)
    path = draw(rng, depths.path, times)[:, :, 0, 0]
    bottom = bottom_at(depths.water, np.reshape(xy, (-1, 2)))
    bottom = np.asarray(bottom).reshape(path.shape if np.ndim(bottom) else ())
    return np.asarray(depth_of(path, bottom))


def summed_up(depth: np.ndarray | None, i: int) -> np.ndarray:
    """`COLUMNS` (4,) of the i-th of depths (D, n); of none where tracks are flat (0,)."""
    if depth is None:
        return np.zeros(0)
    low, high = np.quantile(depth[:, i], [0.025, 0.975])
    return np.array([depth[:, i].mean(), depth[:, i].std(), low, high])


def expected_depths(depths: DepthDraws, times: np.ndarray, xy: np.ndarray, seed: int):
    """Mean and sd (n,) m of the depth at times (n,) s, over water as deep as at xy (n, 2) m.

    Between depths that are known and differ the sd is not known: NaN.
    """
    if depths.path is None:
        sd = 0.0 if np.ptp(depths.known) == 0 else np.nan
        return np.interp(times, depths.clock, depths.known), np.full(len(times), sd)
    order, n = np.argsort(times, kind="stable"), len(depths.path.clock)
    at = np.broadcast_to(times[order], (n, len(times)))
    place = np.broadcast_to(xy[order], (n, len(times), 2))
    found = np.empty((n, len(times)))
    found[:, order] = draw_depths(np.random.default_rng([seed, 3]), depths, at, place)
    return found.mean(axis=0), found.std(axis=0)
