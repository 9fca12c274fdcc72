"""Closed forms: the truth is among the roots, and both solve the equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from maloc._jax import jax, jnp
from maloc.points import locate
from maloc.points._closed import minimal
from maloc.points._small import under_determined
from tests.points.arrays import arrivals, error, ring


@pytest.mark.parametrize("n", [2, 3, 4])
def test_null_vector_and_least_norm_are_those_of_the_svd(n):
    rng = np.random.default_rng(n)
    a, b = rng.normal(size=(n - 1, n)), rng.normal(size=n - 1)
    w, v, _ = under_determined(list(map(jnp.asarray, a)), list(map(jnp.asarray, b)))
    null = np.linalg.svd(a)[2][-1]
    np.testing.assert_allclose(abs(null @ v), 1, rtol=1e-12)
    np.testing.assert_allclose(w, np.linalg.pinv(a) @ b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("known", [False, True], ids=["multilateration", "trilateration"])
def test_truth_is_among_the_roots_and_exact_roots_solve_the_equations(d, known):
    rng = np.random.default_rng(10 * d + known)
    n, m = 3000, d if known else d + 1
    place = rng.uniform(-1000, 1000, (n, m, 3))
    truth, sent = rng.uniform(-1500, 1500, (n, d)), rng.uniform(-1000, 1000, n)

    def distance(x):
        square = ((x[:, None] - place[..., :d]) ** 2).sum(-1)
        return np.sqrt(square + (place[..., 2] ** 2 if d == 2 else 0.0))

    arrival = sent[:, None] + distance(truth)
    roots = jax.jit(minimal, static_argnums=2)(
        jnp.asarray(arrival.T),
        jnp.asarray(np.moveaxis(place, 0, -1)),
        d,
        jnp.asarray(sent) if known else None,
    )
    exact = np.asarray(roots.exact)
    nearest = np.full(n, np.inf)
    for k in range(2):
        x, t, good = np.asarray(roots.position[k]).T, np.asarray(roots.emission[k]), exact[k]
        miss = t[:, None] + distance(x) - arrival
        assert np.abs(miss[good]).max() < 1e-4
        nearest = np.where(good, np.fmin(nearest, np.linalg.norm(x - truth, axis=1)), nearest)
    assert nearest.max() < 1e-3
    assert 0.2 < exact.all(axis=0).mean() <= 1  # two-root geometries are there


def test_simultaneous_arrivals_give_the_circumcentre_whatever_root_the_quadratic_took():
    """The seed's sign repair: all arrivals equal, so the emission's sign is free in the squares."""
    place = jnp.asarray([[100.0, 0, 0], [0, 100.0, 0], [-100.0, 0, 0]])
    roots = minimal(jnp.full(3, 7.0), place, 2)
    np.testing.assert_allclose(roots.position, 0, atol=1e-9)
    np.testing.assert_allclose(roots.emission, -93, atol=1e-9)
    assert np.asarray(roots.exact).all()


def test_no_real_root_gives_the_nearest_and_says_so():
    place = jnp.asarray([[0.0, 0, 0], [100.0, 0, 0], [50.0, 80.0, 0]])
    roots = minimal(jnp.asarray([0.0, 150.0, 0.0]), place, 2)  # 150 m later over 100 m: impossible
    assert not np.asarray(roots.exact).any()


@pytest.mark.parametrize("kind", ["intersection", "interpolation"])
@pytest.mark.parametrize("d", [2, 3])
def test_smith_abel_is_exact_without_noise(kind, d):
    rng = np.random.default_rng(3)
    xy, deep = rng.uniform(-250, 250, (40, 2)), rng.uniform(0, 40, 40)
    receivers = ring(7, depth=[0, 35, 10, 60, 5, 25, 45])
    toa = arrivals(receivers, xy, depth=deep)
    points = locate(toa, "closed-form", kind=kind, sigma=1.0, depth=deep if d == 2 else "3d")
    truth = xy if d == 2 else np.column_stack([xy, deep])
    either = np.fmin(
        np.linalg.norm(points.position - truth, axis=1),
        np.nan_to_num(np.linalg.norm(points.alternative - truth, axis=1), nan=np.inf),
    )
    assert either.max() < 1e-5
    sent = 60.0 * np.arange(40)
    sure = ~points.ambiguous
    np.testing.assert_allclose(points.emission[sure], sent[sure], atol=1e-8)


@pytest.mark.parametrize("kind", ["intersection", "interpolation"])
def test_smith_abel_is_near_scipys_least_squares(kind):
    rng = np.random.default_rng(4)
    receivers, xy = ring(8), rng.uniform(-250, 250, (60, 2))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.1, (60, 8)))
    points = locate(toa, "closed-form", kind=kind, sigma=0.1)
    best = np.array(
        [_scipy((toa.toa[i] - toa.toa[i, 0]) * 1500, receivers.xy, xy[i]) for i in range(60)]
    )
    assert np.linalg.norm(points.position - best, axis=1).max() < 2.0
    assert np.median(np.linalg.norm(points.position - best, axis=1)) < 0.2


def _all(toa, xy):
    reach = (toa.toa - toa.toa[:, :1]) * 1500
    return np.array([_scipy(r, toa.receivers.xy, x) for r, x in zip(reach, xy, strict=True)])


def _scipy(reach, xy, start):
    def residual(u):
        return u[2] + np.linalg.norm(xy - u[:2], axis=1) - reach

    return least_squares(residual, [*start, reach.min()], xtol=1e-14, ftol=1e-14).x[:2]


def test_three_receivers_return_both_places_and_say_so():
    """Two-root geometries: the truth is always one of the places, flagged where both fit."""
    rng = np.random.default_rng(5)
    receivers, xy = ring(3), rng.uniform(-700, 700, (1500, 2))
    toa = arrivals(receivers, xy)
    for method in ("closed-form", "consensus"):
        points = locate(toa, method, sigma=0.5, reach=1e9)
        miss = error(points, xy)
        other = np.linalg.norm(points.alternative - xy, axis=1)
        assert np.fmin(miss, other).max() < 1e-2
        two = np.isfinite(other)
        assert 0.1 < two.mean() < 0.9
        np.testing.assert_array_equal(points.ambiguous, two)
        assert miss[~two].max() < 1e-2


def test_least_squares_method_is_scipys():
    rng = np.random.default_rng(6)
    receivers, xy = ring(6), rng.uniform(-200, 200, (30, 2))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 1.0, (30, 6)))
    points = locate(toa, "least-squares", sigma=1.0)
    best = np.array(
        [_scipy((toa.toa[i] - toa.toa[i, 0]) * 1500, receivers.xy, xy[i]) for i in range(30)]
    )
    np.testing.assert_allclose(points.position, best, atol=1e-3)
