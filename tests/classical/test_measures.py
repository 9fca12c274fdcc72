"""Error measures against dense algebra, finite differences, loops and pairs with a known line."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import least_squares

from maloc.classical import (
    FixedTags,
    cluster_error,
    cluster_filter,
    clusters,
    ehrenberg_error,
    geometric_error,
    regress,
    threshold_filter,
    timing_error,
)
from maloc.data import Receivers
from maloc.errors import InputError
from maloc.points import Points

XY = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 80.0], [0.0, 90.0], [45.0, 160.0]])
RECEIVERS = Receivers(np.array(list("ABCDE")), XY[:, 0], XY[:, 1])
PLACE = np.array([[30.0, 40.0], [60.0, 120.0], [-40.0, -60.0], [250.0, 30.0], [10.0, 10.0]])
USED = np.ones((5, 5), bool)
USED[1, 0] = USED[2, [3, 4]] = USED[4, 2:] = False
SOUND = 1450.0


def points(position=PLACE, used=USED, time=None):
    n = len(position)
    return Points(
        position=position,
        covariance=np.tile(np.eye(2), (n, 1, 1)),
        emission=30.0 * np.arange(n) if time is None else time,
        n_used=used.sum(axis=1),
        inlier=used,
        ambiguous=np.zeros(n, bool),
        alternative=np.full((n, 2), np.nan),
        residual_rms=np.zeros(n),
        method="made up",
        why=np.full(n, ""),
    )


@pytest.mark.parametrize("sigma", [1.0, 0.6])
def test_geometry_by_dense_algebra(sigma):
    found = geometric_error(points(), RECEIVERS, sigma=sigma)
    for at, heard, value in zip(PLACE[:4], USED[:4], found[:4], strict=True):
        to = XY[heard] - at
        slope = np.column_stack([to / np.linalg.norm(to, axis=1)[:, None], np.ones(heard.sum())])
        covariance = sigma**2 * np.linalg.inv(slope.T @ slope)
        assert value == pytest.approx(np.sqrt(covariance[0, 0] + covariance[1, 1]))
    assert np.isinf(found[4])  # two receivers leave a direction open
    wider = geometric_error(points(), RECEIVERS, sigma=sigma, speed_sd=0.01)
    assert (wider[:4] > found[:4]).all()


def test_ehrenberg_is_how_far_least_squares_move():
    """Exact arrivals located with a sound speed .05 m/s too high, by SciPy."""
    found, wrong = ehrenberg_error(points(), RECEIVERS, sound_speed=SOUND), 0.05
    for at, heard, value in zip(PLACE[:4], USED[:4], found[:4], strict=True):
        late = np.linalg.norm(XY[heard] - at, axis=1) / SOUND

        def off(z, heard=heard, late=late):
            return (SOUND + wrong) * late - np.linalg.norm(XY[heard] - z[:2], axis=1) - z[2]

        moved = least_squares(off, [*at, 0.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x[:2] - at
        assert value == pytest.approx(np.hypot(*moved) / wrong, rel=2e-3)
    assert np.isinf(found[4])
    nowhere = PLACE.copy()
    nowhere[1] = np.nan
    for measure in (ehrenberg_error, geometric_error):
        assert np.isnan(measure(points(nowhere), RECEIVERS)).tolist() == [0, 1, 0, 0, 0]
        with pytest.raises(InputError, match="5 columns, but 4 receivers"):
            measure(points(), Receivers(np.array(list("ABCD")), XY[:4, 0], XY[:4, 1]))


def test_timing_error_by_a_loop():
    rng = np.random.default_rng(0)
    clock, error = rng.uniform(0, 7200, 200), rng.exponential(3, 200)
    fixed = FixedTags(clock, error, np.full(200, "0 1"))
    time = np.array([-500.0, 0.0, 1000.0, 7000.0, 1e5])
    want = [np.median(e) if len(e := error[np.abs(clock - t) <= 300]) else np.nan for t in time]
    np.testing.assert_allclose(timing_error(time, fixed), want)
    assert np.isnan(want[0]) and np.isnan(want[4]) and np.isfinite(want[1:4]).all()


def test_clusters_that_place_fixed_tags_badly():
    """A: 11 positions, one wrong (.91 right); B: 20, one wrong (.95); C: 10, all wrong."""
    error = np.concatenate([[9.0], np.full(10, 1.0), [9.0], np.full(19, 2.5), np.full(10, 9.0)])
    label = np.array(["0 1 2"] * 11 + ["1 2 3"] * 20 + ["0 2 4"] * 10)
    fixed = FixedTags(np.arange(41.0), error, label)
    mine = np.array(["0 1 2", "1 2 3", "0 2 4", "", "2 3 4"])
    found = cluster_filter(mine, fixed)
    assert found.why.tolist() == ["bad cluster", "", "", "no position", ""]
    stricter = cluster_filter(mine, fixed, share=0.96, more_than=9)
    assert stricter.keep.tolist() == [False, False, False, False, True]
    want = [(9 + 10) / 11, (9 + 19 * 2.5) / 20, 9.0, np.nan, np.nan]
    np.testing.assert_allclose(cluster_error(mine, fixed), want)
    with pytest.raises(InputError, match="cannot be asked"):
        cluster_filter(mine, fixed, share=2.0)


def test_fixed_tags_are_compared_with_where_they_stand():
    position = PLACE.copy()
    position[1] = np.nan
    one, two = points(position), points(PLACE[:2], USED[:2], np.array([5.0, np.nan]))
    fixed = FixedTags.of([one, two], [PLACE[0], PLACE[0] + [3.0, 4.0]])
    assert fixed.time.tolist() == [0.0, 60.0, 90.0, 120.0, 5.0]
    assert fixed.cluster.tolist() == ["0 1 2 3 4", "0 1 2", "0 1 2 3 4", "0 1", "0 1 2 3 4"]
    assert fixed.error[0] == 0 and fixed.error[-1] == pytest.approx(5.0)
    assert fixed.error[1] == pytest.approx(np.hypot(70, 100))
    assert clusters(one).tolist()[1] == ""
    with pytest.raises(InputError, match="negative"):
        FixedTags(np.zeros(1), -np.ones(1), np.array(["0"]))
    with pytest.raises(InputError, match="place must be"):
        FixedTags.of([one], [1.0, 2.0])


def test_a_line_of_errors():
    rng = np.random.default_rng(1)
    measure = np.append(rng.uniform(0, 10, 500), [np.nan, np.inf])
    error = 1.0 + 0.5 * measure + np.append(rng.normal(0, 0.4, 500), [1.0, 1.0])
    found = regress(measure, error)
    slope, intercept = np.polyfit(measure[:500], error[:500], 1)
    assert (found.slope, found.intercept) == pytest.approx((slope, intercept))
    assert found.r2 == pytest.approx(np.corrcoef(measure[:500], error[:500])[0, 1] ** 2)
    assert found.left_out == 2 and len(found.error) == 500
    limit = found.limit(2.5)
    assert found.expected(limit) == pytest.approx(2.5) and found.expected(-50) == 0
    kept = threshold_filter(measure, limit).keep
    np.testing.assert_array_equal(kept[:500], measure[:500] <= limit)
    axes = found.plot(name="HPE")
    pairs, line = (np.asarray(drawn.get_xydata()) for drawn in axes.lines)
    assert axes.get_xlabel() == "HPE" and len(pairs) == 500
    np.testing.assert_allclose(line[1, 1], found.expected(measure[:500].max()))
    with pytest.raises(InputError, match="no line"):
        regress(np.ones(5), np.arange(5.0))
    with pytest.raises(InputError, match="gives no limit"):
        regress(-measure, error).limit()


def test_importing_the_package_brings_nothing_heavy():
    asked = "import sys, maloc.classical; print({'jax', 'polars', 'scipy'} & set(sys.modules))"
    found = subprocess.check_output([sys.executable, "-c", asked], text=True)
    assert found.strip() == "set()"


def test_geometry_is_the_spread_of_least_squares():
    """Noisy arrivals located by SciPy, 400 times a place: 4 standard errors are 14 %."""
    rng, sigma = np.random.default_rng(2), 0.3
    found = geometric_error(points(), RECEIVERS, sigma=sigma)
    for at, heard, value in zip(PLACE[:3], USED[:3], found[:3], strict=True):
        exact = np.linalg.norm(XY[heard] - at, axis=1)
        off = []
        for noise in rng.normal(0, sigma, (400, heard.sum())):

            def residual(z, heard=heard, arrival=exact + noise):
                return arrival - np.linalg.norm(XY[heard] - z[:2], axis=1) - z[2]

            off.append(least_squares(residual, [*at, 0.0], method="lm").x[:2] - at)
        assert np.sqrt(np.mean(np.sum(np.square(off), axis=1))) == pytest.approx(value, rel=0.14)
