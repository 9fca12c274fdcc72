"""Covariance from geometry against Monte Carlo; maps against one receiver set at a time."""

from __future__ import annotations

import numpy as np
import pytest

from maloc.errors import InputError
from maloc.points.covariance import covariance
from maloc.points.expected import expected_error, gdop, position_covariance
from tests.points.arrays import ring


def _solve(place, truth, noise, columns):
    """Least squares by Gauss and Newton from the truth; `columns(x)` of the nuisances."""
    x = np.tile(np.concatenate([truth, np.zeros(columns)]), (len(noise), 1))
    observed = np.linalg.norm(place - truth, axis=1) + noise
    for _ in range(8):
        offset = x[:, None, :2] - place
        distance = np.linalg.norm(offset, axis=-1)
        jacobian = [offset / distance[..., None], np.ones((*distance.shape, 1))]
        predicted = distance + x[:, 2:3]
        if columns == 2:
            predicted = distance * (1 + x[:, 3:]) + x[:, 2:3]
            jacobian.append(distance[..., None])
        step, residual = np.concatenate(jacobian, axis=-1), observed - predicted
        gram = np.einsum("pmi,pmj->pij", step, step)
        right = np.einsum("pmi,pm->pi", step, residual)
        x = x + np.linalg.solve(gram, right[..., None])[..., 0]
    return x[:, :2]


@pytest.mark.parametrize("speed", [False, True], ids=["emission", "emission and sound speed"])
def test_sd_is_that_of_monte_carlo_in_random_geometries(speed):
    """Ratio of sd within .9 to 1.1 in 95 % of geometries with GDOP below 10."""
    rng = np.random.default_rng(1)
    ratios = []
    while len(ratios) < 60:
        m = int(rng.integers(5, 10))
        place, truth = rng.uniform(-200, 200, (m, 2)), rng.uniform(-200, 200, 2)
        expected = position_covariance(truth[None], place, 0.2, speed_sd=np.inf if speed else 0.0)[
            0
        ]
        if not gdop(truth[None], place)[0] < 10 or not np.trace(expected) < 4:
            continue
        found = _solve(place, truth, rng.normal(0, 0.2, (1500, m)), 1 + speed)
        ratios.append(np.sqrt(np.diag(expected) / found.var(axis=0)))
    ratios = np.array(ratios)
    assert ((ratios > 0.9) & (ratios < 1.1)).all(axis=1).mean() >= 0.95


def test_it_is_the_covariance_of_the_points():
    rng = np.random.default_rng(2)
    place = np.column_stack([rng.uniform(-200, 200, (6, 2)), rng.uniform(0, 30, 6)])
    xy, used = rng.uniform(-200, 200, (40, 2)), rng.random((40, 6)) < 0.8
    mine = position_covariance(xy, place, 1.5, used)
    theirs = covariance(xy, np.tile(place, (40, 1, 1)), used, np.full((40, 6), 1.5))
    sure = np.isfinite(theirs).all(axis=(1, 2))
    np.testing.assert_allclose(mine[sure], theirs[sure], rtol=1e-6)
    np.testing.assert_array_equal(np.isfinite(mine).all(axis=(1, 2)), sure)


def test_nuisances_interpolate_between_known_and_unknown():
    place, xy = np.column_stack([ring(6).xy, np.full(6, 20.0)]), np.array([[130.0, 40]])

    def sd(**known):
        return np.sqrt(np.trace(position_covariance(xy, place, **known)[0]))

    for name, small, large in (("speed_sd", 1e-9, 1e6), ("depth_sd", 1e-9, 1e9)):
        assert sd(**{name: small}) == pytest.approx(sd())
        assert sd(**{name: large}) == pytest.approx(sd(**{name: np.inf}), rel=1e-4)
        assert sd(**{name: np.inf}) > sd() * 1.01
    assert sd(emission_known=True) < sd()


def test_singular_geometries_are_never_finite():
    line = np.column_stack([np.arange(6) * 100.0, np.zeros(6)])
    on_line = np.column_stack([np.linspace(-300, 900, 30), np.zeros(30)])
    assert np.isinf(position_covariance(on_line, line)).all()
    assert np.isfinite(position_covariance(on_line + [0, 20], line)).all()
    rng = np.random.default_rng(3)
    place = rng.uniform(0, 1e3, (5, 2))
    two = np.array([[True, True, False, False, False]])
    assert np.isinf(position_covariance(rng.uniform(0, 1e3, (20, 2)), place, heard=two)).all()
    three = np.array([[True, True, True, False, False]])
    unknown = position_covariance(place[:2] + 5, place, heard=three, speed_sd=np.inf)
    assert np.isinf(unknown).all()
    twin = np.tile(place[:2], (3, 1))
    assert np.isinf(position_covariance(place[2:], twin)).all()
    # far from home the same figure in other coordinates
    far = position_covariance(on_line[:5] + [6e5, 6e6], line + [6e5, 6e6])
    assert np.isinf(far).all()


def test_gdop_of_a_square_at_its_centre_is_one():
    """Four receivers at right angles: the information is 2 / sigma^2 in each direction."""
    place = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]) * 300
    assert gdop(np.zeros((1, 2)), place)[0] == pytest.approx(1.0)
    assert gdop(np.array([[5e3, 0]]), place)[0] > 50


def test_map_is_the_expectation_over_who_hears():
    receivers = ring(5, size=200)
    x, y = np.array([-50.0, 0, 180]), np.array([-30.0, 40])
    whole = expected_error(receivers, sigma=2.0, x=x, y=y)
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    np.testing.assert_allclose(whole.error.ravel(), 2 * gdop(grid, receivers.xy))
    assert (whole.located == 1).all()
    some = expected_error(receivers, x=x, y=y, detection=lambda d: np.full_like(d, 0.7), draws=3000)
    # three or more of five hear: 1 - .3^5 - 5 .7 .3^4 - 10 .7^2 .3^3
    np.testing.assert_allclose(some.located, 0.83692, atol=0.03)
    assert (some.error >= some.gdop).all()
    normal = expected_error(receivers, x=x, y=y, detection=("halfnormal", 0.9, 150.0), draws=500)
    assert (normal.located < 1).all()
    with pytest.raises(InputError, match="need at least 3"):
        expected_error(receivers.subset(np.arange(5) < 2))
    with pytest.raises(InputError, match="must give a probability"):
        expected_error(receivers, detection=lambda d: d)
