"""Exports read back by something else: GeoPandas, xarray, an XML parser, crawl's own formula."""

import json
from xml.etree import ElementTree

import numpy as np
import polars as pl
import pytest
import xarray as xr

from maloc.errors import InputError
from maloc.export import FORMATS, Finished, ellipse_axes, read_finished, write
from maloc.export.file import export_file

CRS = "EPSG:32632"
COVARIANCE = np.array([[9.0, 2.0], [2.0, 4.0]])


def table(dated=True, frame=True):
    """Two tags of three rows each, near 9 E 46 N."""
    x, y = 500_000.0 + np.arange(6.0) * 10, 5_094_000.0 + np.arange(6.0)
    columns = {
        "tag": ["A"] * 3 + ["B"] * 3,
        "time": [f"2026-03-01T12:00:{s:02d}.250000Z" if dated else None for s in range(6)],
        "t": 1.7e9 + np.arange(6.0),
        "x": x,
        "y": y,
        "sd_x": np.full(6, 3.0),
        "sd_y": np.full(6, 2.0),
        "cov_xy": np.full(6, 2.0),
        "heard": [True, False] * 3,
    }
    if frame:
        from pyproj import Transformer

        degrees = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
        columns["longitude"], columns["latitude"] = degrees.transform(x, y)
    return pl.DataFrame(columns, schema_overrides={"time": pl.String})


def drawn():
    rows = [(tag, draw, i) for tag in "AB" for draw in (1, 2) for i in range(3)]
    return pl.DataFrame(
        {
            "tag": [r[0] for r in rows],
            "draw": [r[1] for r in rows],
            "time": pl.Series([1_772_366_400_000_000_000] * 12).cast(pl.Datetime("ns", "UTC")),
            "t": [float(r[2]) for r in rows],
            "x": np.arange(12.0),
            "y": -np.arange(12.0),
        }
    )


@pytest.fixture(scope="module")
def finished():
    return Finished(table(), CRS, drawn())


def put(finished, tmp_path, to):
    path = tmp_path / f"out{FORMATS[to].ending}"
    write(finished, path, to)
    return path


def test_axes_of_ellipses():
    """Against the eigenvectors' defining equation, and by compass on known cases."""
    major, minor, bearing = ellipse_axes(table())
    turn = np.radians(bearing[0])
    axis = np.array([np.sin(turn), np.cos(turn)])
    np.testing.assert_allclose(COVARIANCE @ axis, major[0] ** 2 * axis, rtol=1e-12)
    np.testing.assert_allclose(major[0] * minor[0], np.sqrt(np.linalg.det(COVARIANCE)))
    east = table().with_columns(cov_xy=pl.lit(0.0))
    np.testing.assert_allclose(ellipse_axes(east)[2], 90.0)
    north = east.with_columns(sd_y=pl.lit(5.0))
    np.testing.assert_allclose(ellipse_axes(north)[2], 0.0)


def test_tables(finished, tmp_path):
    again = pl.read_csv(put(finished, tmp_path, "csv"))
    assert again.equals(finished.table)
    typed = pl.read_parquet(put(finished, tmp_path, "parquet"))
    assert typed["time"].dtype == pl.Datetime("us", "UTC")
    assert str(typed["time"][1]) == "2026-03-01 12:00:01.250000+00:00"
    assert typed.drop("time").equals(finished.table.drop("time"))


def test_movebank(finished, tmp_path):
    found = pl.read_csv(put(finished, tmp_path, "movebank"))
    assert found.columns == [
        "timestamp",
        "location-long",
        "location-lat",
        "location-error-numerical",
        "location-error-percentile",
        "sensor-type",
        "tag-local-identifier",
        "individual-local-identifier",
    ]
    assert found["timestamp"][0] == "2026-03-01 12:00:00.250"
    np.testing.assert_allclose(found["location-lat"], finished.table["latitude"], atol=1e-8)
    major = np.sqrt(np.linalg.eigvalsh(COVARIANCE)[1])
    np.testing.assert_allclose(found["location-error-numerical"], 2.4477 * major, atol=1e-3)


def test_crawl_makes_our_covariance_of_our_ellipse(finished, tmp_path):
    found = pl.read_csv(put(finished, tmp_path, "crawl"))
    # what crawl::argosDiag2Cov and aniMotum make of smaj, smin, eor
    a, b, theta = (found[c].to_numpy() for c in ("smaj", "smin", "eor"))
    turn = np.radians(theta)
    xx = (a**2 * np.sin(turn) ** 2 + b**2 * np.cos(turn) ** 2) / 2
    yy = (a**2 * np.cos(turn) ** 2 + b**2 * np.sin(turn) ** 2) / 2
    xy = (a**2 - b**2) / 2 * np.cos(turn) * np.sin(turn)
    np.testing.assert_allclose(xx, 9.0, rtol=1e-6)
    np.testing.assert_allclose(yy, 4.0, rtol=1e-6)
    np.testing.assert_allclose(xy, 2.0, rtol=1e-6)
    np.testing.assert_allclose(np.exp(found["ln.sd.x"]), 3.0, rtol=1e-6)
    np.testing.assert_allclose(found["error.corr"], 2.0 / 6.0, rtol=1e-6)
    assert ((theta >= 0) & (theta < 180)).all()


def test_imputations(finished, tmp_path):
    found = pl.read_csv(put(finished, tmp_path, "imputations"))
    assert found.columns == ["draw", "ID", "time", "t", "x", "y"]
    np.testing.assert_allclose(found["x"], finished.draws["x"])


def test_geojson(finished, tmp_path):
    found = json.loads(put(finished, tmp_path, "geojson").read_text())
    assert len(found["features"]) == 6
    place = found["features"][4]
    np.testing.assert_allclose(
        place["geometry"]["coordinates"],
        finished.table.select("longitude", "latitude").row(4),
        atol=1e-8,
    )
    assert place["properties"]["tag"] == "B" and place["properties"]["heard"] is True


