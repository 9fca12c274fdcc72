"""Rasters (GeoTIFF and whatever rasterio reads): numbers on a grid, and outlines of water."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maloc.errors import InputError, needs

__all__ = ["SUFFIXES", "Raster", "outlines", "read_raster"]

SUFFIXES = (".tif", ".tiff", ".asc", ".img", ".vrt")


class Raster(NamedTuple):
    """Values (H, W) as a masked array; affine transform (6,) of column, row; frame or None."""

    grid: np.ma.MaskedArray
    transform: tuple[float, float, float, float, float, float]
    crs: str | None


def read_raster(file: str | Path) -> Raster:
    """First band of a raster; cells without data are masked.

    Raises
    ------
    InputError
        If rasterio is not installed or cannot read the file.
    """
    rasterio = _rasterio(file)
    try:
        with rasterio.open(file) as data:
            crs = data.crs.to_string() if data.crs else None
            a, b, c, d, e, f, *_ = data.transform
            return Raster(data.read(1, masked=True), (a, b, c, d, e, f), crs)
    except rasterio.errors.RasterioError as problem:
        raise InputError(f"cannot be read as a raster: {problem}", file=file) from None


def outlines(raster: Raster, file: str | Path) -> list[list[np.ndarray]]:
    """Polygons of the water, along the cells' edges, each with its holes.

    Water is 1 where a raster holds 0 and 1 alone, and else what lies below 0, as elevations do.
    Cells without data are land.
    """
    _rasterio(file)
    shapes: Any = import_module("rasterio.features").shapes
    found = np.unique(raster.grid.compressed())
    wet = raster.grid == 1 if np.isin(found, (0, 1)).all() else raster.grid < 0
    wet = np.ma.filled(wet, False)
    affine = import_module("rasterio").Affine(*raster.transform)
    polygons = [part["coordinates"] for part, _ in shapes(wet.astype("uint8"), wet, 4, affine)]
    return [[np.asarray(ring, float)[:-1] for ring in polygon] for polygon in polygons]


def _rasterio(file: str | Path) -> Any:
    try:
        return import_module("rasterio")
    except ImportError as problem:
        raise needs("a raster", "rasterio", "terrain", problem, file=file) from None
