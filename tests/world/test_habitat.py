"""Distance to the shore, and tracks that keep off the land."""

import json
from typing import Any

import numpy as np
import polars as pl
import pytest
import shapely

import maloc
from maloc._jax import jax
from maloc.errors import InputError
from maloc.models import toa_track
from maloc.readers.polygons import read_polygons
from maloc.world.habitat import read_water, water

LAKE = np.array([[0.0, 0], [300, 0], [300, 200], [160, 240], [0, 200]])
ISLAND = np.array([[120.0, 80], [180, 80], [180, 130], [120, 130]])
SHAPE = shapely.Polygon(LAKE, [ISLAND])
HOW: dict[str, Any] = {
    "movement": "ctcrw",
    "error": "ddetect",
    "sound_speed": "auto",
}  # the command's: compiled once


@pytest.fixture(scope="module")
def lake():
    return water([[LAKE, ISLAND]])


def signed(xy):
    at = shapely.points(xy)
    away = shapely.distance(SHAPE.boundary, at)
    return np.where(shapely.contains(SHAPE, at), away, -away)


def test_distance_is_the_polygons(lake):
    """Within a tenth of the grid's step, but at corners and on the ridges between shores."""
    xy = np.random.default_rng(0).uniform([-30, -30], [330, 270], (2000, 2))
    off = np.abs(lake.distance(xy) - signed(xy))
    assert np.quantile(off, 0.9) < 0.05
    assert off.max() < 1.0


def test_distance_is_smooth_and_falls_beyond_the_grid(lake):
    xy = np.random.default_rng(1).uniform(0, 200, (50, 2))
    slope = jax.jit(jax.vmap(jax.grad(lake.distance)))(xy)
    for axis in (0, 1):
        step = 1e-5 * np.eye(2)[axis][None]
        wanted = (lake.distance(xy + step) - lake.distance(xy - step)) / 2e-5
        np.testing.assert_allclose(slope[:, axis], wanted, atol=1e-5)
    far = lake.distance(np.array([[-1000.0, 100], [-2000.0, 100]]))
    assert float(far[0] - far[1]) == pytest.approx(1000.0, abs=1e-3)


def test_nothing_stays_on_land(lake):
    xy = np.random.default_rng(2).uniform([-40, -40], [340, 280], (3000, 2))
    moved = lake.off_land(xy)
    before, after = signed(xy), signed(moved)
    assert (before < -5).sum() > 500
    assert after[before > -5].min() > -0.3
    assert (after < -0.3).mean() < 0.005  # on the island's ridges two shores are as near
    assert after.min() > -5
    deep = before > 8
    np.testing.assert_allclose(moved[deep], xy[deep], atol=0.05)


def test_polygons_are_read_in_the_receivers_frame(tmp_path):
    from pyproj import Transformer

    corners = np.array([[500000.0, 6e6], [500300, 6e6], [500300, 6000200], [500000, 6000200]])
    to_degrees = Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    ring = [list(to_degrees.transform(*c)) for c in [*corners, corners[0]]]
    feature = {"type": "Feature", "geometry": {"type": "MultiPolygon", "coordinates": [[ring]]}}
    path = tmp_path / "lake.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    (found,) = read_polygons(path, "EPSG:32632")
    np.testing.assert_allclose(found[0], corners, atol=0.01)
    path.write_text(json.dumps({"type": "Polygon", "coordinates": [corners.tolist()]}))
    (local,) = read_polygons(path)
    np.testing.assert_array_equal(local[0], corners)


@pytest.mark.parametrize("kind", ["mask", "elevation"])
def test_water_of_a_raster(tmp_path, kind):
    """A lake with an island and a cell without data: its area, holes and frame."""
    rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed")
    wet = np.zeros((20, 30), bool)
    wet[2:18, 3:27] = True
    wet[8:11, 10:15] = False
    grid = wet.astype("uint8") if kind == "mask" else np.where(wet, -3.5, 2.0)
    grid[5, 20] = 255
    how = {"driver": "GTiff", "height": 20, "width": 30, "count": 1, "dtype": grid.dtype}
    how |= {"crs": "EPSG:32632", "nodata": 255, "transform": rasterio.Affine(5, 0, 500, 0, -5, 6e6)}
    path = tmp_path / "lake.tif"
    with rasterio.open(path, "w", **how) as file:
        file.write(grid, 1)
    (found,) = read_polygons(path, "EPSG:32632")
    shape = shapely.Polygon(found[0], found[1:])
    assert len(found) == 3
    assert shape.area == 25 * (16 * 24 - 15 - 1)
    assert shape.bounds == (515.0, 6e6 - 90, 635.0, 6e6 - 10)
    assert not shape.contains(shapely.Point(500 + 5 * 20.5, 6e6 - 5 * 5.5))
    (degrees,) = read_polygons(path, "EPSG:4326")
    assert len(degrees[0]) == len(found[0]) and np.abs(degrees[0][:, 0]).max() < 10
    path.write_text("no raster")
    with pytest.raises(InputError, match="cannot be read as a raster"):
        read_polygons(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no json", "is no GeoJSON"),
        ('{"type": "Point", "coordinates": [1, 2]}', "holds no polygon"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [1, "x"], [1, 1]]]}', "no pair of numbers"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}', "fewer than three corners"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9]]]}', "stand on land, R1"),
    ],
)
def test_bad_water_is_one_line(tmp_path, text, said):
    path = tmp_path / "water.geojson"
    path.write_text(text)
    receivers = maloc.Receivers(np.array(["R0", "R1"]), np.array([5.0, 90]), np.array([1.0, 90]))
    with pytest.raises(InputError, match=said):
        read_water(path, receivers)


