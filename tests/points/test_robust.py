"""Consensus: late arrivals lose, agreeing ones stay, and what cannot be told is said."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import polars as pl
import pytest
from scipy.optimize import least_squares

from maloc import ArrivalTimes, Receivers
from maloc._jax import jnp
from maloc.errors import InputError
from maloc.points import locate
from maloc.points._hypotheses import sets
from maloc.points._robust import rank
from tests.points.arrays import arrivals, error, ring


def test_sets_are_ordered_by_their_worst_member():
    got = sets(6, 3, 100)
    assert sorted(map(tuple, got)) == sorted(combinations(range(6), 3))
    assert (np.diff(got.max(axis=1)) >= 0).all()
    assert len(sets(20, 4, 30)) == 30


def test_ranking_is_size_then_nearness_to_the_prior_then_largest_residual():
    heard = jnp.asarray([True] * 4)
    z = jnp.asarray([[0.1, 9, 0.1, 2.9], [0.1, 0, 0.5, 0], [0.2, 0, 0.1, 0], [9.0, 9, 9, 9]])
    everywhere, none = jnp.ones(4, bool), jnp.zeros(4)
    assert int(rank(z, heard, none, everywhere, 3.0, 1.0)) == 0  # 0.2 is the least of .2, .5, 2.9
    prior = jnp.asarray([50.0, 0, 10, 1])
    assert int(rank(z, heard, prior, everywhere, 3.0, 1.0)) == 2  # nearer, and within 1 of .2
    z = z.at[3, 2].set(0.0)
    assert int(rank(z, heard, none, everywhere, 3.0, 1.0)) == 2  # four agree
    assert int(rank(z, heard, none, everywhere.at[2].set(False), 3.0, 1.0)) == 0


def test_without_outliers_consensus_is_least_squares_of_all():
    rng = np.random.default_rng(1)
    receivers, xy = ring(7), rng.uniform(-250, 250, (40, 2))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.5, (40, 7)))
    points = locate(toa, sigma=1.0)

    def best(i):
        reach = (toa.toa[i] - toa.toa[i, 0]) * 1500

        def residual(u):
            return u[2] + np.linalg.norm(receivers.xy - u[:2], axis=1) - reach

        return least_squares(residual, [*xy[i], reach.min()], xtol=1e-14, ftol=1e-14).x[:2]

    whole = points.inlier.all(axis=1)
    assert whole.mean() > 0.9
    np.testing.assert_allclose(
        points.position[whole], [best(i) for i in np.flatnonzero(whole)], atol=2e-3
    )


def test_brute_force_grid_finds_no_larger_consensus():
    """On a fine grid with the median emission (seed 001, section 2.1) no place does better."""
    rng = np.random.default_rng(2)
    receivers, xy = ring(7, size=60), rng.uniform(-40, 40, (25, 2))
    late = np.where(rng.random((25, 7)) < 0.25, rng.uniform(20, 80, (25, 7)), 0)
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.5, (25, 7)), late=late)
    points = locate(toa, sigma=0.5, reach=200.0, early=1.0)
    side = np.arange(-80, 80, 0.5)
    grid = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    distance = np.linalg.norm(grid[:, None] - receivers.xy, axis=-1)
    for i in range(25):
        reach = toa.toa[i] * 1500 - distance
        size = (np.abs(reach - np.median(reach, axis=1)[:, None]) <= 1.5).sum(axis=1).max()
        assert points.n_used[i] >= size


@pytest.mark.parametrize("sign", ["late", "either"])
def test_inliers_are_kept_and_outliers_rejected(sign):
    rng = np.random.default_rng(3)
    n, m = 2000, 8
    receivers, xy = ring(m), rng.uniform(-400, 400, (n, 2))
    wild = np.argsort(np.argsort(rng.random((n, m)), axis=1), axis=1) < rng.integers(2, 4, (n, 1))
    size = rng.uniform(50, 300, (n, m)) * (1 if sign == "late" else rng.choice([-1, 1], (n, m)))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 1, (n, m)), late=wild * size)
    points = locate(toa, sigma=1.0, early=10.0 if sign == "late" else 1.0)
    assert points.inlier[~wild].mean() > 0.95
    assert (~points.inlier[wild]).mean() > 0.99
    settled = points.located & ~points.ambiguous
    assert settled.mean() > 0.9
    assert (error(points, xy)[settled] > 25).mean() < 0.02


def test_sigma_is_estimated_in_spite_of_late_arrivals():
    rng = np.random.default_rng(4)
    n, m = 300, 8
    receivers, xy = ring(m), rng.uniform(-300, 300, (n, 2))
    late = np.where(rng.random((n, m)) < 0.15, rng.uniform(50, 300, (n, m)), 0)
    for sd in (0.4, 2.0):
        toa = arrivals(receivers, xy, noise=rng.normal(0, sd, (n, m)), late=late)
        assert locate(toa).sigma == pytest.approx(sd, rel=0.12)


def test_line_of_receivers_leaves_both_sides_open_until_a_region_or_prior_tells():
    rng = np.random.default_rng(5)
    receivers = Receivers(np.array(list("abcde")), np.arange(5) * 100.0, np.zeros(5))
    xy = np.column_stack([rng.uniform(50, 350, 30), rng.uniform(20, 150, 30)])
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.2, (30, 5)))
    points = locate(toa, sigma=0.3)
    assert locate(toa).sigma == pytest.approx(0.2, rel=0.35)  # mirrors have the same residuals
    assert points.ambiguous.all()
    np.testing.assert_allclose(points.alternative, points.position * [1, -1], rtol=0, atol=1e-2)
    north = np.array([[-500.0, 0], [900, 0], [900, 500], [-500, 500]])
    for settled in (locate(toa, sigma=0.3, region=north), locate(toa, sigma=0.3, prior=xy + 5)):
        assert (settled.position[:, 1] > 0).all()
        assert error(settled, xy).max() < 5
    assert not locate(toa, sigma=0.3, region=north).ambiguous.any()


def test_three_of_five_that_agree_prove_nothing():
    """Any three agree somewhere: with two more that do not, no arrival is called an inlier."""
    rng = np.random.default_rng(6)
    receivers, xy = ring(5), rng.uniform(-250, 250, (200, 2))
    late = np.zeros((200, 5))
    late[:, :2] = rng.uniform(60, 300, (200, 2))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.5, (200, 5)), late=late)
    points = locate(toa, sigma=0.5)
    only = points.located & (points.n_used == 3)
    assert only.mean() > 0.5
    assert points.ambiguous[only].all()
    assert not points.inlier[only].any()


def test_too_few_receivers_are_said_and_not_dropped():
    receivers, xy = ring(5), np.array([[10.0, 20], [30, -40], [50, 60]])
    heard = np.array([[1, 1, 0, 0, 0], [1, 1, 1, 1, 1], [0, 0, 0, 0, 0]], bool)
    toa = arrivals(receivers, xy, heard=heard)
    points = locate(toa, sigma=1.0)
    assert len(points) == 3
    np.testing.assert_array_equal(points.located, [False, True, False])
    assert points.why[0] == "heard by 2 receivers, 3 are needed"
    assert points.why[1] == ""
    frame = points.to_frame()
    assert frame["x"].is_null().to_list() == [True, False, True]
    with pytest.raises(InputError, match="no ping was heard by 3 receivers"):
        locate(toa.replace(toa=np.where(heard.sum(1)[:, None] > 3, np.nan, toa.toa)))


def test_wrong_options_are_named():
    toa = arrivals(ring(5), np.zeros((2, 2)) + 10)
    with pytest.raises(InputError, match="no method 'magic'"):
        locate(toa, "magic")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="has no option 'dleta'"):
        locate(toa, sigma=1.0, dleta=2)
    with pytest.raises(InputError, match="sigma must be positive"):
        locate(toa, sigma=0.0)
    with pytest.raises(InputError, match=r"prior must be \(2, 2\)"):
        locate(toa, sigma=1.0, prior=np.zeros((3, 2)))


def test_canal_error_is_a_quarter_of_least_squares(shared_dir):
    """Half of the arrivals missing would leave few pings of 4; the file with none missing."""
    folder = shared_dir / "data" / "sim_canal"
    table = pl.read_csv(folder / "track01_na00_mp15.csv", null_values="NA")
    place = {r["Station Name"]: (r["X"], r["Y"]) for r in _rows(folder / "receivers.csv")}
    columns = [c for c in table.columns if c.startswith("toa_")]
    names = [c.removeprefix("toa_") for c in columns]
    xy = np.array([place[n] for n in names])
    receivers = Receivers(np.array(names), xy[:, 0], xy[:, 1])
    toa = ArrivalTimes(table.select(columns).to_numpy(), receivers, table["ss"].to_numpy())
    truth = table.select("x", "y").to_numpy()
    robust, plain = locate(toa), locate(toa, "least-squares")
    both = robust.located & plain.located & (toa.n_heard >= 4)
    assert both.mean() > 0.7
    assert error(robust, truth)[both].mean() < error(plain, truth)[both].mean() / 4
    assert error(robust, truth)[both].mean() < 4


def _rows(file):
    return pl.read_csv(file).iter_rows(named=True)
