"""Polygons from GeoJSON, or the water of a raster, in the receivers' frame."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from maloc.errors import InputError
from maloc.readers.raster import SUFFIXES, outlines, read_raster

__all__ = ["read_polygons"]


def read_polygons(file: str | Path, crs: str | None = None) -> list[list[np.ndarray]]:
    """Read polygons with their holes from GeoJSON, or those of a raster's water.

    Parameters
    ----------
    file : path
        A geometry, a feature or a collection of them; polygons and multipolygons are taken.
        Longitude and latitude, as GeoJSON has them, or the frame that its member ``crs`` names.
        Or a raster (.tif and others): of 0 and 1, the water, or of elevations, water below 0;
        cells without data are land.
    crs : str, optional
        Frame to put them in; None: a local frame, in which the file's numbers are metres.

    Returns
    -------
    list of lists of (V, 2) arrays
        Each polygon's outline, then its holes.

    Raises
    ------
    InputError
        If it can't be read, or there is no polygon in it.
    """
    path = Path(file)
    rings, own = (_raster if path.suffix.lower() in SUFFIXES else _geojson)(path)
    if not rings:
        raise InputError("holds no polygon", file=path, mend="give an outline as one")
    if crs is None or own is None or own == crs:
        return rings
    from pyproj import Transformer

    change = Transformer.from_crs(own, crs, always_xy=True)
    return [[np.column_stack(change.transform(*r.T)) for r in polygon] for polygon in rings]


def _raster(path: Path) -> tuple[list[list[np.ndarray]], str | None]:
    found = read_raster(path)
    return outlines(found, path), found.crs


def _geojson(path: Path) -> tuple[list[list[np.ndarray]], str]:
    try:
        read = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, ValueError) as problem:
        raise InputError(f"is no GeoJSON: {problem}", file=path) from None
    return [[_ring(r, path) for r in polygon] for polygon in _polygons(read)], _frame(read)


def _polygons(read: Any) -> list:
    """Coordinates of all polygons below a GeoJSON object."""
    if not isinstance(read, dict):
        return []
    kind = read.get("type")
    if kind == "Polygon":
        return [read["coordinates"]]
    if kind == "MultiPolygon":
        return list(read["coordinates"])
    if kind == "Feature":
        return _polygons(read.get("geometry"))
    inner = read.get("features") or read.get("geometries") or []
    return [polygon for part in inner for polygon in _polygons(part)]


def _ring(corners: Any, path: Path) -> np.ndarray:
    try:
        ring = np.array([[float(c[0]), float(c[1])] for c in corners])
    except (TypeError, ValueError, IndexError):
        raise InputError("a corner of a polygon is no pair of numbers", file=path) from None
    if not np.isfinite(ring).all():
        raise InputError("a corner of a polygon is not finite", file=path)
    return ring[:-1] if len(ring) > 1 and (ring[0] == ring[-1]).all() else ring


def _frame(read: dict) -> str:
    named = (read.get("crs") or {}).get("properties", {}).get("name", "")
    return "EPSG:4326" if not named or named.upper().endswith("CRS84") else named
