"""Two places: the prior chooses, and only when it is itself certain."""

from __future__ import annotations

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.points import Rules, locate, resolve
from maloc.points._kalman import Prior
from tests.points.arrays import arrivals, error, ring

THREE = np.array([1, 1, 1, 0, 0, 0, 0, 0], bool)
ALL = np.ones(8, bool)


def walk(heard, seed=0, step=10.0, sent=None, start=(550.0, 200.0)):
    """A slow track, heard by the receivers given for each ping; truth and positions."""
    rng = np.random.default_rng(seed)
    heard = np.asarray(heard)
    xy = np.asarray(start) + np.cumsum(rng.normal(0, 2.0, (len(heard), 2)), axis=0)
    toa = arrivals(
        ring(8),
        xy,
        noise=rng.normal(0, 0.2, heard.shape),
        heard=heard,
        sent=step * np.arange(len(heard)) if sent is None else sent,
    )
    return xy, locate(toa, sigma=0.3, reach=1e4)


def test_a_certain_start_settles_what_follows():
    xy, points = walk([ALL, *[THREE] * 20])
    assert points.ambiguous[1:].all()
    assert (error(points, xy) > 50).any()  # the arrivals alone choose wrongly here and there
    done = resolve(points)
    assert not done.ambiguous.any()
    assert error(done, xy).max() < 20
    np.testing.assert_allclose(
        np.fmin(error(points, xy), np.linalg.norm(points.alternative - xy, axis=1)),
        error(done, xy),
        rtol=1e-9,
    )


def test_the_way_back_settles_what_came_before_offline_only():
    xy, points = walk([*[THREE] * 20, ALL])
    live = resolve(points, backward=False)
    assert live.ambiguous[:20].all()
    done = resolve(points)
    assert not done.ambiguous.any()
    assert error(done, xy).max() < 20


def test_exchange_takes_covariance_and_emission_along():
    xy, points = walk([ALL, *[THREE] * 20])
    done = resolve(points)
    moved = (done.position != points.position).any(axis=1)
    assert 0 < moved.sum() < 21
    assert points.other is not None and done.other is not None
    np.testing.assert_array_equal(done.covariance[moved], points.other.covariance[moved])
    np.testing.assert_array_equal(done.other.position[moved], points.position[moved])
    np.testing.assert_allclose(done.emission[moved], 10.0 * np.flatnonzero(moved), atol=1e-2)


def test_without_any_certain_ping_nothing_is_settled():
    _, points = walk([THREE] * 10)
    np.testing.assert_array_equal(resolve(points).ambiguous, points.ambiguous)


def test_after_twenty_minutes_the_prior_is_ambiguous_again():
    sent = np.array([0.0, 10, 20, 20 + 1201, 1231])
    _, points = walk([ALL, *[THREE] * 4], sent=sent)
    np.testing.assert_array_equal(resolve(points).ambiguous, [False, False, False, True, True])
    longer = resolve(points, Rules(stale=1300.0))
    assert not longer.ambiguous.any()


def test_five_recent_of_four_receivers_make_a_prior():
    four = THREE | (np.arange(8) == 4)
    for count, settled in ((4, False), (5, True)):
        _, points = walk([*[four] * count, THREE])
        assert not points.ambiguous[:count].any()
        assert resolve(points, backward=False).ambiguous[-1] == (not settled)


def test_state_of_five_is_the_one_nearest_their_medians():
    prior = Prior(Rules())
    places = np.array([[0.0, 0], [2, 1], [1, 2], [900, 1], [1, 1]])
    became = [prior.observe(10.0 * k, p, np.eye(2), 4) for k, p in enumerate(places)]
    assert became == [False] * 4 + [True]
    np.testing.assert_array_equal(prior.mean[:2], [1, 1])


@pytest.mark.parametrize(
    ("receivers", "away", "dt", "taken"),
    [
        (3, 249.0, 100.0, True),
        (3, 251.0, 100.0, False),
        (4, 999.0, 100.0, True),
        (4, 1001.0, 100.0, False),
        (5, 1999.0, 100.0, True),
        (5, 2001.0, 100.0, False),  # 20 m/s
    ],
)
def test_gates(receivers, away, dt, taken):
    prior = Prior(Rules())
    prior.observe(0.0, np.zeros(2), np.eye(2), 6)
    prior.observe(dt, np.array([away, 0.0]), np.eye(2), receivers)
    assert (prior.time == dt) == taken


def test_filter_is_the_scalar_kalman_filter():
    prior = Prior(Rules(drift=0.5))
    prior.observe(0.0, np.zeros(2), 4 * np.eye(2), 6)
    prior.observe(10.0, np.array([8.0, 0]), 9 * np.eye(2), 6)
    ahead = 4 + (0.5 * 10) ** 2
    gain = ahead / (ahead + 9)
    np.testing.assert_allclose(prior.mean[0], gain * 8)
    np.testing.assert_allclose(prior.covariance[0, 0], (1 - gain) * ahead)


def test_constant_velocity_follows_a_straight_swimmer():
    still, moving = Prior(Rules(drift=0.5)), Prior(Rules(drift=0.5, velocity=True))
    for k in range(20):
        for prior in (still, moving):
            prior.observe(10.0 * k, np.array([15.0 * k, 0.0]), np.eye(2), 6)
    target = np.array([15.0 * 20, 0.0])
    assert np.linalg.norm(moving.at(200.0)[0] - target) < 1
    assert np.linalg.norm(still.at(200.0)[0] - target) > 14


@pytest.mark.parametrize(("age", "settled"), [(11.9, True), (12.1, False)])
def test_hints_of_the_last_twelve_hours_start_the_prior(age, settled):
    _, points = walk([THREE] * 3)
    _, earlier = walk([ALL] * 3)
    earlier = earlier.replace(emission=earlier.emission - age * 3600)
    assert resolve(points, hints=earlier).ambiguous.any() == (not settled)


def test_density_weighs_the_covariances():
    xy, points = walk([ALL, *[THREE] * 20])
    done = resolve(points, Rules(density=True))
    assert error(done, xy).max() < 20


def test_rules_must_be_positive():
    with pytest.raises(InputError, match="rule stale must be positive"):
        Rules(stale=0.0)
