"""Where there is water: distances to the shore that have gradients, and a map off the land.

Both are worked out once, on a grid, from polygons with islands; between grid points they are cubic
B-splines, smooth enough for Newton steps and for Hamiltonian samplers.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float

from maloc._jax import jax, jnp

if TYPE_CHECKING:
    from maloc.data.receivers import Receivers

Numbers = Array | np.ndarray

__all__ = ["Water", "read_water", "water"]

_PIECE = 4096  # places that are looked up together
_FAR = 20.0  # m; a receiver so far inland is one too many


@dataclasses.dataclass(frozen=True)
class Water:
    """Distance to the shore, and the way off the land, on a grid: a pytree of arrays.

    Attributes
    ----------
    field : (3, H, W) m
        B-spline coefficients: signed distance to the nearest shore, positive in the water; steps
        in x and in y that lead off the land. Rows run in y.
    origin : (2,) m
        x and y of the first grid point.
    step : () m
        Grid step.
    soft : () m
        Over about this width the map off the land bends.
    """

    field: Float[Numbers, "3 row column"]
    origin: Float[Numbers, 2]
    step: Float[Numbers, ""]
    soft: Float[Numbers, ""]

    def distance(self, xy):
        """Signed distance to the shore (...) m at places (..., 2); negative on land.

        Beyond the grid it falls by the distance from it.
        """
        return self._look_up(xy)[..., 0]

    def off_land(self, xy):
        """Places (..., 2) moved across the shore so that none is on land.

        A place at signed distance d goes to distance s log(1 + exp(d / s)): far from the shore it
        stays, on land it comes to the nearest shore.
        """
        return xy + self._look_up(xy)[..., 1:]

    def _look_up(self, xy):
        flat = xy.reshape(-1, 2)
        if isinstance(xy, np.ndarray):  # in pieces of one size: compiled once
            pieces = [flat[i : i + _PIECE] for i in range(0, len(flat), _PIECE)]
            some = [np.asarray(_looked_up(self, _padded(p)))[: len(p)] for p in pieces]
            return np.concatenate([np.zeros((0, 3)), *some]).reshape(*xy.shape[:-1], 3)
        return jnp.reshape(jax.vmap(self._one)(flat), (*jnp.shape(xy)[:-1], 3))

    def _one(self, xy):
        """All three at one place (2,)."""
        field = jnp.asarray(self.field)
        rows, columns = field.shape[1:]
        at = (xy - self.origin) / self.step
        inside = jnp.clip(at, 0.0, jnp.array([columns - 1.0, rows - 1.0]))
        off = self.step * (inside - at)  # back onto the grid
        beyond = jnp.sqrt(jnp.sum(off**2) + 1e-12)
        return _spline(field, inside) + jnp.concatenate([-beyond[None], off])


jax.tree_util.register_dataclass(
    Water, data_fields=[f.name for f in dataclasses.fields(Water)], meta_fields=[]
)


@jax.jit
def _looked_up(water: Water, flat):
    return jax.vmap(water._one)(flat)


def _padded(flat: np.ndarray) -> np.ndarray:
    return np.concatenate([flat, np.zeros((_PIECE - len(flat), 2))])


def _spline(field, at):
    """Cubic B-splines (K,) of coefficients (K, H, W) at a fractional place: column, row."""
    rows, columns = field.shape[1:]
    low = jnp.clip(jnp.floor(at).astype(int), 0, jnp.array([columns - 2, rows - 2]))
    f = at - low
    weight = jnp.stack(
        [
            (1 - f) ** 3 / 6,
            (3 * f**3 - 6 * f**2 + 4) / 6,
            (-3 * f**3 + 3 * f**2 + 3 * f + 1) / 6,
            f**3 / 6,
        ]
    )
    near = jnp.arange(-1, 3)  # the outermost coefficients are mirrored, as SciPy's filter has them
    column, row = _mirror(low[0] + near, columns), _mirror(low[1] + near, rows)
    return weight[:, 1] @ field[:, row[:, None], column[None]] @ weight[:, 0]


def _mirror(index, n: int):
    index = jnp.abs(index)
    return jnp.where(index > n - 1, 2 * (n - 1) - index, index)


def water(
    polygons: list[list[np.ndarray]],
    *,
    step: float | None = None,
    margin: float = 50.0,
    soft: float | None = None,
) -> Water:
    """Distances to the shore of polygons of water.

    Parameters
    ----------
    polygons : list of lists of (V, 2) arrays
        Each polygon's outline, then its holes (islands); m, in the receivers' frame.
    step : float, optional
        Grid step, m. By default a 400th of the longer side, 1 m at least.
    margin : float
        The grid reaches this far (m) beyond the water.
    soft : float, optional
        Width (m) over which animals are kept off the shore. By default the grid's step.

    Returns
    -------
    Water

    Raises
    ------
    InputError
        If there is no polygon, or one has fewer than three corners or no area.

    Notes
    -----
    At the grid points distances are exact (shapely).
    """
    import shapely
    from scipy.ndimage import spline_filter

    from maloc.errors import InputError

    shapes = []
    for rings in polygons:
        if not rings or min(len(r) for r in rings) < 3:
            raise InputError("a polygon of water has fewer than three corners")
        shapes.append(shapely.Polygon(rings[0], rings[1:]))
    whole = shapely.union_all([shapely.make_valid(s) for s in shapes])
    if whole.is_empty or whole.area == 0:
        raise InputError("the polygons of water have no area")
    bounds = np.array(whole.bounds)
    size = bounds[2:] - bounds[:2] + 2 * margin
    step = max(1.0, float(size.max()) / 400) if step is None else step
    soft = step if soft is None else soft
    origin = bounds[:2] - margin - 0.137 * step  # shores are drawn along round numbers
    columns, rows = (np.ceil(size / step).astype(int) + 2).tolist()
    xy = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * step + origin
    places = np.asarray(shapely.points(xy))
    shapely.prepare(whole)
    foot = shapely.get_coordinates(shapely.shortest_line(whole.boundary, places.ravel()))
    away = xy - foot[::2].reshape(xy.shape)
    length = np.linalg.norm(away, axis=-1)
    sign = np.where(shapely.contains(whole, places), 1.0, -1.0)
    signed = sign * length
    push = soft * np.logaddexp(0.0, signed / soft) - signed
    off = (push * sign / np.maximum(length, 1e-9))[..., None] * away
    field = np.stack([signed, off[..., 0], off[..., 1]])
    smooth = np.stack([spline_filter(f, 3, mode="mirror") for f in field])
    return jax.device_put(Water(smooth, origin, np.asarray(float(step)), np.asarray(float(soft))))


def read_water(file: str | Path, receivers: Receivers, **how: Any) -> Water:
    """Read polygons of water, and work out distances to the shore around the receivers.

    Parameters
    ----------
    file : path
        GeoJSON, or a raster of water or of elevations, see `maloc.readers.polygons.read_polygons`.
    receivers : Receivers
        In whose frame.
    **how
        Options of `water`: step, margin, soft.

    Returns
    -------
    Water

    Raises
    ------
    InputError
        If the file holds no polygon, or a receiver stands more than 20 m inland of it.
    """
    from maloc.errors import InputError
    from maloc.readers.polygons import read_polygons

    found = water(read_polygons(file, receivers.crs), **how)
    inland = -np.asarray(found.distance(receivers.xy))
    if (wrong := np.flatnonzero(inland > _FAR)).size:
        raise InputError(
            f"{wrong.size} of {len(receivers)} receivers stand on land, "
            f"{receivers.receiver[wrong[0]]} {inland[wrong[0]]:.0f} m from the water",
            file=file,
            mend="give the water, not the land, in the receivers' frame or in degrees",
        )
    return found
