"""The parts of a simulation, each against its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from maloc.data import Schedule
from maloc.errors import InputError
from maloc.simulate.animals import correlated_walk, ctcrw, in_polygon
from maloc.simulate.arrays import canal, grid, line
from maloc.simulate.clocks import Clocks, draw_clocks
from maloc.simulate.hearing import Hearing, hear
from maloc.simulate.pings import burst_times, sound_speed_walk


def test_arrays_have_the_shapes_they_say():
    assert grid(9, 50.0).xy.tolist()[:4] == [[0, 0], [50, 0], [100, 0], [0, 50]]
    assert np.ptp(line(5, 10.0).xy, axis=0).tolist() == [40.0, 0.0]
    array = canal()
    assert array.water is not None
    assert in_polygon(array.xy, array.water).all() and len(set(array.name)) == 12


def test_in_polygon_against_a_square_and_a_notch():
    notched = np.array([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], float)
    points = np.array([(2, 0.5), (2, 2), (0.2, 3), (3.8, 3), (5, 1), (-1, 1)])
    assert in_polygon(points, notched).tolist() == [True, False, True, True, False, False]


def test_ctcrw_moments_with_unequal_steps():
    """Velocity is OU: displacement variance is a double integral of its correlation."""
    rng = np.random.default_rng(0)
    time = np.array([0.0, 1e-3, 20.0, 21.0, 400.0])
    sigma, t05 = 0.2, 100.0
    beta = -np.log(0.05) / t05
    paths = np.stack([ctcrw(rng, time, sigma, t05) for _ in range(4000)])
    # Covariance of displacement from time 0: sigma^2 int int exp(-beta |u - v|), midpoint rule.
    for a, b in ((2, 2), (2, 4), (4, 4)):
        u = (np.arange(400) + 0.5) / 400 * time[a]
        v = (np.arange(400) + 0.5) / 400 * time[b]
        kernel = np.exp(-beta * np.abs(u[:, None] - v[None, :]))
        want = sigma**2 * kernel.mean() * time[a] * time[b]
        got = (paths[:, a, :] * paths[:, b, :]).mean()
        # 8000 products of normals with correlation <= 1: 8 of their largest standard errors.
        assert abs(got - want) < 8 * want * np.sqrt(2 / 8000)
    assert np.abs(paths[:, 0]).max() == 0
    # Over a thousandth of a second the animal goes straight on with its velocity.
    assert np.std(paths[:, 1] / 1e-3) == pytest.approx(sigma, rel=0.05)


def test_correlated_walk_stays_in_the_water_and_keeps_its_speed():
    array = canal()
    assert array.water is not None
    time = np.arange(0.0, 4000.0)
    path = correlated_walk(np.random.default_rng(3), time, array.water, speed=0.5)
    assert in_polygon(path, array.water).all()
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert step.mean() == pytest.approx(0.5, rel=0.06)  # exponential: 4 standard errors
    assert np.ptp(path, axis=0).min() > 50  # it does swim about


def test_correlated_walk_is_mirrored_by_a_wall():
    """Straight on, without turning, in a square: the path is the folded straight line."""
    square = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
    rng = np.random.default_rng(5)
    copy = np.random.default_rng(5)
    path = correlated_walk(rng, np.arange(200.0), square, 0.7, turn=0.0, start=(5.0, 5.0))
    steps = copy.exponential(0.7, 200)
    copy.normal(0.0, 0.0, 200)
    heading = copy.uniform(-np.pi, np.pi)
    far = np.concatenate([[0.0], np.cumsum(steps)])[:200]
    straight = 5.0 + far[:, None] * np.array([np.cos(heading), np.sin(heading)])
    folded = 10 - np.abs(np.mod(straight, 20) - 10)
    np.testing.assert_allclose(path, folded, atol=1e-6)


def test_burst_times_follow_the_schedule():
    rng = np.random.default_rng(1)
    gaps = np.diff(burst_times(rng, 2001, Schedule("random", 20.0, 40.0)))
    assert gaps.min() > 20 and gaps.max() < 40
    assert stats.kstest(gaps, stats.uniform(20, 20).cdf).pvalue > 1e-4
    gaps = np.diff(burst_times(rng, 2001, Schedule("stable", 60.0, 0.01)))
    assert stats.kstest(gaps, stats.norm(60, 0.01).cdf).pvalue > 1e-4
    with pytest.raises(InputError, match="burst interval"):
        burst_times(rng, 3, Schedule())


def test_sound_speed_walk_wanders_by_its_rate():
    time = np.cumsum(np.random.default_rng(0).uniform(1, 30, 3000))
    c = sound_speed_walk(np.random.default_rng(1), time, 1450.0, 0.07)
    assert c[0] == 1450.0
    assert np.std(np.diff(c) / np.sqrt(np.diff(time))) == pytest.approx(0.07, rel=0.06)


@pytest.fixture(scope="module")
def heard():
    rng = np.random.default_rng(2)
    emission = np.cumsum(rng.uniform(20, 40, 4000))
    xy = rng.uniform(0, 300, (4000, 2))
    receivers = np.array([(0.0, 0.0), (300.0, 0.0), (150.0, 300.0)])
    c = np.full(4000, 1480.0)
    law = Hearing(p_na=0.3, p_mp=0.06)
    return emission, xy, receivers, c, law, hear(rng, emission, xy, receivers, c, law)


def test_delays_are_geometry(heard):
    emission, xy, receivers, c, _, arrivals = heard
    for j, (rx, ry) in enumerate(receivers):
        delay = np.hypot(xy[:, 0] - rx, xy[:, 1] - ry) / 1480.0
        np.testing.assert_allclose(arrivals.direct[:, j] - emission, delay, atol=1e-9)


def test_shares_missing_and_late(heard):
    *_, arrivals = heard
    n = arrivals.heard.size
    for got, p in ((1 - arrivals.heard.mean(), 0.3), ((arrivals.late > 0).mean(), 0.06)):
        assert abs(got - p) < 5 * np.sqrt(p * (1 - p) / n)
    detour = arrivals.late[arrivals.late > 0] * 1480.0
    assert stats.kstest(detour, stats.uniform(50, 250).cdf).pvalue > 1e-4


def test_times_are_whole_milliseconds_with_poisson_noise(heard):
    *_, arrivals = heard
    shown = arrivals.observed(1e-3)
    assert np.isnan(shown[~arrivals.heard]).all() and np.isfinite(shown[arrivals.heard]).all()
    milliseconds = shown[arrivals.heard] * 1e3
    np.testing.assert_allclose(milliseconds, np.round(milliseconds), atol=1e-4)
    noise = np.round(arrivals.noise * 1e3).astype(int)
    # Poisson(1) with a random sign: mean square 2, zero with probability exp(-1).
    assert abs((noise**2).mean() - 2) < 0.2 and abs((noise == 0).mean() - np.exp(-1)) < 0.03
    assert abs(noise.mean()) < 0.07


def test_hearing_falls_with_distance():
    rng = np.random.default_rng(4)
    xy = np.stack([np.repeat([0.0, 100.0, 200.0], 4000), np.zeros(12000)], 1)
    law = Hearing(p_na=0.1, scale=100.0, noise="gaussian", sd=2e-3, resolution=0.0)
    arrivals = hear(rng, np.arange(12000.0), xy, np.zeros((1, 2)), np.full(12000, 1500.0), law)
    share = arrivals.heard.reshape(3, 4000).mean(1)
    want = 0.9 * stats.norm.pdf([0.0, 1.0, 2.0]) / stats.norm.pdf(0.0)
    assert np.abs(share - want).max() < 0.04
    assert stats.kstest(arrivals.noise[:, 0], stats.norm(0, 2e-3).cdf).pvalue > 1e-4
    assert arrivals.observed(0.0, 3.0)[0, 0] == pytest.approx(
        3.0 + arrivals.late[0, 0] + arrivals.noise[0, 0], abs=1e-12
    )


@pytest.mark.parametrize(
    "wrong",
    [{"p_na": 1.2}, {"p_mp": -0.1}, {"noise": "cauchy"}, {"scale": 0.0}, {"detour": (9.0, 1.0)}],
)
def test_hearing_refuses_nonsense(wrong):
    with pytest.raises(InputError):
        Hearing(**wrong)


def test_clock_error_is_linear_between_knots():
    clocks = Clocks(np.array([0.0, 10.0, 20.0]), np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 0.0]]))
    error = clocks.error(np.array([[5.0, 5.0], [15.0, np.nan], [20.0, 10.0]]))
    np.testing.assert_allclose(error, [[0, 1.5], [0, np.nan], [0, 2]])


def test_drawn_clocks_drift_as_asked():
    clocks = draw_clocks(np.random.default_rng(0), 2001, 9000.0, 0.5, 5.0, 1.0, 3600.0)
    assert clocks.knots.tolist() == [0.0, 3600.0, 7200.0, 10800.0]
    assert (clocks.ahead[:, 0] == 0).all()
    offset, ppm = clocks.ahead[0, 1:], np.diff(clocks.ahead[:, 1:], axis=0) / 3600.0 * 1e6
    assert offset.std() == pytest.approx(0.5, rel=0.08)
    np.testing.assert_allclose(ppm.std(1), np.sqrt(25 + np.array([1.0, 2.0, 3.0])), rtol=0.08)
    assert np.diff(ppm, axis=0).std() == pytest.approx(1.0, rel=0.08)
