"""A polygon that a tag cannot have left, read from a table of its corners."""

from __future__ import annotations

from pathlib import Path

import numpy as np

__all__ = ["read_region"]


def read_region(file: str | Path, crs: str | None = None) -> np.ndarray:
    """Read the corners of a polygon.

    Parameters
    ----------
    file : path
        A table with a row a corner, in order: columns x, y (m, in the receivers' frame) or
        longitude, latitude (degrees).
    crs : str, optional
        Frame of the receivers, into which degrees are projected.

    Returns
    -------
    array (V, 2)
        m; first and last corner are joined.

    Raises
    ------
    InputError
        If there are fewer than three corners, a coordinate is missing, or degrees have no frame.
    """
    from maloc.readers._columns import RECEIVER, find
    from maloc.readers._text import read_table

    table = read_table(file)
    roles = find(table.columns, RECEIVER, {"x", "y", "longitude", "latitude"})
    metres = {"x", "y"} <= roles.keys()
    if not (metres or {"longitude", "latitude"} <= roles.keys()):
        raise table.error(
            f"no corners; header: {', '.join(table.columns)}",
            mend="give columns 'x' and 'y' (m) or 'longitude' and 'latitude' (degrees)",
        )
    pair = ("x", "y") if metres else ("longitude", "latitude")
    corners = np.column_stack([table.numbers(roles[c]) for c in pair])
    gone = np.flatnonzero(np.isnan(corners).any(axis=1))
    if len(gone):
        raise table.error("a corner's coordinate is missing", int(gone[0]))
    if not metres:
        if crs is None:
            raise table.error(
                "corners in degrees, but the receivers' frame is not known",
                mend="name it with --crs, or give x and y",
            )
        from pyproj import Transformer

        to_metres = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        corners = np.column_stack(to_metres.transform(*corners.T))
    if len(corners) > 1 and (corners[0] == corners[-1]).all():
        corners = corners[:-1]
    if len(corners) < 3:
        raise table.error(f"{len(corners)} corners: a polygon has three or more")
    return corners
