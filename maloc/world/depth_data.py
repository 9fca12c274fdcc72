"""Depths as the models see them: receivers', what the tag's sensor said, and the bottom's."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Bool, Float

from maloc._jax import jax
from maloc.data.water_column import WaterColumn
from maloc.errors import InputError
from maloc.world.ray import RayData, mean_slowness

if TYPE_CHECKING:
    from maloc.data.receivers import Receivers

Numbers = Array | np.ndarray

__all__ = ["DepthData", "depth_data"]

EXACT_SD = 0.05  # m; a sensor without error, where it has nothing to say at other pings
_FAR = 4.0  # sds that a sensed depth may lie below the bottom
_SHALLOW = 0.5  # m; water is nowhere shallower
_CELLS = 200  # of a bathymetry's longer side


@dataclass(frozen=True)
class DepthData:
    """Depths as the models see them: a pytree, `known` static.

    Attributes
    ----------
    receiver : (R,) m
        Receivers' depths.
    observed : (T,) m
        Sensed depths; 0 where there is none.
    sensed : (T,) bool
        Where there is one.
    sd : () m
        Error of the sensed ones.
    initial : (T,) m
        Sensed depths, linear in time in between; half the water where there is none.
    bottom : () m
        Depth of the water; with a grid its mean.
    grid : (H, W) m, optional
        Depth of the water at points of a grid, rows by y: weights of cubic B-splines.
    origin : (2,) m
        x, y of the grid's first point.
    step : () m
        From one point to the next.
    ray : RayData, optional
        Sound speed by depth; None: the same at all depths.
    known : bool
        Every depth is known exactly: there is nothing to be found.
    """

    receiver: Float[Numbers, " receiver"]
    observed: Float[Numbers, " state"]
    sensed: Bool[Numbers, " state"]
    sd: Float[Numbers, ""]
    initial: Float[Numbers, " state"]
    bottom: Float[Numbers, ""]
    grid: Float[Numbers, "row column"] | None
    origin: Float[Numbers, 2]
    step: Float[Numbers, ""]
    ray: RayData | None = None
    known: bool = False

    def square(self, depth):
        """Squared vertical distances (T, R), m2, from depths (T,) to the receivers."""
        return (depth[:, None] - self.receiver[None]) ** 2

    def slowness(self, depth):
        """Mean 1 / c from depths (T,) to the receivers over the reference's, (T, R) or 1."""
        return 1.0 if self.ray is None else mean_slowness(self.ray, depth, self.receiver)


jax.tree_util.register_dataclass(
    DepthData,
    data_fields=[f.name for f in dataclasses.fields(DepthData) if f.name != "known"],
    meta_fields=["known"],
)


def depth_data(
    column: WaterColumn | None,
    receivers: Receivers,
    sensed: np.ndarray | None,
    time: np.ndarray,
    tag: np.ndarray | None = None,
    more: int = 0,
    wider: int = 0,
    ray: RayData | None = None,
) -> DepthData | None:
    """Depths of T states; None where the track is flat.

    Parameters
    ----------
    column : WaterColumn or None
    receivers : Receivers
        R deployments.
    sensed : (T,) array, optional
        Tag's depths, m; NaN = none.
    time : (T,) array
        s.
    tag : (T,) array of int, optional
        Whose state each one is.
    more, wider : int
        States and receivers to pad with.
    ray : RayData, optional
        Sound speed by depth, of all states with the padding.

    Raises
    ------
    InputError
        If a receiver has no depth, or a sensed depth lies below the bottom.
    """
    if column is None:
        return None
    own = np.asarray(receivers.depth, float)
    if not np.isfinite(own).all():
        name = receivers.receiver[np.flatnonzero(~np.isfinite(own))[0]]
        raise InputError(
            f"receiver {name} has no depth, which a track with depth needs",
            mend="add it to the table of receivers",
        )
    seen = np.full(len(time), np.nan) if sensed is None else np.asarray(sensed, float)
    here = np.isfinite(seen)
    sd = float(column.sensor_sd)
    deepest = float(np.max(seen[here], initial=0.0))
    grid, origin, step = _grid(column.bottom, receivers)
    if grid is not None:
        bottom = float(grid.mean())
    elif column.bottom is None:
        bottom = max(float(own.max()), deepest + 2 * sd, _SHALLOW)
    else:
        bottom = float(column.bottom)
        if deepest > bottom + _FAR * sd:
            raise InputError(
                f"the tag was at {deepest:g} m by its sensor, below the bottom at {bottom:g} m",
                mend="give a deeper bottom, or a larger error of the sensor",
            )
    whose = np.zeros(len(time), int) if tag is None else tag
    known = sd == 0 and all(_settled(seen[whose == one]) for one in np.unique(whose))
    initial = _between(seen, time, whose, 0.5 * bottom)
    along = (0, more)
    return DepthData(
        receiver=np.pad(own, (0, wider), constant_values=own.mean()),
        observed=np.pad(initial if known else np.where(here, seen, 0.0), along, mode="edge"),
        sensed=np.pad(here, along),
        sd=np.asarray(sd or EXACT_SD),
        initial=np.pad(initial, along, mode="edge"),
        bottom=np.asarray(bottom),
        grid=grid,
        origin=origin,
        step=np.asarray(step),
        ray=ray,
        known=known,
    )


def _settled(seen: np.ndarray) -> bool:
    """Whether exact depths (T,) of a tag, NaN = none, leave nothing open: all, or always one."""
    here = seen[np.isfinite(seen)]
    return len(here) == len(seen) or (len(here) > 0 and float(np.ptp(here)) == 0.0)


def _between(seen: np.ndarray, time: np.ndarray, whose: np.ndarray, else_: float):
    """Sensed depths (T,), linear in time in between; ``else_`` for a tag that has none."""
    out = np.full(len(seen), else_)
    for one in np.unique(whose):
        mine = whose == one
        rows = np.flatnonzero(mine & np.isfinite(seen))
        if len(rows):
            out[mine] = np.interp(time[mine], time[rows], seen[rows])
    return out


def _grid(bottom: Any, receivers: Receivers) -> tuple[np.ndarray | None, np.ndarray, float]:
    """Depth of the water on a grid about the receivers, m; its first point, and step."""
    if not hasattr(bottom, "depth_at"):
        return None, np.zeros(2), 1.0
    low, high = receivers.xy.min(axis=0), receivers.xy.max(axis=0)
    margin = 0.5 * float(np.max(high - low)) + 100.0
    low, high = low - margin, high + margin
    step = float(np.max(high - low)) / _CELLS
    x, y = (np.arange(a, b + step, step) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    depth = bottom.depth_at(points.reshape(-1, 2), receivers.crs).reshape(len(y), len(x))
    if not np.isfinite(bottom.depth_at(receivers.xy, receivers.crs)).all():
        raise InputError("the bathymetry does not reach all receivers")
    depth = np.where(np.isfinite(depth), depth, np.nanmean(depth))
    return np.maximum(depth, _SHALLOW), low, step
