"""Speed, distance, residence and utilisation against counting by hand and known laws."""

import numpy as np
import pytest
from scipy import stats

from maloc.biology import distance_travelled, residence, speed, summarise, utilisation
from maloc.biology.space import inside
from maloc.errors import InputError
from maloc.infer import TrackDraws

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def walks(draws=300, n=400, seed=0):
    """Brownian tracks, 1 m in each axis a second, from the origin."""
    rng = np.random.default_rng(seed)
    return TrackDraws(np.arange(float(n)), np.cumsum(rng.normal(size=(draws, n, 2)), axis=1))


def test_summaries():
    draws = np.random.default_rng(0).normal(3.0, 2.0, (100_000, 2))
    found = summarise(draws, 0.8)
    np.testing.assert_allclose(found.mean, 3.0, atol=0.04)
    np.testing.assert_allclose(found.sd, 2.0, rtol=0.02)
    half = 2.0 * stats.norm.ppf(0.9)
    np.testing.assert_allclose([found.low, found.high], [[3 - half] * 2, [3 + half] * 2], atol=0.06)
    for bad in (0.0, 1.0):
        with pytest.raises(InputError, match="probability"):
            summarise(draws, bad)
    with pytest.raises(InputError, match="two draws"):
        summarise(draws[:1])


def test_speed_is_that_of_each_draw():
    velocity = np.random.default_rng(1).normal(0, 0.5, (4000, 3, 2))
    tracks = TrackDraws(np.arange(3.0), np.zeros((4000, 3, 2)), velocity)
    found = speed(tracks)
    # Rayleigh: though the mean velocity is nil, the animal moves
    np.testing.assert_allclose(found.mean, stats.rayleigh.mean(scale=0.5), rtol=0.04)
    np.testing.assert_allclose(found.high, stats.rayleigh.ppf(0.975, scale=0.5), rtol=0.05)
    with pytest.raises(InputError, match="no velocity"):
        speed(walks(3, 4))


def test_distance_is_that_of_each_draw():
    tracks = walks()
    found = distance_travelled(tracks)
    steps = 399
    assert found.mean[0] == 0.0
    mean, var = stats.rayleigh.stats(moments="mv")
    np.testing.assert_allclose(found.mean[-1], steps * mean, rtol=0.01)
    np.testing.assert_allclose(found.sd[-1], np.sqrt(steps * var), rtol=0.15)
    alone = np.linalg.norm(np.diff(tracks.position[7], axis=0), axis=1).sum()
    np.testing.assert_allclose(found.draws[7, -1], alone)
    # the mean track hardly moves
    mean_track = np.linalg.norm(np.diff(tracks.position.mean(0), axis=0), axis=1).sum()
    assert mean_track < 0.1 * found.low[-1]


def test_residence_by_hand():
    times = np.array([0.0, 10.0, 30.0, 40.0])
    path = np.array([[5.0, 5.0], [20.0, 5.0], [5.0, 1.0], [9.0, 9.0]])
    out = np.full((4, 2), 50.0)
    found = residence(TrackDraws(times, np.stack([path, out])), SQUARE)
    # a time stands for half the way to its neighbours: 5 + 15 + 5
    np.testing.assert_allclose(found.seconds.draws, [25.0, 0.0])
    np.testing.assert_allclose(found.visits.draws, [2, 0])
    np.testing.assert_allclose(found.probability, [0.5, 0.0, 0.5, 0.5])


def test_areas_with_holes_and_bad_ones():
    pytest.importorskip("shapely")
    from shapely.geometry import LineString, Polygon

    hole = SQUARE * 0.4 + 3.0
    ring = Polygon(SQUARE, [hole])
    places = np.array([[1.0, 1.0], [5.0, 5.0], [11.0, 1.0]])
    np.testing.assert_array_equal(inside(places, ring), [True, False, False])
    np.testing.assert_array_equal(inside(places, ring.__geo_interface__), [True, False, False])
    np.testing.assert_array_equal(inside(places, SQUARE), [True, True, False])
    with pytest.raises(InputError, match="LineString"):
        inside(places, LineString(SQUARE))
    with pytest.raises(InputError, match="three corners"):
        inside(places, SQUARE[:2])


def test_utilisation_adds_up_to_the_time_on_the_grid():
    tracks = walks(20, 100)
    found = utilisation(tracks, 5.0)
    np.testing.assert_allclose(found.share.draws.sum(axis=(1, 2)), 1.0)
    # cells against one histogram a draw
    weight = np.ones(100)
    weight[[0, -1]] = 0.5
    for d in (0, 7):
        x, y = tracks.position[d].T
        counted = np.histogram2d(y, x, [found.y_edges, found.x_edges], weights=weight / 99)[0]
        np.testing.assert_allclose(found.share.draws[d], counted, atol=1e-12)
    part = utilisation(tracks, 5.0, (0.0, 4.9, 0.0, 4.9))
    inside_it = residence(tracks, SQUARE * 0.5).seconds.draws / 99
    np.testing.assert_allclose(part.share.draws[:, 0, 0], inside_it)
    smooth = utilisation(tracks, 5.0, bandwidth=10.0)
    np.testing.assert_allclose(smooth.share.draws.sum(axis=(1, 2)), 1.0, atol=1e-3)
    assert smooth.share.mean.max() < found.share.mean.max()


def test_area_of_a_normal_home_range():
    """The 95 % area of a normal law is -2 log(.05) pi sd^2; of the mean track it is nothing."""
    position = np.random.default_rng(3).normal(0, 20.0, (4, 60_000, 2))
    found = utilisation(TrackDraws(np.arange(60_000.0), position), 4.0)
    for share in (0.5, 0.95):
        want = -2 * np.log(1 - share) * np.pi * 20.0**2
        np.testing.assert_allclose(found.area(share).mean, want, rtol=0.06)


def test_bad_grids_are_refused():
    for cell, bandwidth in ((0.0, 0.0), (5.0, -1.0)):
        with pytest.raises(InputError, match="length"):
            utilisation(walks(3, 5), cell, bandwidth=bandwidth)
    with pytest.raises(InputError, match="larger cells"):
        utilisation(walks(), 1e-3)
    with pytest.raises(InputError, match="two times"):
        residence(TrackDraws(np.zeros(1), np.zeros((3, 1, 2))), SQUARE)