def test_geoparquet_and_ellipses_in_geopandas(finished, tmp_path):
    geopandas = pytest.importorskip("geopandas")
    points = geopandas.read_parquet(put(finished, tmp_path, "geoparquet"))
    assert points.crs == CRS and len(points) == 6
    np.testing.assert_allclose(points.geometry.x, finished.table["x"])
    assert str(points["time"].dtype).startswith("datetime64")
    shapes = geopandas.read_file(put(finished, tmp_path, "ellipses")).to_crs(CRS)
    assert shapes.geometry.is_valid.all()
    want = np.pi * 5.9915 * np.sqrt(np.linalg.det(COVARIANCE))
    corners = 36 / (2 * np.pi) * np.sin(2 * np.pi / 36)  # a polygon holds a little less
    np.testing.assert_allclose(shapes.area, want * corners, rtol=2e-3)
    centre = shapes.geometry.centroid
    np.testing.assert_allclose(centre.y, finished.table["y"], atol=0.05)
    # longest along the major axis
    outline = np.array(shapes.geometry.iloc[0].exterior.coords) - [centre.x[0], centre.y[0]]
    far = outline[np.linalg.norm(outline, axis=1).argmax()]
    bearing = np.degrees(np.arctan2(far[0], far[1])) % 180
    np.testing.assert_allclose(bearing, ellipse_axes(finished.table)[2][0], atol=1.5)


def test_gpx(finished, tmp_path):
    root = ElementTree.parse(put(finished, tmp_path, "gpx")).getroot()
    space = {"g": "http://www.topografix.com/GPX/1/1"}
    assert [n.text for n in root.findall("g:trk/g:name", space)] == ["A", "B"]
    points = root.findall("g:trk/g:trkseg/g:trkpt", space)
    np.testing.assert_allclose(
        [float(p.attrib["lat"]) for p in points], finished.table["latitude"], atol=1e-8
    )
    times = [n.text for n in root.findall(".//g:time", space)]
    assert times == finished.table["time"].to_list()


@pytest.mark.parametrize("to", ["netcdf", "zarr"])
def test_arrays(finished, tmp_path, to):
    if to == "zarr":
        pytest.importorskip("zarr")
    path = put(finished, tmp_path, to)
    if to == "zarr":
        found = xr.open_zarr(path, consolidated=False)
    else:
        found = xr.open_dataset(path, engine="h5netcdf")
    with found:
        np.testing.assert_allclose(found["x"], finished.table["x"])
        assert found["x"].attrs["units"] == "m" and found.attrs["crs"] == CRS
        assert found["time"].values[1] == np.datetime64("2026-03-01T12:00:01.25")
        names = found["tag"].attrs["flag_meanings"].split()
        assert [names[i] for i in found["tag"].values] == ["A"] * 3 + ["B"] * 3
        # draw 2 of A, then draw 2 of B
        np.testing.assert_allclose(found["draw_x"].values[1], [3, 4, 5, 9, 10, 11])


def test_what_a_run_does_not_know_is_refused(tmp_path):
    local = Finished(table(frame=False), None, None)
    for to in ("geojson", "ellipses", "gpx", "movebank"):
        with pytest.raises(InputError, match="longitude and latitude"):
            put(local, tmp_path, to)
    undated = Finished(table(dated=False), CRS, None)
    for to in ("movebank", "crawl"):
        with pytest.raises(InputError, match="needs dates"):
            put(undated, tmp_path, to)
    with pytest.raises(InputError, match="whole tracks"):
        put(undated, tmp_path, "imputations")
    assert "<time>" not in put(undated, tmp_path, "gpx").read_text()
    with pytest.raises(InputError, match="none of csv"):
        write(undated, tmp_path / "x", "shapefile")


def test_the_command_writes_one_file_whole_or_not_at_all(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    table().write_csv(run / "track.csv")
    (run / "summary.json").write_text(json.dumps({"crs": CRS}))
    assert read_finished(run).crs == CRS
    out = tmp_path / "new" / "places.geojson"
    assert export_file(run, "geojson", out).startswith("6 rows")
    with pytest.raises(InputError, match="exists already"):
        export_file(run, "geojson", out)
    before = out.read_text()
    with pytest.raises(InputError, match="whole tracks"):
        export_file(run, "imputations", out, force=True)
    assert out.read_text() == before and len(list(out.parent.iterdir())) == 1
    export_file(run, "ellipses", out, force=True)
    assert out.read_text() != before
    with pytest.raises(InputError, match="none of csv"):
        export_file(run, "kml", tmp_path / "x")
    with pytest.raises(InputError, match="holds none of"):
        export_file(tmp_path / "new", "csv", tmp_path / "x")
    with pytest.raises(InputError, match="no Zarr store"):
        export_file(run, "zarr", tmp_path / "new", force=True)
    # points that were not located are counted, and left out
    points = tmp_path / "points"
    points.mkdir()
    lost = table().with_columns(x=pl.when(pl.col("t") < 1.7e9 + 2).then(None).otherwise("x"))
    lost.write_csv(points / "points.csv")
    assert "2 without a position left out" in export_file(points, "csv", tmp_path / "some.csv")
    lost.head(2).write_csv(points / "points.csv")
    with pytest.raises(InputError, match="no position"):
        export_file(points, "csv", tmp_path / "none.csv")
    # predicted.csv comes first, with the whole tracks beside it
    table().head(2).write_csv(run / "predicted.csv")
    drawn().write_parquet(run / "draws.parquet")
    found = read_finished(run)
    assert len(found.table) == 2 and found.draws is not None
