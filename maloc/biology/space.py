"""Where an animal spent its time: in an area, and over a map."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc.biology.estimate import Estimate, summarise
from maloc.errors import InputError
from maloc.infer.predict import TrackDraws

__all__ = ["Residence", "Utilisation", "inside", "residence", "utilisation"]

_MOST = 20_000_000  # cells of all draws together


class Residence(NamedTuple):
    """Time in an area.

    Attributes
    ----------
    seconds : Estimate ()
        Time spent inside.
    visits : Estimate ()
        How often the animal was there: stretches of times inside.
    probability : (n,) array
        Posterior probability of being inside at each time.
    """

    seconds: Estimate
    visits: Estimate
    probability: np.ndarray


class Utilisation(NamedTuple):
    """Shares of time over a grid of cells.

    Attributes
    ----------
    x_edges : (nx + 1,) array
    y_edges : (ny + 1,) array
        m.
    share : Estimate (ny, nx)
        Share of the time in each cell; the shares of a draw add up to what it spent on the grid.
    """

    x_edges: np.ndarray
    y_edges: np.ndarray
    share: Estimate

    def area(self, share: float = 0.95, level: float = 0.95) -> Estimate:
        """Area of the cells most used that hold a share of the time on the grid, m2, ()."""
        flat = -np.sort(-self.share.draws.reshape(len(self.share.draws), -1), axis=1)
        held = np.cumsum(flat, axis=1) / flat.sum(axis=1, keepdims=True)
        cells = (held < share - 1e-12).sum(axis=1) + 1
        size = np.diff(self.x_edges)[0] * np.diff(self.y_edges)[0]
        return summarise(cells * size, level)


def inside(position: np.ndarray, area: Any) -> np.ndarray:
    """Which positions (..., 2) lie in an area, (...) bool.

    Parameters
    ----------
    position : (..., 2) array
        m.
    area : (V, 2) array, or a polygon
        Corners of a simple polygon (m, the frame of the track); or anything with
        ``__geo_interface__`` (a Shapely geometry, with holes and parts), or the geometry of a
        GeoJSON file as a dict.

    Raises
    ------
    InputError
        If it is no polygon.
    """
    import shapely
    from shapely.geometry import Polygon, shape

    flat = np.asarray(position, float).reshape(-1, 2)
    if isinstance(area, dict) or hasattr(area, "__geo_interface__"):
        geometry = shape(area)
        if geometry.geom_type not in ("Polygon", "MultiPolygon"):
            raise InputError(f"an area is a polygon, not a {geometry.geom_type}")
    else:
        corners = np.asarray(area, float)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise InputError(f"an area has three corners (V, 2) or more, not {corners.shape}")
        geometry = Polygon(corners)
    found = shapely.contains_xy(geometry, flat[:, 0], flat[:, 1])
    return np.asarray(found).reshape(np.shape(position)[:-1])


def residence(tracks: TrackDraws, area: Any, level: float = 0.95) -> Residence:
    """Time spent in an area.

    Parameters
    ----------
    tracks : TrackDraws
        At times close enough that the animal does not cross the area between two.
    area : (V, 2) array, or a polygon
        See `inside`.
    level : float
        Probability of the intervals.

    Returns
    -------
    Residence

    Notes
    -----
    A time stands for half the way to its neighbours on either side.
    """
    within = inside(tracks.position, area)
    seconds = within @ _weights(tracks.times)
    entered = within[:, :1].sum(axis=1) + (within[:, 1:] & ~within[:, :-1]).sum(axis=1)
    return Residence(summarise(seconds, level), summarise(entered, level), within.mean(axis=0))


def utilisation(
    tracks: TrackDraws,
    cell: float,
    extent: tuple[float, float, float, float] | None = None,
    bandwidth: float = 0.0,
    level: float = 0.95,
) -> Utilisation:
    """Utilisation distribution: the share of time in each cell of a grid.

    Parameters
    ----------
    tracks : TrackDraws
        At times close enough that the animal does not cross a cell between two, or with a
        bandwidth that bridges the steps.
    cell : float
        Side of a cell, m.
    extent : tuple (x_min, x_max, y_min, y_max), optional
        m; by default all that any draw reaches, and four bandwidths more.
    bandwidth : float
        Standard deviation of a normal kernel laid over each draw's map, m; 0 for none. The
        uncertainty of positions is in the draws and needs no kernel: it only smooths over time.
    level : float
        Probability of the intervals.

    Returns
    -------
    Utilisation

    Raises
    ------
    InputError
        If the cell is not positive, or the grid too fine to hold in memory.
    """
    if not cell > 0 or bandwidth < 0:
        raise InputError("cell is a length in m, and so is bandwidth")
    xy = tracks.position
    if extent is None:
        low, high = xy.min(axis=(0, 1)) - 4 * bandwidth, xy.max(axis=(0, 1)) + 4 * bandwidth
        extent = (low[0], high[0], low[1], high[1])
    x_edges, y_edges = _edges(*extent[:2], cell), _edges(*extent[2:], cell)
    shape = (len(y_edges) - 1, len(x_edges) - 1)
    if len(xy) * shape[0] * shape[1] > _MOST:
        raise InputError(
            f"{len(xy)} draws of {shape[0]} x {shape[1]} cells are too many", mend="larger cells"
        )
    column = np.floor((xy[..., 0] - x_edges[0]) / cell).astype(int)
    row = np.floor((xy[..., 1] - y_edges[0]) / cell).astype(int)
    on_grid = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    weight = _weights(tracks.times) / (tracks.times[-1] - tracks.times[0])
    share = np.zeros((len(xy), *shape))
    draw, time = np.nonzero(on_grid)
    np.add.at(share, (draw, row[on_grid], column[on_grid]), weight[time])
    if bandwidth:
        from scipy.ndimage import gaussian_filter

        share = gaussian_filter(share, bandwidth / cell, mode="constant", axes=(1, 2))
    return Utilisation(x_edges, y_edges, summarise(share, level))


def _weights(times: np.ndarray) -> np.ndarray:
    """Seconds that each time stands for."""
    if len(times) < 2:
        raise InputError("time spent needs two times or more")
    half = 0.5 * np.diff(times)
    return np.append(half, 0.0) + np.append(0.0, half)


def _edges(low: float, high: float, cell: float) -> np.ndarray:
    """Whole multiples of the cell around [low, high]."""
    first, last = np.floor(low / cell), np.floor(high / cell) + 1
    return cell * np.arange(first, last + 1)
