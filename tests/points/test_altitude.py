"""Depth four ways: fixed, sensed, on the terrain, to be found."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.points import locate
from maloc.points.altitude import Terrain, depths, read_terrain
from tests.points.arrays import arrivals, error, ring

DEEP = [0.0, 40, 5, 60, 10, 50, 20, 30]


def slope(above=0.0):
    """Ground that rises 1 m every 10 m eastwards, on 20 m cells from (-1000, 1000)."""
    x = -1000 + 20 * (np.arange(100) + 0.5)
    return Terrain(np.tile(x / 10, (100, 1)), (20.0, 0, -1000.0, 0, -20.0, 1000.0), above=above)


def pings(rng, deep, n=40, noise=0.0):
    receivers = ring(8, depth=DEEP)
    xy = rng.uniform(-300, 300, (n, 2))
    tag = deep(xy) if callable(deep) else np.full(n, deep)
    toa = arrivals(receivers, xy, depth=tag, noise=noise * rng.normal(size=(n, 8)))
    return toa, xy, tag


def test_known_depth_is_exact_and_flat_is_not():
    toa, xy, _ = pings(np.random.default_rng(1), 120.0)
    assert error(locate(toa, depth=120.0, sigma=0.1), xy).max() < 1e-3
    assert np.nanmax(error(locate(toa, depth="flat", sigma=0.1), xy)) > 1


def test_sensed_depth_is_used_where_there_is_one():
    toa, xy, tag = pings(np.random.default_rng(2), lambda xy: 50 + xy[:, 0] / 10)
    sensed = toa.replace(depth=tag)
    for how in ("auto", "sensor"):
        assert error(locate(sensed, depth=how, sigma=0.1), xy).max() < 1e-3
    some = toa.replace(depth=np.where(np.arange(40) < 20, tag, np.nan))
    below, d = depths(some, "auto")
    assert d == 2 and (below[20:] == 0).all() and (below[:20] != 0).any()
    with pytest.raises(InputError, match="depth is unknown at 20 of 40 pings"):
        locate(some, depth="sensor", sigma=0.1)


def test_space_is_found_with_receivers_at_several_depths():
    toa, xy, tag = pings(np.random.default_rng(3), lambda xy: 150 + xy[:, 1] / 10)
    points = locate(toa, depth="3d", sigma=0.1)
    truth = np.column_stack([xy, tag])
    either = np.fmin(
        np.linalg.norm(points.position - truth, axis=1),
        np.nan_to_num(np.linalg.norm(points.alternative - truth, axis=1), nan=np.inf),
    )
    assert points.position.shape == (40, 3)
    assert either.max() < 1e-2
    np.testing.assert_allclose(points.emission, 60.0 * np.arange(40), atol=1e-2)


def test_tag_on_the_ground_takes_two_solves():
    """The first at the ground's mean, the second where the first was: most of the error goes."""
    ground = slope(above=2.0)
    toa, xy, _ = pings(np.random.default_rng(4), lambda xy: -(xy[:, 0] / 10 + 2))
    once = error(locate(toa, depth=float(np.mean(-ground.elevation)) - 2, sigma=1.0), xy)
    twice = error(locate(toa, depth=ground, sigma=1.0), xy)
    assert np.median(twice) < np.median(once) / 5
    assert twice.max() < 0.5


def test_terrain_is_bilinear_between_cell_centres_and_open_outside():
    ground = slope()
    xy = np.array([[0.0, 0], [33.0, -77], [-985.0, 985], [2000.0, 0]])
    np.testing.assert_allclose(ground.depth_at(xy)[:3], -xy[:3, 0] / 10, atol=1e-9)
    assert np.isnan(ground.depth_at(xy)[3])
    np.testing.assert_allclose(slope(above=30.0).depth_at(xy)[0], -30)


def test_terrain_in_another_frame_is_projected():
    from pyproj import Transformer

    lonlat = Terrain(
        np.array([[10.0, 20.0], [10.0, 20.0]]), (0.1, 0, 5.0, 0, -0.1, 51.2), crs="EPSG:4326"
    )
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32631", always_xy=True).transform(5.1, 51.1)
    np.testing.assert_allclose(lonlat.depth_at(np.array([[x, y]]), "EPSG:32631"), -15, atol=1e-6)


def test_receivers_without_depth_are_named():
    receivers = ring(5, depth=[1.0, np.nan, 3, 4, 5])
    toa = arrivals(ring(5), np.full((2, 2), 10.0)).replace(receivers=receivers)
    for how in (3.0, "3d", "sensor", slope()):
        with pytest.raises(InputError, match="receiver R1 has no depth"):
            locate(toa, depth=how, sigma=1.0)
    with pytest.raises(InputError, match="depth 'deep' is none of"):
        locate(toa, depth="deep", sigma=1.0)  # pyright: ignore[reportArgumentType]


def test_terrain_elsewhere_is_refused():
    toa, _, _ = pings(np.random.default_rng(5), 0.0, n=2)
    far = Terrain(np.zeros((3, 3)), (1.0, 0, 9e6, 0, -1.0, 9e6))
    with pytest.raises(InputError, match="does not cover the receivers"):
        locate(toa, depth=far, sigma=1.0)
    with pytest.raises(InputError, match="grid of 2 x 2"):
        Terrain(np.zeros((1, 3)), (1.0, 0, 0, 0, -1.0, 0))
    with pytest.raises(InputError, match="singular"):
        Terrain(np.zeros((3, 3)), (0.0, 0, 0, 0, -1.0, 0))


def test_reading_terrain_needs_rasterio(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match=r'pip install "maloc\[terrain\]"'):
        read_terrain(tmp_path / "dem.tif")


@pytest.mark.skipif(find_spec("rasterio") is None, reason="rasterio is not installed")
def test_geotiff_is_read_as_written(tmp_path):
    import rasterio  # pyright: ignore[reportMissingImports]

    want = slope()
    grid = want.elevation.copy()
    grid[0, 0] = -9999
    with rasterio.open(
        tmp_path / "dem.tif",
        "w",
        driver="GTiff",
        height=100,
        width=100,
        count=1,
        dtype="float64",
        crs="EPSG:32631",
        nodata=-9999,
        transform=rasterio.Affine(*want.transform),
    ) as file:
        file.write(grid, 1)
    got = read_terrain(tmp_path / "dem.tif", above=30.0)
    assert (got.crs, got.above, got.transform) == ("EPSG:32631", 30.0, want.transform)
    assert np.isnan(got.elevation[0, 0])
    np.testing.assert_allclose(got.elevation[1:], want.elevation[1:])
    with pytest.raises(InputError, match="cannot be read as a raster"):
        read_terrain(tmp_path / "none.tif")
