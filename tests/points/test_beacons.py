"""Beacons: offsets cancel, ranking as said, several beacons as one joint least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from maloc import Receivers
from maloc.errors import InputError
from maloc.points import locate_by_beacons
from maloc.points._beacons import Beacons, rank_beacons
from maloc.points._shared_offsets import share_offsets
from tests.points.arrays import C, arrivals, error, ring


def study(rng, n=40, m=6, noise=0.3, wild=0.0):
    """A tag's pings and two sync tags' a second later, on clocks that are off by tens of ms."""
    base = ring(m)
    tags = np.array(["S0", "S1", *[""] * (m - 2)])
    receivers = Receivers(base.receiver, base.x, base.y, sync_tag=tags)
    offset = rng.uniform(-0.05, 0.05, m) * C
    xy = rng.uniform(-250, 250, (n, 2))
    late = np.where(rng.random((n, m)) < wild, rng.uniform(60, 300, (n, m)), 0)
    sent = 60.0 * np.arange(n)
    tag = arrivals(
        receivers, xy, noise=rng.normal(0, noise, (n, m)), late=late + offset, sent=sent, tag="A-9"
    )
    sync = [
        arrivals(
            receivers,
            np.repeat(receivers.xy[j : j + 1], n, axis=0),
            noise=rng.normal(0, noise, (n, m)),
            late=offset[None],
            sent=sent + 1.0 + j,
            tag=f"A-S{j}",
        )
        for j in range(2)
    ]
    return tag, sync, xy


@pytest.mark.parametrize("multiple", [False, True])
def test_clock_offsets_cancel(multiple):
    tag, sync, xy = study(np.random.default_rng(1), noise=0.0)
    points = locate_by_beacons(tag, sync, multiple=multiple, sigma=0.3)
    assert points.located.all()
    assert error(points, xy)[~points.ambiguous].max() < 1e-3
    np.testing.assert_allclose(points.emission, 60.0 * np.arange(40), atol=0.06)


def test_outliers_are_found_against_beacons():
    tag, sync, xy = study(np.random.default_rng(2), n=200, m=8, wild=0.15)
    points = locate_by_beacons(tag, sync, sigma=0.3)
    settled = points.located & ~points.ambiguous
    assert settled.mean() > 0.9
    assert np.median(error(points, xy)[settled]) < 0.6
    assert (error(points, xy)[settled] > 10).mean() < 0.03


def test_several_beacons_are_the_joint_least_squares_of_all_constraints():
    """Against SciPy on constraints (2) and (3) with every offset and emission time unknown."""
    rng = np.random.default_rng(3)
    tag, sync, xy = study(rng, n=6)
    points = locate_by_beacons(tag, sync, multiple=True, sigma=0.3)
    one = locate_by_beacons(tag, sync, sigma=0.3)
    receivers = tag.receivers.xy
    for i in range(6):
        assert points.inlier[i].all()

        def residual(u, i=i):
            x, sent, off = u[:2], u[2:5], np.append(u[5:], 0.0)
            out = [(tag.toa[i] - 60.0 * i) * C - sent[0] - np.linalg.norm(receivers - x, axis=1)]
            for j in range(2):
                away = np.linalg.norm(receivers - receivers[j], axis=1)
                out.append((sync[j].toa[i] - 60.0 * i - 1 - j) * C - sent[1 + j] - away)
            return np.concatenate([o - off for o in out])

        best = least_squares(residual, [*xy[i], *np.zeros(3), *np.zeros(5)], xtol=1e-14).x[:2]
        np.testing.assert_allclose(points.position[i], best, atol=1e-3)
    assert not np.allclose(points.position, one.position, atol=1e-2)  # a beacon more tells more
    assert (np.linalg.det(points.covariance) < np.linalg.det(one.covariance)).all()


def test_single_beacon_covariance_is_that_of_the_differences():
    """Section 10.4 of Toledo (2020): the same as weighing differences by both variances."""
    rng = np.random.default_rng(4)
    sigma, other = rng.uniform(0.2, 1, 5), rng.uniform(0.2, 1, (1, 5))
    _, precision = share_offsets(
        rng.normal(size=5), sigma, np.zeros((1, 5)), other, np.ones((1, 5), bool)
    )
    w = 1 / (sigma**2 + other[0] ** 2)
    np.testing.assert_allclose(precision, np.diag(w) - np.outer(w, w) / w.sum(), rtol=1e-9)


def test_beacons_heard_by_separate_receivers_tell_nothing_across():
    rng = np.random.default_rng(5)
    used = np.array([[1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], bool)
    _, precision = share_offsets(
        rng.normal(size=6), np.ones(6), np.zeros((2, 6)), np.ones((2, 6)), used
    )
    np.testing.assert_allclose(precision[:3, 3:], 0, atol=1e-12)
    np.testing.assert_allclose(precision.sum(axis=1), 0, atol=1e-12)


def test_ranking_is_shared_receivers_then_near_then_precise():
    nan = np.nan
    toa = np.array([[100.0, 100.1, 100.2, nan], [500, nan, nan, nan]])
    beacons = Beacons(
        toa=np.array(
            [
                [103.0, 103.1, 103.2, 103.3],  # three shared, 3 s away
                [101.0, 101.1, 101.2, 101.3],  # three shared, near, imprecise
                [101.5, 101.6, 101.7, nan],  # three shared, near, precise
                [100.1, 100.2, nan, 100.0],  # two shared
                [107.0, 107.1, 107.2, nan],  # too far
            ]
        ),
        place=np.zeros((5, 3)),
        sigma=np.array([0.1, 2.0, 1.0, 0.1, 0.1])[:, None] * np.ones(4),
    )
    got = rank_beacons(toa, beacons, most=5, window=5.0, near=2.0)
    times = np.where(got >= 0, beacons.toa[got, 0], 0)
    np.testing.assert_array_equal(times[0], [101.5, 101.0, 103.0, 100.1, 0])
    assert (got[1] == -1).all()
    assert (rank_beacons(toa, beacons, most=2)[0] == got[0, :2]).all()


def test_what_is_wrong_is_said():
    tag, sync, _ = study(np.random.default_rng(6), n=3)
    with pytest.raises(InputError, match="no receiver has sync tag 'A-7'"):
        locate_by_beacons(tag, [sync[0].replace(tag="A-7")])
    with pytest.raises(InputError, match="within 0.5 s"):
        locate_by_beacons(tag, sync, window=0.5)


def test_sigma_is_estimated_and_pings_of_few_receivers_do_no_harm():
    """The pair chosen may have fewer receivers than another pair of its ping."""
    rng = np.random.default_rng(7)
    tag, sync, xy = study(rng, n=120, m=9, noise=0.8, wild=0.1)
    heard = np.array(rng.random((120, 9)) < 0.8)
    tag = tag.replace(toa=np.where(heard, tag.toa, np.nan))
    some = np.arange(9) < 8
    points = locate_by_beacons(tag, [s.replace(toa=np.where(some, s.toa, np.nan)) for s in sync])
    assert points.sigma == pytest.approx(0.8, rel=0.15)
    settled = points.located & ~points.ambiguous
    assert np.median(error(points, xy)[settled]) < 2