def along_the_shore(seed=0, pings=24):
    """A tag that follows the south shore, 2 m off it, heard by three receivers."""
    rng = np.random.default_rng(seed)
    xy = np.array([[20.0, 15], [90, 70], [150, 10], [230, 70], [285, 15], [150, 190]])
    sent = 25.0 * np.arange(pings)
    path = np.column_stack([30 + 10.0 * np.arange(pings), np.full(pings, 2.0)])
    away = np.linalg.norm(path[:, None] - xy, axis=2)
    nearest = np.argsort(away, axis=1)[:, :3]
    heard = np.zeros(away.shape, bool)
    np.put_along_axis(heard, nearest, True, axis=1)
    heard[7] = False
    arrival = sent[:, None] + (away + rng.normal(0, 8.0, away.shape)) / 1480.0
    receivers = maloc.Receivers(np.array([f"R{i}" for i in range(6)]), xy[:, 0], xy[:, 1])
    toa = maloc.ArrivalTimes(
        np.where(heard, arrival, np.nan), receivers, np.asarray(1480.0),
        schedule=maloc.Schedule("random", 20.0, 30.0),
    )  # fmt: skip
    return toa, path


@pytest.fixture(scope="module")
def fitted(lake):
    toa, path = along_the_shore()
    return toa, path, maloc.infer.laplace(toa_track, toa, lake, **HOW)


def test_a_track_keeps_off_the_land(fitted, lake):
    toa, path, fit = fitted
    bare = maloc.infer.laplace(toa_track, toa, **HOW)
    wild = signed(bare.draws()["position"].reshape(-1, 2))
    assert (wild < -5).mean() > 0.05  # what arrival times alone allow
    draws = fit.draws()["position"][0]
    land = signed(draws.reshape(-1, 2))
    assert (land < -5).mean() < 0.01
    mean, covariance, low, high = fit.positions()
    assert signed(mean).min() > -1.0
    truth = path[toa.n_heard > 0]
    assert ((low <= truth) & (truth <= high)).mean() > 0.85
    off, without = (np.linalg.norm(p - truth, axis=1).mean() for p in (mean, bare.positions()[0]))
    assert off < without


@pytest.mark.extended
def test_the_sampler_agrees(fitted):
    fit = fitted[2]
    sampled = maloc.infer.nuts(jax.random.key(0), fit, method="hmc", draws=300, progress=False)
    land = signed(sampled.draws()["position"].reshape(-1, 2))
    assert (land < -5).mean() < 0.01
    mean, covariance, _, _ = sampled.positions()
    assert signed(mean).min() > -1.0
    sd = np.sqrt(np.einsum("tii->ti", covariance))
    assert np.median(np.abs(mean - fit.positions()[0]) / sd) < 0.5


def test_predictions_keep_off_the_land(fitted):
    toa, path, fit = fitted
    times = np.linspace(0, 25.0 * 23, 200)
    found = fit.predict(times)
    assert signed(found.position).min() > -1.0
    tracks = fit.sample_tracks(times, n=50)
    assert (signed(tracks.position.reshape(-1, 2)) < -5).mean() < 0.01


def test_the_command(tmp_path, fitted):
    """``--water``, and a prediction from the folder."""
    from typer.testing import CliRunner

    from maloc.cli import app
    from maloc.predict import read_tracks

    toa, _, _ = fitted
    rings = [[c.tolist() for c in (*r, r[0])] for r in (LAKE, ISLAND)]
    (tmp_path / "lake.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": rings}))
    names, xy = toa.receivers.receiver, toa.receivers.xy
    places = [f"{n},{x},{y}" for n, (x, y) in zip(names, xy, strict=True)]
    (tmp_path / "receivers.csv").write_text("\n".join(["receiver,x,y", *places]) + "\n")
    rows = ["ping,sound_speed," + ",".join(names)]
    for i, row in enumerate(toa.toa):
        cells = ["" if np.isnan(a) else f"{a:.6f}" for a in row]
        rows.append(f"{i + 1},1480,{','.join(cells)}")
    (tmp_path / "toa.csv").write_text("\n".join(rows) + "\n")
    files = ["--toa", "toa.csv", "--receivers", "receivers.csv", "--water", "lake.geojson"]
    files = [f if f.startswith("-") else str(tmp_path / f) for f in files]
    out = tmp_path / "out"
    how = ["--interval", "20", "30", "--draws", "200", "--out", str(out)]
    result = CliRunner().invoke(app, ["track", *files, *how])
    assert result.exit_code == 0, result.output + result.stderr
    table = pl.read_csv(out / "track.csv")
    assert len(table) == 24
    assert signed(table.select("x", "y").to_numpy()).min() > -1.0
    (track,) = read_tracks(out)
    found = track.predict(np.linspace(*track.span, 100))
    assert signed(found.position).min() > -1.0


@pytest.mark.extended
def test_the_study_in_small(capsys):
    from simulations import shores

    shores.main(["--tracks", "1", "--pings", "24", "--missing", "0.5"])
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows] == ["shores", "without", "with", "ratio"]
    assert float(rows[2].split()[3]) < 1.0  # no posterior mean more than a metre inland
