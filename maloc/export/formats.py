"""Tracks as other programs read them: tables of `maloc track` or `maloc predict` written anew.

What is only known in longitude and latitude elsewhere (GeoJSON, GPX, Movebank) needs the frame of
the positions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from maloc.errors import InputError
from maloc.export import arrays, maps, tables
from maloc.export.finished import Finished, ellipse_axes, read_finished

__all__ = ["FORMATS", "Finished", "ellipse_axes", "read_finished", "write"]


class _Format(NamedTuple):
    """How a format is written, the usual ending of its file, what it is for."""

    writer: Callable[[Finished, Path], None]
    ending: str
    use: str


FORMATS = {
    "csv": _Format(tables.csv, ".csv", "the table as it is"),
    "parquet": _Format(tables.parquet, ".parquet", "the table with types"),
    "geojson": _Format(maps.geojson, ".geojson", "points in lon/lat: QGIS, web maps"),
    "ellipses": _Format(maps.ellipses, ".geojson", "95 % ellipses in lon/lat: QGIS"),
    "geoparquet": _Format(maps.geoparquet, ".parquet", "points in the run's own frame"),
    "gpx": _Format(maps.gpx, ".gpx", "tracks in lon/lat"),
    "movebank": _Format(tables.movebank, ".csv", "Movebank's import"),
    "crawl": _Format(tables.crawl, ".csv", "crawl, momentuHMM, aniMotum; error ellipses"),
    "imputations": _Format(tables.imputations, ".csv", "whole tracks, for MIfitHMM"),
    "netcdf": _Format(arrays.netcdf, ".nc", "arrays, whole tracks too"),
    "zarr": _Format(arrays.zarr, ".zarr", "the same in Zarr"),
}


def write(run: Finished, path: str | Path, to: str) -> None:
    """Write a finished run in one of `FORMATS`.

    Parameters
    ----------
    run : Finished
    path : path
        File to write (a folder for "zarr").
    to : str
        Format.

    Raises
    ------
    InputError
        If the format is none of them, or needs what the run does not know: longitude and latitude,
        dates, whole tracks; or a library that is not installed.
    """
    if to not in FORMATS:
        raise InputError(f"'{to}' is none of {', '.join(FORMATS)}")
    FORMATS[to].writer(run, Path(path))
