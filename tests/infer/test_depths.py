"""Depths of a fit: between the pings against a dense Gaussian, in tables, and read back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from maloc import infer
from maloc.data import WaterColumn
from maloc.data.water_column import flat_warning
from maloc.infer._bridge import PathDraws
from maloc.infer._depths import DepthDraws, expected_depths
from maloc.infer._export import write_posterior
from maloc.infer.track import track_table
from maloc.models import toa_track
from maloc.movement import OU
from maloc.points.altitude import Terrain
from maloc.predict import prediction_table, read_tracks
from maloc.world.depth import bottom_at
from maloc.world.depth_data import depth_data
from simulations import depth as study
from tests.infer.cases import receivers

SQUARE = ((0, 0), (100, 0), (0, 100), (100, 100))


@pytest.fixture(scope="module")
def made():
    return study.simulate(np.random.default_rng(5), 15)


@pytest.fixture(scope="module")
def fit(made):
    return infer.laplace(toa_track, made.toa.replace(column=WaterColumn(made.bottom)), draws=400)


def deep(bottom):
    """Depths of two states in water so deep, receivers at 3 m."""
    table = receivers(SQUARE)
    table = replace(table, depth=np.full(4, 3.0))
    found = depth_data(WaterColumn(bottom), table, None, np.array([0.0, 9.0]))
    assert found is not None
    return found


def test_depth_between_states_is_the_dense_conditional():
    clock, z = np.array([0.0, 40.0, 70.0, 300.0]), np.array([30.0, 36.0, 33.0, 45.0])
    times, n = np.array([500.0, 55.0, -60.0, 200.0]), 20_000
    mean, sd, t05 = 40.0, 6.0, 600.0
    path = PathDraws(
        OU,
        {"sd": np.full(n, sd), "t05": np.full(n, t05)},
        np.tile(clock, (n, 1)),
        np.tile(z[:, None, None], (n, 1, 1, 1)),
        np.full((n, 1), mean),
    )
    draws = DepthDraws(path, deep(1000.0), clock, z)  # so deep that no bound is near
    found, spread = expected_depths(draws, times, np.zeros((4, 2)), seed=0)

    def covariance(a, b):
        return sd**2 * 0.05 ** (np.abs(a[:, None] - b) / t05)

    weight = np.linalg.solve(covariance(clock, clock), covariance(clock, times)).T
    exact = mean + weight @ (z - mean)
    variance = np.diag(covariance(times, times) - weight @ covariance(clock, times))
    np.testing.assert_allclose(found, exact, atol=4 * sd / np.sqrt(n))
    np.testing.assert_allclose(spread, np.sqrt(variance), rtol=4 / np.sqrt(2 * n))


def test_known_depths_are_joined_by_lines():
    clock, xy = np.array([0.0, 10.0]), np.zeros((2, 2))
    draws = DepthDraws(None, deep(50.0), clock, np.array([4.0, 8.0]))
    mean, sd = expected_depths(draws, np.array([5.0, 20.0]), xy, 0)
    np.testing.assert_allclose(mean, [6.0, 8.0])
    assert np.isnan(sd).all()  # nobody knows how far from the line
    still = draws._replace(known=np.array([4.0, 4.0]))
    np.testing.assert_allclose(
        expected_depths(still, np.array([5.0, 20.0]), xy, 0), [[4, 4], [0, 0]]
    )


def test_bottom_of_a_raster():
    """Splines through a slope are that slope; land and shoals are shallow water."""
    cells = np.arange(-400.0, 500.0, 10.0) + 5.0
    elevation = np.tile(-(30.0 + 0.1 * cells), (len(cells), 1))
    terrain = Terrain(elevation, (10.0, 0.0, -400.0, 0.0, 10.0, -400.0))
    water = deep(terrain)
    at = np.array([[0.0, 0.0], [33.0, 50.0], [120.0, 90.0]])
    np.testing.assert_allclose(bottom_at(water, at), 30.0 + 0.1 * at[:, 0], atol=1e-6)
    shoal = deep(Terrain(np.full_like(elevation, 2.0), terrain.transform))
    assert (np.asarray(shoal.grid) == 0.5).all()


def test_flat_tracks_say_what_they_leave_out(made):
    said = flat_warning(made.toa.replace(depth=None))
    assert said is not None and "differ by up to 68 m (8 to 76)" in said and "21 m off" in said
    assert flat_warning(made.toa.replace(column=WaterColumn(80.0))) is None
    level = replace(made.toa.receivers, depth=np.full(16, 5.0))
    assert flat_warning(made.toa.replace(receivers=level)) is None


def test_fit_with_depth(made, fit):
    mean, sd, low, high = fit.depths()
    truth = made.place[made.toa.n_heard > 0, 2]
    assert (np.abs(mean - truth) < 4 * sd).all() and ((low < mean) & (mean < high)).all()
    assert fit.warnings == ()
    table = track_table(fit, made.toa.replace(column=WaterColumn(made.bottom)))
    np.testing.assert_allclose(table["z"].to_numpy()[: len(mean)], mean)
    assert set(fit.pointwise()) == {"arrival", "depth_sensor"}
    assert fit.pointwise()["depth_sensor"].shape[2] == np.isfinite(made.toa.depth).sum()


def test_prediction_at_the_pings_and_read_back(fit, tmp_path):
    mean, sd, *_ = fit.depths()
    where = fit.cm.natural(fit.marginal.x, fit.marginal.u, fit.args)
    times = np.asarray(where["emission_time"])[: fit.n_states]
    found = fit.predict(times)
    assert (np.abs(found.depth - mean) < 0.35 * sd).all()  # other draws, 400 of them
    write_posterior(fit, tmp_path / "posterior.nc", ["a"], None, None)
    (stored,) = read_tracks(tmp_path)
    again = stored.predict(times)
    assert (np.abs(again.depth - mean) < 0.35 * sd).all()
    assert {"z", "sd_z"} <= set(prediction_table(stored, times).columns)
    whole = stored.sample_tracks(times, 50)
    assert whole.depth is not None and whole.depth.shape == (50, len(times))
    assert (whole.depth >= 0).all() and (whole.depth <= 80).all()
