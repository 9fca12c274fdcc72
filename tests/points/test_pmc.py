"""Population Monte Carlo against quadrature on a grid, and what it says of single arrivals."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from maloc import Receivers
from maloc.arrival import DDetect, Student
from maloc.errors import InputError
from maloc.points import locate
from maloc.points._kernels import Kernels, draw, log_density
from maloc.points._prior import spread, start_in
from maloc.points.expected import position_covariance
from tests.points.arrays import arrivals, error, ring

BOX = np.array([[-110.0, -110], [110, -110], [110, 110], [-110, 110]])


def _grid_posterior(toa, law, step=2.0):
    """Mean, covariance, log evidence: sums over place and emission, no cleverness."""
    side = np.arange(-110 + step / 2, 110, step)
    place = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    reach = (toa.toa[0] - toa.toa[0].min()) * toa.sound_speed[0]
    distance = np.linalg.norm(place[:, None] - toa.receivers.xy, axis=-1)
    density = np.zeros(len(place))
    for sent in np.arange(-450, 150, step / 2):
        late = reach[None] - sent - distance
        density += np.exp(np.asarray(law.log_prob(late)).sum(axis=1)) * step / 2
    density *= step**2
    weight = density / density.sum()
    mean = weight @ place
    offset = place - mean
    return mean, (weight[:, None] * offset).T @ offset, np.log(density.sum())


@pytest.mark.parametrize("law", ["ddetect", pytest.param("student", marks=pytest.mark.extended)])
def test_deterministic_mixture_is_the_grid_posterior(law):
    """Two of five arrivals late, so that several places share the mass."""
    rng = np.random.default_rng(3)
    late = np.array([[0, 70.0, 0, 45, 0]])
    toa = arrivals(ring(5, size=80), np.array([[25.0, -30]]), noise=rng.normal(0, 4, 5), late=late)
    error = (
        DDetect(0.0, 4.0, 150.0, 0.3, 32.0, 1e-4) if law == "ddetect" else Student(0.0, 6.0, 3.0)
    )
    mean, covariance, evidence = _grid_posterior(toa, error)
    assert np.sqrt(np.trace(covariance)) > 8  # no Gaussian
    many = toa.replace(
        toa=np.tile(toa.toa, (32, 1)), sound_speed=np.full(32, 1500.0), ping=np.arange(32)
    )
    points = locate(many, "dm-pmc", error=error, sigma=4.0, region=BOX, fade=1e6, keep=True)
    place, weight = points.extra["particles"][..., :2], points.extra["weights"]
    np.testing.assert_allclose(weight.sum(axis=1), 1, rtol=1e-12)
    found = np.einsum("pn,pnd->pd", weight, place)
    np.testing.assert_allclose(found, points.extra["mean"], atol=1e-9)
    sd = np.sqrt(np.diag(covariance))
    # each run errs by sd / sqrt(ess) or so; the mean of 32 by a sixth of that
    assert (abs(found - mean) / sd < 6 / np.sqrt(points.extra["ess"])[:, None]).mean() > 0.95
    np.testing.assert_allclose(found.mean(axis=0), mean, atol=0.05 * sd.max())
    about = place - found[:, None]
    spread_of = np.einsum("pn,pni,pnj->ij", weight, about, about) / 32
    np.testing.assert_allclose(spread_of, covariance, atol=0.12 * sd.max() ** 2)
    each = points.extra["log_evidence"]
    assert np.log(np.mean(np.exp(each - evidence))) == pytest.approx(0, abs=0.05)


def test_gaussian_errors_give_the_covariance_of_the_geometry_and_its_coverage():
    rng = np.random.default_rng(4)
    receivers, xy = ring(8), rng.uniform(-150, 150, (200, 2))
    toa = arrivals(receivers, xy, noise=rng.normal(0, 1.0, (200, 8)))
    points = locate(toa, "pmc", error="gaussian", sigma=1.0)
    expected = np.sqrt(np.diagonal(position_covariance(xy, receivers.xy), axis1=1, axis2=2))
    ratio = points.sd / expected
    assert np.median(ratio) == pytest.approx(1, abs=0.03)
    assert (abs(ratio - 1) < 0.25).mean() > 0.95
    np.testing.assert_allclose(points.position, points.extra["mean"], atol=0.1)
    inside = (points.extra["lo"] <= xy) & (xy <= points.extra["hi"])
    assert 0.91 < inside.mean() < 0.98
    assert np.median(points.extra["ess"]) > 150
    np.testing.assert_allclose(points.emission, 60.0 * np.arange(200), atol=4e-3)


@pytest.mark.parametrize("beta", [32.0, pytest.param(128.0, marks=pytest.mark.extended)])
def test_late_arrivals_are_called_reflected_and_the_errors_law_is_found(beta):
    rng = np.random.default_rng(5)
    n, m = 200, 8
    receivers, xy = ring(m), rng.uniform(-250, 250, (n, 2))
    wild = rng.random((n, m)) < 0.15
    late = np.where(wild, rng.uniform(20, 300, (n, m)), 0)
    toa = arrivals(receivers, xy, noise=rng.normal(0, 1.5, (n, m)), late=late)
    points = locate(toa, "pmc", beta=beta)
    assert points.sigma == pytest.approx(1.5, rel=0.1)
    reflected = points.extra["p_reflected"]
    assert ((reflected > 0.5) == wild).mean() > 0.98
    assert error(points, xy)[wild.sum(axis=1) <= 3].mean() < 2
    assert points.inlier[~wild].mean() > 0.97


@pytest.mark.extended
def test_depth_is_found_too():
    rng = np.random.default_rng(6)
    receivers = ring(8, depth=[0, 60, 10, 80, 5, 50, 20, 70])
    xy, deep = rng.uniform(-150, 150, (60, 2)), rng.uniform(10, 60, 60)
    toa = arrivals(receivers, xy, depth=deep, noise=rng.normal(0, 0.3, (60, 8)))
    points = locate(toa, "dm-pmc", error="gaussian", sigma=0.3, depth="3d")
    truth = np.column_stack([xy, deep])
    inside = (points.extra["lo"] <= truth) & (truth <= points.extra["hi"])
    assert inside.mean() > 0.9
    assert error(points, xy).mean() < 0.5
    flat = locate(toa, "dm-pmc", error="gaussian", sigma=0.3, depth=deep)
    assert error(flat, xy).mean() < error(points, xy).mean() * 1.1


def test_two_places_are_both_reported():
    xy = np.array([[150.0, 60.0], [220, 45]])
    receivers = Receivers(np.array(list("abcde")), np.arange(5) * 100.0, np.zeros(5))
    points = locate(arrivals(receivers, xy), "dm-pmc", error="gaussian", sigma=0.5)
    assert points.ambiguous.all()
    np.testing.assert_allclose(abs(points.position[:, 1]), xy[:, 1], atol=4)
    np.testing.assert_allclose(points.alternative[:, 1], -points.position[:, 1], atol=6)
    np.testing.assert_allclose(points.extra["other_share"], 0.5, atol=0.2)


def test_same_seed_same_answer_whatever_comes_after():
    rng = np.random.default_rng(7)
    toa = arrivals(ring(8), rng.uniform(-100, 100, (6, 2)), noise=rng.normal(0, 1, (6, 8)))
    same: dict[str, Any] = {"sigma": 1.0, "reflected": 0.1}
    one, two = locate(toa, "pmc", seed=1, **same), locate(toa, "pmc", seed=1, **same)
    np.testing.assert_array_equal(one.position, two.position)
    other = locate(toa, "pmc", seed=2, **same)
    assert (abs(other.position - one.position) > 0).all()
    start = np.array([[0.0, 0], [50, 50]])
    given = locate(toa, "pmc", start=start, **same)
    assert error(given, one.position).max() < 1


def test_student_kernels_are_scipys_and_draws_follow_them():
    from scipy.stats import kstest, multivariate_t

    from maloc._jax import jnp

    rng = np.random.default_rng(8)
    root = np.tril(rng.normal(0, 0.3, (3, 3))) + np.diag([1.0, 2, 3])
    shape: Any = np.linalg.inv(root @ root.T)
    rows = [[jnp.asarray([root[i, j]]) if j <= i else None for j in range(3)] for i in range(3)]
    kernels = Kernels(jnp.asarray([[1.0], [-2], [3]]), rows)
    z = np.asarray(draw(kernels, jnp.asarray(rng.random((5, 4000)))))
    law: Any = multivariate_t([1, -2, 3], cast(Any, shape), df=4)
    for own in (0, 4000):
        got = log_density(kernels, jnp.asarray(z), own)
        np.testing.assert_allclose(got, law.logpdf(z.T), atol=2e-4)
    squared = (((z - [[1], [-2], [3]]).T @ root) ** 2).sum(axis=1) / 3
    assert kstest(squared, "f", args=(3, 4)).pvalue > 1e-4


def test_starting_places_fill_the_polygon_evenly():
    corners = np.array([[0.0, 0], [4, 0], [4, 1], [0, 2]])
    xy = start_in(corners, 4000)
    assert ((xy[:, 1] >= 0) & (xy[:, 1] <= 2 - xy[:, 0] / 4) & (xy[:, 0] <= 4)).all()
    assert (xy[:, 0] < 2).mean() == pytest.approx(3.5 / 6, abs=0.01)
    assert spread(1000, 5).mean() == pytest.approx(0.5, abs=0.01)


def test_wrong_options_are_said():
    toa = arrivals(ring(5), np.zeros((2, 2)) + 10)
    with pytest.raises(InputError, match="7 kernels do not divide 500"):
        locate(toa, "pmc", sigma=1.0, kernels=7)
    with pytest.raises(InputError, match="'cauchy' is no law"):
        locate(toa, "pmc", sigma=1.0, error="cauchy")
    with pytest.raises(InputError, match=r"start must be \(N, 2\)"):
        locate(toa, "pmc", sigma=1.0, start=np.zeros((3, 3)))
