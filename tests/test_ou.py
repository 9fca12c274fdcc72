"""Home-range movement against dense joint normals and its own definition."""

import numpy as np
import pytest
from scipy import stats

from maloc._jax import jax, jnp
from maloc.movement import OU
from tests.test_movement import CENTRE, DT, TIMES

SD, T05 = 40.0, 300.0


def covariance(times, sd=SD, t05=T05):
    return sd**2 * 0.05 ** (np.abs(np.subtract.outer(times, times)) / t05)


def test_density_is_the_dense_normal():
    law = OU(DT, SD, T05, CENTRE)
    path = np.asarray(law.sample(jax.random.key(0)))
    joint = stats.multivariate_normal(np.zeros(len(TIMES)), covariance(TIMES))
    want = sum(joint.logpdf(path[:, axis] - CENTRE[axis]) for axis in range(2))
    assert float(law.log_prob(path)) == pytest.approx(want, rel=1e-10)


@pytest.mark.parametrize("dt", [1e-5, 1e7])
def test_density_far_from_its_own_time_scale(dt):
    """Steps much shorter and much longer than its memory: Brownian motion, and independence."""
    law = OU(np.array([dt]), SD, T05, np.zeros(1))
    path = np.array([[7.0], [7.002]])
    first = stats.norm.logpdf(7.0, 0, SD)
    rate = -np.log(0.05) / T05
    short = stats.norm.logpdf(0.002, -7.0 * rate * dt, SD * np.sqrt(2 * rate * dt))
    want = first + (short if dt < 1 else stats.norm.logpdf(7.002, 0, SD))
    assert float(law.log_prob(path)) == pytest.approx(want, rel=1e-6)
    assert np.isfinite(
        jax.grad(lambda p: OU(jnp.array([dt]), SD, T05, jnp.zeros(1)).log_prob(p))(path)
    ).all()


def test_draws_have_the_stated_moments():
    law = OU(DT, SD, T05, CENTRE)
    draws = np.asarray(law.sample(jax.random.key(1), (20_000,)))
    np.testing.assert_allclose(law.variance, np.full((7, 2), SD**2))
    np.testing.assert_allclose(law.mean, np.tile(CENTRE, (7, 1)))
    assert (np.abs(draws.mean(0) - law.mean) < 5 * SD / np.sqrt(20_000)).all()
    want = covariance(TIMES) / SD**2
    np.testing.assert_allclose(np.corrcoef(draws[:, :, 0].T), want, atol=0.04)
    np.testing.assert_allclose(draws.var(0), SD**2, rtol=0.06)


def test_a_step_over_two_times_is_two_steps():
    a, b = OU.step(13.0, SD, T05), OU.step(29.0, SD, T05)
    both = OU.step(42.0, SD, T05)
    np.testing.assert_allclose(b[0] @ a[0], both[0], rtol=1e-14)
    np.testing.assert_allclose(b[0] @ a[1] @ b[0].T + b[1], both[1], rtol=1e-13)


def test_batches():
    sd, t05 = jnp.array([10.0, 20.0, 30.0]), jnp.array([50.0, 100.0, 200.0])
    law = OU(DT, sd, t05, CENTRE)
    paths = law.sample(jax.random.key(2), (4,))
    assert paths.shape == (4, 3, 7, 2) and law.batch_shape == (3,)
    for i in range(3):
        alone = OU(DT, sd[i], t05[i], CENTRE).log_prob(paths[:, i])
        np.testing.assert_allclose(law.log_prob(paths)[:, i], alone, rtol=1e-12)


@pytest.mark.parametrize("own", [False, True])
def test_tags_end_to_end_are_the_product(own):
    """Each tag with a home range of its own, or all with one; padding takes the last."""
    tag = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3])
    dt = np.random.default_rng(0).uniform(5, 60, 11)
    homes = np.array([[0.0, 0.0], [100.0, -50.0], [30.0, 30.0]])
    sd, t05 = jnp.array([20.0, 40.0, 60.0]), jnp.array([100.0, 200.0, 300.0])
    if own:
        whole = OU(dt, sd, t05, homes, tag=jnp.asarray(tag))
    else:
        whole = OU(dt, 20.0, 100.0, homes[0], tag=jnp.asarray(tag))
    path = whole.sample(jax.random.key(3))
    total = 0.0
    for k in range(4):
        rows, i = np.flatnonzero(tag == k), min(k, 2) if own else 0
        alone = OU(dt[rows[:-1]], sd[i], t05[i], homes[i])
        total += alone.log_prob(path[rows])
        np.testing.assert_allclose(whole.mean[rows], alone.mean)
        np.testing.assert_allclose(whole.variance[rows], alone.variance)
    np.testing.assert_allclose(whole.log_prob(path), total, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(lambda d, p: d.log_prob(p))(whole, path), total)
    draws = np.asarray(whole.sample(jax.random.key(4), (5000,)))
    sds = np.sqrt(whole.variance)
    assert (np.abs(draws.mean(0) - whole.mean) < 5 * sds / np.sqrt(5000)).all()


def test_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="sd"):
        OU(DT, -1.0, T05, CENTRE, validate_args=True)
    with pytest.raises(ValueError, match="end to end"):
        OU(DT, SD, T05, CENTRE, tag=jnp.zeros(3, int))
