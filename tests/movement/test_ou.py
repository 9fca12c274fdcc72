"""Home-range movement against dense joint normals and its own definition."""

import numpy as np
import pytest
from scipy import stats

from maloc._jax import jax, jnp
from maloc.movement import OU
from tests.movement.test_movement import CENTRE, DT, TIMES

SD, T05 = 40.0, 300.0


def covariance(times, sd=SD, t05=T05):
    return sd**2 * 0.05 ** (np.abs(np.subtract.outer(times, times)) / t05)


@jax.jit
def density(dt, sd, t05, centre, path):
    return OU(dt, sd, t05, centre).log_prob(path)


@jax.jit
def drawn(key, dt, sd, t05, centre):
    return OU(dt, sd, t05, centre).sample(key, (2,))


def test_density_is_the_dense_normal():
    path = np.asarray(drawn(jax.random.key(0), DT, SD, T05, CENTRE))[0]
    joint = stats.multivariate_normal(np.zeros(len(TIMES)), covariance(TIMES))
    want = sum(joint.logpdf(path[:, axis] - CENTRE[axis]) for axis in range(2))
    assert float(density(DT, SD, T05, CENTRE, path)) == pytest.approx(want, rel=1e-10)


@pytest.mark.parametrize("dt", [1e-5, 1e7])
def test_density_far_from_its_own_time_scale(dt):
    """Steps much shorter and much longer than its memory: Brownian motion, and independence."""
    path = np.array([[7.0], [7.002]])
    first = stats.norm.logpdf(7.0, 0, SD)
    rate = -np.log(0.05) / T05
    short = stats.norm.logpdf(0.002, -7.0 * rate * dt, SD * np.sqrt(2 * rate * dt))
    want = first + (short if dt < 1 else stats.norm.logpdf(7.002, 0, SD))
    both = jax.jit(jax.value_and_grad(density, argnums=4))
    value, slope = both(np.array([dt]), SD, T05, np.zeros(1), path)
    assert float(value) == pytest.approx(want, rel=1e-6)
    assert np.isfinite(slope).all()


def test_draws_have_the_stated_moments():
    law = OU(DT, SD, T05, CENTRE)
    draws = np.asarray(jax.jit(lambda key: law.sample(key, (20_000,)))(jax.random.key(1)))
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
    assert OU(DT, sd, t05, CENTRE).batch_shape == (3,)
    paths = drawn(jax.random.key(2), DT, sd, t05, CENTRE)
    assert paths.shape == (2, 3, 7, 2)
    together = density(DT, sd, t05, CENTRE, paths)
    for i in range(3):
        alone = density(DT, sd[i], t05[i], CENTRE, paths[:, i])
        np.testing.assert_allclose(together[:, i], alone, rtol=1e-12)


def test_tags_end_to_end_are_the_product():
    """Each tag with a home range of its own; padding takes the last one's."""
    tag = jnp.repeat(jnp.arange(3), 4)
    dt = np.random.default_rng(0).uniform(5, 60, 11)
    homes = jnp.array([[0.0, 0.0], [100.0, -50.0]])
    sd, t05 = jnp.array([20.0, 40.0]), jnp.array([100.0, 200.0])

    @jax.jit
    def whole(key):
        law = OU(dt, sd, t05, homes, tag=tag)
        paths = law.sample(key, (4000,))
        return law.log_prob(paths[:5]), paths, law.mean, law.variance

    found, paths, mean, variance = whole(jax.random.key(3))
    total = 0.0
    for k in range(3):
        rows, i = slice(4 * k, 4 * k + 4), min(k, 1)
        total += density(dt[4 * k : 4 * k + 3], sd[i], t05[i], homes[i], paths[:5, rows])
        np.testing.assert_allclose(mean[rows], np.tile(homes[i], (4, 1)))
        np.testing.assert_allclose(variance[rows], sd[i] ** 2)
    np.testing.assert_allclose(found, total, rtol=1e-12)
    paths = np.asarray(paths)
    assert (np.abs(paths.mean(0) - mean) < 5 * np.sqrt(variance / 4000)).all()
    own = np.corrcoef(paths[:, 4:8, 0].T)
    wanted = covariance(np.concatenate([[0.0], np.cumsum(dt[4:7])]), 1.0, 200.0)
    np.testing.assert_allclose(own, wanted, atol=0.06)


def test_one_home_for_all_tags():
    tag = jnp.repeat(jnp.arange(3), 4)
    law = OU(np.full(11, 30.0), SD, T05, CENTRE, tag=tag)
    path = jax.jit(law.sample)(jax.random.key(4))
    parts = [density(np.full(3, 30.0), SD, T05, CENTRE, path[i : i + 4]) for i in (0, 4, 8)]
    np.testing.assert_allclose(jax.jit(lambda d, p: d.log_prob(p))(law, path), sum(parts))


def test_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="sd"):
        OU(DT, -1.0, T05, CENTRE, validate_args=True)
    with pytest.raises(ValueError, match="end to end"):
        OU(DT, SD, T05, CENTRE, tag=jnp.zeros(3, int))
