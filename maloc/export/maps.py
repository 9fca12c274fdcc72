"""Exports that are maps: GeoJSON, GeoParquet, GPX."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from maloc.data._limits import CHI95
from maloc.errors import InputError, needs
from maloc.export.finished import Finished, degrees, ellipse_axes, typed

if TYPE_CHECKING:
    import polars as pl

__all__ = ["ellipses", "geojson", "geoparquet", "gpx"]

_CORNERS = 36  # of an ellipse drawn as a polygon


def _properties(table: pl.DataFrame) -> list[dict[str, Any]]:
    kept = [c for c in table.columns if c not in ("longitude", "latitude")]
    return table.select(kept).to_dicts()


def _collection(features: list[dict[str, Any]], path: Path) -> None:
    text = json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False)
    path.write_text(text + "\n", "utf-8")


def geojson(run: Finished, path: Path) -> None:
    """A point a row, in longitude and latitude (RFC 7946)."""
    import polars.selectors as cs

    table = run.table.with_columns(cs.float().fill_nan(None))
    places = np.round(np.column_stack(degrees(table, "geojson")), 8).tolist()
    _collection(
        [
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": at}, "properties": row}
            for at, row in zip(places, _properties(table), strict=True)
        ],
        path,
    )


def ellipses(run: Finished, path: Path) -> None:
    """95 % ellipses as polygons, in longitude and latitude."""
    import polars.selectors as cs
    from pyproj import Transformer

    table = run.table.with_columns(cs.float().fill_nan(None))
    degrees(table, "ellipses")
    if run.crs is None:
        raise InputError("ellipses need the frame of x and y, and the folder does not name it")
    major, minor, bearing = ellipse_axes(table)
    angle = -2 * np.pi * np.arange(_CORNERS + 1) / _CORNERS  # counterclockwise, closed
    turn = np.radians(bearing)[:, None]
    along = np.sqrt(CHI95) * major[:, None] * np.cos(angle)
    across = np.sqrt(CHI95) * minor[:, None] * np.sin(angle)
    east = table["x"].to_numpy()[:, None] + along * np.sin(turn) + across * np.cos(turn)
    north = table["y"].to_numpy()[:, None] + along * np.cos(turn) - across * np.sin(turn)
    lon, lat = Transformer.from_crs(run.crs, "EPSG:4326", always_xy=True).transform(east, north)
    rings = np.round(np.stack([lon, lat], axis=-1), 8)
    rings[:, -1] = rings[:, 0]
    _collection(
        [
            {
                "type": "Feature",
                "geometry": {"type": "Polygon", "coordinates": [ring]},
                "properties": row,
            }
            for ring, row in zip(rings.tolist(), _properties(table), strict=True)
        ],
        path,
    )


def geoparquet(run: Finished, path: Path) -> None:
    """Points in the run's own frame, which the file names."""
    try:
        import geopandas
        import pandas as pd
        import pyarrow  # noqa: F401
    except ImportError as problem:
        raise needs("export to geoparquet", "GeoPandas and PyArrow", "geo", problem) from None

    table = typed(run.table)
    columns = {c: table[c].to_numpy() for c in table.columns if c != "time"}
    frame = pd.DataFrame(columns)
    if not table["time"].null_count():
        frame.insert(1, "time", pd.to_datetime(table["time"].to_numpy(), utc=True))
    points = geopandas.points_from_xy(table["x"].to_numpy(), table["y"].to_numpy())
    geopandas.GeoDataFrame(frame, geometry=points, crs=run.crs).to_parquet(path)


def gpx(run: Finished, path: Path) -> None:
    """GPX 1.1: a track a tag."""
    table = run.table
    lon, lat = degrees(table, "gpx")
    root = ElementTree.Element(
        "gpx", version="1.1", creator="maloc", xmlns="http://www.topografix.com/GPX/1/1"
    )
    tags, times = table["tag"].fill_null("").to_list(), table["time"].to_list()
    for tag in dict.fromkeys(tags):
        track = ElementTree.SubElement(root, "trk")
        ElementTree.SubElement(track, "name").text = tag or "track"
        segment = ElementTree.SubElement(track, "trkseg")
        for i in (i for i, t in enumerate(tags) if t == tag):
            at = {"lat": f"{lat[i]:.8f}", "lon": f"{lon[i]:.8f}"}
            point = ElementTree.SubElement(segment, "trkpt", at)
            if times[i] is not None:
                ElementTree.SubElement(point, "time").text = times[i]
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
