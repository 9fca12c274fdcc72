"""How deep the tag was: known, sensed, on the terrain, or to be found (Arnon et al. 2023, 2.4).

Depth counts down everywhere; a bird 30 m above sea level has depth -30.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.readers.raster import read_raster

__all__ = ["PLACES", "Depth", "Terrain", "depths", "read_terrain"]

PLACES = "flat", "auto", "sensor", "3d"


@dataclass(frozen=True, repr=False, eq=False)
class Terrain:
    """Elevation of the ground on a grid, and the tag's height above it.

    Parameters
    ----------
    elevation : array (rows, columns)
        Metres above the zero of the receivers' depths; NaN = unknown.
    transform : tuple of 6 float
        Affine a, b, c, d, e, f: x = a column + b row + c, y = d column + e row + f of a cell's
        upper left corner, as in GeoTIFF.
    crs : str, optional
        Frame of x, y; None: that of the receivers.
    above : float
        Height of the tag above the ground, m (0 for a pheasant, 30 for a bat).

    Raises
    ------
    InputError
        If the grid has fewer than two cells a side or the transform is singular.
    """

    elevation: np.ndarray
    transform: tuple[float, float, float, float, float, float]
    crs: str | None = None
    above: float = 0.0

    def __post_init__(self) -> None:
        grid = np.asarray(self.elevation, float)
        if grid.ndim != 2 or min(grid.shape) < 2:
            raise InputError(f"terrain must be a grid of 2 x 2 cells or more, got {grid.shape}")
        a, b, _, d, e, _ = self.transform
        if abs(a * e - b * d) == 0:
            raise InputError("terrain's transform is singular")
        object.__setattr__(self, "elevation", grid)

    def depth_at(self, xy: np.ndarray, crs: str | None = None) -> np.ndarray:
        """Depth (P,) of a tag `above` the ground at points (P, 2), bilinear; NaN off the grid.

        Parameters
        ----------
        xy : array (P, 2)
            Metres.
        crs : str, optional
            Frame of `xy`; None: the terrain's own.
        """
        x, y = np.asarray(xy, float).T
        if crs and self.crs and crs != self.crs:
            from pyproj import Transformer

            x, y = Transformer.from_crs(crs, self.crs, always_xy=True).transform(x, y)
        a, b, c, d, e, f = self.transform
        det = a * e - b * d
        # cell centres are half a cell in from the corner
        column = (e * (x - c) - b * (y - f)) / det - 0.5
        row = (-d * (x - c) + a * (y - f)) / det - 0.5
        rows, columns = self.elevation.shape
        ok = (column >= -0.5) & (column <= columns - 0.5) & (row >= -0.5) & (row <= rows - 0.5)
        i = np.clip(np.where(ok, np.floor(row), 0), 0, rows - 2).astype(int)
        j = np.clip(np.where(ok, np.floor(column), 0), 0, columns - 2).astype(int)
        u = np.clip(np.where(ok, row, 0) - i, 0, 1)
        v = np.clip(np.where(ok, column, 0) - j, 0, 1)
        g = self.elevation
        ground = (1 - u) * ((1 - v) * g[i, j] + v * g[i, j + 1])
        ground = ground + u * ((1 - v) * g[i + 1, j] + v * g[i + 1, j + 1])
        return np.where(ok, -(ground + self.above), np.nan)


def read_terrain(file: str | Path, above: float = 0.0) -> Terrain:
    """Read a digital elevation model (GeoTIFF or whatever rasterio reads).

    Parameters
    ----------
    file : path
        One band of elevations, m.
    above : float
        Height of the tag above the ground, m.

    Raises
    ------
    InputError
        If rasterio is not installed or cannot read the file.
    """
    raster = read_raster(file)
    grid = np.ma.filled(raster.grid.astype(float), np.nan)
    return Terrain(grid, raster.transform, raster.crs, above)


Depth = Literal["auto", "flat", "sensor", "3d"] | float | np.ndarray | Terrain


def depths(toa: ArrivalTimes, depth: Any) -> tuple[np.ndarray, int]:
    """Receivers' depths below the tag (P, R) m, 0 where depths play no part; and d, 2 or 3.

    For d = 3 they are the receivers' own depths. Terrain gives the first of its two solves: the
    tag at the ground's mean depth at the receivers.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings, R columns.
    depth : "auto", "flat", "sensor", "3d", float, array (P,) or Terrain
        See `maloc.points.locate`.

    Raises
    ------
    InputError
        If a depth that is needed is not known.
    """
    own = np.asarray(toa.receivers.depth, float)
    shape = toa.toa.shape
    if isinstance(depth, str) and depth not in PLACES:
        raise InputError(f"depth '{depth}' is none of {', '.join(PLACES)}, a number or Terrain")
    sensed = np.full(shape[0], np.nan) if toa.depth is None else toa.depth
    if isinstance(depth, str) and depth in ("flat", "auto"):
        below = own[None] - sensed[:, None]
        known = np.isfinite(below).all(axis=1, keepdims=True) & (depth == "auto")
        return np.where(known, below, 0.0), 2
    if np.isnan(own).any():
        name = str(toa.receivers.receiver[np.isnan(own)][0])
        raise InputError(
            f"receiver {name} has no depth, which depth={_said(depth)} needs",
            mend="add it to the table, or use depth='flat'",
        )
    if isinstance(depth, str) and depth == "3d":
        return np.broadcast_to(own, shape), 3
    if isinstance(depth, Terrain):
        ground = depth.depth_at(toa.receivers.xy, toa.receivers.crs)
        if not np.isfinite(ground).any():
            raise InputError("the terrain does not cover the receivers", mend="check its frame")
        value: Any = float(np.nanmean(ground))
    else:
        value = sensed if isinstance(depth, str) else np.asarray(depth, float)
    tag = np.broadcast_to(value, shape[:1])
    if np.isnan(tag).any():
        n = int(np.isnan(tag).sum())
        raise InputError(f"the tag's depth is unknown at {n} of {len(tag)} pings")
    return own[None] - tag[:, None], 2


def _said(depth: Any) -> str:
    return repr(depth) if isinstance(depth, str | float | int) else type(depth).__name__
