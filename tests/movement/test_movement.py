"""CTCRW and Brownian paths against mpmath, dense joint normals and their own definitions."""

import mpmath
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpyro.infer.util import log_density
from scipy import stats

from maloc._jax import jax, jnp
from maloc.movement import CTCRW, Brownian, ctcrw_beta, ctcrw_transition
from maloc.movement.walks import _step_factor
from maloc.world.statespace import SoftBox
from tests import oracles

DT = np.array([3.0, 0.2, 41.0, 41.0, 900.0, 7.5])  # unequal on purpose
TIMES = np.concatenate([[0.0], np.cumsum(DT)])
CENTRE = np.array([10.0, -20.0])
FALSE_ALARM = 1e-6  # of each random check; every seed is fixed, so it fails for good or never


def ctcrw(sigma_vel=0.4, t05=60.0, spread=30.0, dt=DT):
    return CTCRW(dt, sigma_vel, t05, CENTRE, spread)


def brownian(sigma=0.7, spread=30.0, dt=DT):
    return Brownian(dt, sigma, CENTRE, spread)


def dense_ctcrw(sigma_vel=0.4, t05=60.0, spread=30.0):
    with mpmath.workdps(50):
        beta = -mpmath.log(mpmath.mpf("0.05")) / t05
    return oracles.ctcrw_covariance(TIMES, sigma_vel, beta, spread)


def random_path(law, seed=0):
    return np.asarray(jax.jit(law.sample)(jax.random.key(seed)))


# -- transition --------------------------------------------------------------------------------


def _worst_error(sigma_vel, beta, xs):
    worst = np.zeros(6)
    for x in xs:
        step = ctcrw_transition(jnp.asarray(x / beta), sigma_vel, beta)
        _, _, l22 = _step_factor(step)
        exact = oracles.ctcrw_transition_exact(x / beta, sigma_vel, beta)
        for i, (got, want) in enumerate(zip([*step, l22**2], exact, strict=True)):
            got = mpmath.mpf(float(got))
            # e^-1000 is exact only to the rounding of its argument, times 1000
            worst[i] = max(worst[i], abs(float((got - want) / want)))
    return worst


@pytest.mark.parametrize("sigma_vel, beta", [(0.3, 0.0115), (2.0, 1e-6), (1e-3, 50.0)])
def test_transition_is_right_to_1e_10(sigma_vel, beta):
    series_edge = [0.3 * (1 - 1e-12), 0.3, 0.3 * (1 + 1e-12)]
    xs = np.concatenate([np.logspace(-8, np.log10(700), 120), [1e3 / 1.5], series_edge])
    assert _worst_error(sigma_vel, beta, xs).max() < 1e-12


def test_transition_at_the_far_end():
    # e^-1000 underflows gracefully: compare absolutely there, relatively the rest
    step = ctcrw_transition(jnp.asarray(1e3 / 0.01), 0.5, 0.01)
    exact = oracles.ctcrw_transition_exact(1e3 / 0.01, 0.5, 0.01)
    assert float(step.a22) == pytest.approx(float(exact[1]), abs=1e-300)
    np.testing.assert_allclose(
        [step.a12, step.q11, step.q12, step.q22],
        [float(exact[i]) for i in (0, 2, 3, 4)],
        rtol=1e-14,
    )


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    a=st.floats(1e-3, 1e4),
    b=st.floats(1e-3, 1e4),
    beta=st.floats(1e-5, 1.0),
    sigma_vel=st.floats(0.01, 10),
)
def test_a_plus_b_is_a_then_b(a, b, beta, sigma_vel):
    def matrices(dt):
        s = ctcrw_transition(jnp.asarray(dt), sigma_vel, beta)
        transfer = np.array([[1.0, s.a12], [0.0, s.a22]])
        return transfer, np.array([[s.q11, s.q12], [s.q12, s.q22]])

    (transfer_a, noise_a), (transfer_b, noise_b) = matrices(a), matrices(b)
    transfer, noise = matrices(a + b)
    np.testing.assert_allclose(transfer, transfer_b @ transfer_a, rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(
        noise, transfer_b @ noise_a @ transfer_b.T + noise_b, rtol=1e-9, atol=0
    )


def test_t05_is_the_time_of_five_per_cent_correlation():
    step = ctcrw_transition(jnp.asarray(260.0), 0.3, ctcrw_beta(260.0))
    assert float(step.a22) == pytest.approx(0.05, rel=1e-13)


# -- density -------------------------------------------------------------------------------------


@pytest.mark.parametrize("t05", [1.0, 60.0, 5e3])
def test_ctcrw_log_prob_is_the_dense_normal(t05):
    value = random_path(ctcrw(t05=60.0), seed=1)
    cov = dense_ctcrw(t05=t05)
    want = sum(
        oracles.normal_log_density(np.r_[value[:, 0, axis] - c, value[:, 1, axis]], cov)
        for axis, c in enumerate(CENTRE)
    )
    assert float(ctcrw(t05=t05).log_prob(value)) == pytest.approx(want, rel=1e-11)


def test_brownian_log_prob_is_the_dense_normal():
    value = random_path(brownian(), seed=2)
    cov = oracles.brownian_covariance(TIMES, 0.7, 30.0)
    want = sum(
        stats.multivariate_normal(np.full(len(TIMES), c), cov).logpdf(value[:, axis])
        for axis, c in enumerate(CENTRE)
    )
    assert float(brownian().log_prob(value)) == pytest.approx(want, rel=1e-10)


def test_the_order_of_unequal_steps_matters():
    value = random_path(ctcrw(), seed=1)
    assert abs(float(ctcrw().log_prob(value) - ctcrw(dt=DT[::-1].copy()).log_prob(value))) > 1


def _mp_ctcrw_log_prob(value, dt, sigma_vel, t05, centre, spread):
    """Log density of a path by the steps' bivariate normals, all in mpmath."""
    beta = -mpmath.log(mpmath.mpf("0.05")) / t05
    total = mpmath.mpf(0)
    for axis in range(value.shape[-1]):
        x = [mpmath.mpf(float(v)) for v in value[:, 0, axis]]
        v = [mpmath.mpf(float(u)) for u in value[:, 1, axis]]
        total -= (x[0] - centre[axis]) ** 2 / (2 * spread**2) + mpmath.log(spread)
        total -= v[0] ** 2 / (2 * sigma_vel**2) + mpmath.log(sigma_vel) + mpmath.log(2 * mpmath.pi)
        for k, step in enumerate(dt):
            step = mpmath.mpf(float(step))
            e = mpmath.exp(-beta * step)
            alpha2 = 2 * beta * sigma_vel**2
            q11 = alpha2 / beta**2 * (step - 2 * (1 - e) / beta + (1 - e**2) / (2 * beta))
            q12 = alpha2 / (2 * beta**2) * (1 - e) ** 2
            q22 = alpha2 / (2 * beta) * (1 - e**2)
            rx = x[k + 1] - x[k] - (1 - e) / beta * v[k]
            rv = v[k + 1] - e * v[k]
            det = q11 * q22 - q12**2
            form = (q22 * rx**2 - 2 * q12 * rx * rv + q11 * rv**2) / det
            total -= form / 2 + mpmath.log(det) / 2 + mpmath.log(2 * mpmath.pi)
    return total


@jax.jit
def value_and_slopes(sigma_vel, t05, value):
    return jax.value_and_grad(lambda s, t: ctcrw(s, t).log_prob(value), argnums=(0, 1))(
        sigma_vel, t05
    )


@pytest.mark.parametrize("t05", [1e-3, 1.0, 60.0, 1e4, 1e7])
def test_ctcrw_value_and_gradients_against_mpmath(t05):
    """beta dt runs from 6e-8 to 3e6 here."""
    value = random_path(ctcrw(t05=max(t05, 0.5)), seed=3)

    got, grads = value_and_slopes(0.4, t05, value)
    with mpmath.workdps(70):
        args = (value, DT, mpmath.mpf(0.4), mpmath.mpf(t05), CENTRE, 30)

        def exact(sigma_vel, t):
            return _mp_ctcrw_log_prob(args[0], args[1], sigma_vel, t, args[4], args[5])

        want = exact(args[2], args[3])
        by_sigma = mpmath.diff(lambda s: exact(s, args[3]), args[2])
        by_t05 = mpmath.diff(lambda t: exact(args[2], t), args[3])
    assert float(got) == pytest.approx(float(want), rel=1e-9)
    np.testing.assert_allclose(grads, [float(by_sigma), float(by_t05)], rtol=1e-7)


def test_ctcrw_gradient_in_the_path_is_the_dense_precision_times_deviation():
    value = random_path(ctcrw(), seed=4)
    got = jax.jit(jax.grad(lambda v: ctcrw().log_prob(v)))(value)
    cov = oracles.as_floats(dense_ctcrw())
    for axis in range(2):
        deviation = np.r_[value[:, 0, axis] - CENTRE[axis], value[:, 1, axis]]
        want = -np.linalg.solve(cov, deviation)
        np.testing.assert_allclose(np.r_[got[:, 0, axis], got[:, 1, axis]], want, rtol=1e-6)


def test_brownian_gradients():
    value = random_path(brownian(), seed=5)
    slope = jax.grad(lambda s: brownian(s).log_prob(value))(0.7)
    steps = np.diff(value, axis=0) ** 2 / DT[:, None]
    want = steps.sum() / 0.7**3 - steps.size / 0.7  # d/ds of sum(-r^2 / 2 s^2 dt - log s)
    assert float(slope) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("make", [ctcrw, brownian])
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_finite_at_extreme_steps(make, scale):
    value = random_path(make(dt=DT * scale), seed=6)
    both = jax.jit(
        jax.value_and_grad(lambda v, p: make(p, dt=DT * scale).log_prob(v), argnums=(0, 1))
    )
    score, slopes = both(jnp.asarray(value), 0.5)
    assert np.isfinite(score) and all(np.all(np.isfinite(slope)) for slope in slopes)


# -- draws -----------------------------------------------------------------------------------------


def _whitened(paths, covariances, means):
    """Draws (n, ...) of a normal made standard by a dense Cholesky factor."""
    root = np.linalg.cholesky(covariances)
    return np.linalg.solve(root, (paths - means).T).T


def _is_standard_normal(z):
    n, dims = z.shape
    distances = np.sum(z**2, axis=1)
    assert stats.kstest(distances, stats.chi2(dims).cdf).pvalue > FALSE_ALARM
    for column in z.T:
        assert stats.kstest(column, "norm").pvalue > FALSE_ALARM / dims
    correlation = z.T @ z / n - np.eye(dims)
    limit = stats.norm.isf(FALSE_ALARM / dims**2) * np.sqrt(2 / n)
    assert np.abs(correlation).max() < limit


def test_ctcrw_draws_follow_the_dense_normal():
    paths = np.asarray(jax.jit(lambda key: ctcrw().sample(key, (20_000,)))(jax.random.key(7)))
    cov = oracles.as_floats(dense_ctcrw())
    z = [
        _whitened(
            np.concatenate([paths[:, :, 0, axis], paths[:, :, 1, axis]], axis=1),
            cov,
            np.r_[np.full(len(TIMES), CENTRE[axis]), np.zeros(len(TIMES))],
        )
        for axis in range(2)
    ]
    _is_standard_normal(np.concatenate(z, axis=1))


def test_brownian_draws_follow_the_dense_normal():
    paths = np.asarray(jax.jit(lambda key: brownian().sample(key, (20_000,)))(jax.random.key(8)))
    cov = oracles.brownian_covariance(TIMES, 0.7, 30.0)
    z = [_whitened(paths[:, :, axis], cov, CENTRE[axis]) for axis in range(2)]
    _is_standard_normal(np.concatenate(z, axis=1))


@pytest.mark.parametrize("spread", [30.0, 1e-6])
def test_mean_and_variance(spread):
    law = ctcrw(spread=spread)
    variance = np.diag(oracles.as_floats(dense_ctcrw(spread=spread)))
    n = len(TIMES)
    for axis in range(2):
        np.testing.assert_allclose(law.variance[:, 0, axis], variance[:n], rtol=1e-9)
        np.testing.assert_allclose(law.variance[:, 1, axis], variance[n:], rtol=1e-12)
    np.testing.assert_array_equal(law.mean[:, 0], np.tile(CENTRE, (n, 1)))
    np.testing.assert_array_equal(law.mean[:, 1], np.zeros((n, 2)))
    rw = brownian(spread=spread)
    want = np.diag(oracles.brownian_covariance(TIMES, 0.7, spread))
    np.testing.assert_allclose(rw.variance, np.stack([want, want], axis=1), rtol=1e-12)
    np.testing.assert_array_equal(rw.mean, np.tile(CENTRE, (n, 1)))


# -- NumPyro's habits -----------------------------------------------------------------------------


@pytest.mark.parametrize("make", [ctcrw, brownian])
def test_shapes_batches_and_vmap_agree(make):
    scales = jnp.array([0.2, 0.5, 1.3])
    batch = make(scales)
    one = make(0.5)
    assert batch.batch_shape == (3,)
    assert batch.event_shape == one.event_shape
    assert batch.mean.shape == batch.variance.shape == (3, *one.event_shape)
    np.testing.assert_allclose(batch.variance[1], one.variance, rtol=1e-14)
    paths = jax.jit(lambda key: batch.sample(key, (4,)))(jax.random.key(0))
    assert paths.shape == (4, 3, *one.event_shape)
    log_prob = jax.jit(lambda law, v: law.log_prob(v))
    scores = log_prob(batch, paths)
    assert scores.shape == (4, 3)
    np.testing.assert_allclose(log_prob(one, paths[:, 1]), scores[:, 1], rtol=1e-12)
    singly = [float(log_prob(one, p)) for p in paths[:, 1]]
    np.testing.assert_allclose(scores[:, 1], singly, rtol=1e-12)
    mapped = jax.jit(jax.vmap(lambda s, v: make(s).log_prob(v)))(scales, paths[0])
    np.testing.assert_allclose(mapped, scores[0], rtol=1e-12)
    laws = jax.jit(jax.vmap(make))(scales)  # a batch of instances, as a pytree
    mapped = jax.jit(jax.vmap(lambda law, v: law.log_prob(v)))(laws, paths[0])
    np.testing.assert_allclose(mapped, scores[0], rtol=1e-12)


def test_a_batch_of_steps_and_centres():
    dt = np.stack([DT, DT[::-1]])
    centres = np.stack([CENTRE, -CENTRE])
    law = CTCRW(dt, 0.4, jnp.array([20.0, 90.0]), centres, 30.0)
    value = jax.jit(law.sample)(jax.random.key(1))
    log_prob = jax.jit(lambda law, v: law.log_prob(v))
    for k, t05 in enumerate([20.0, 90.0]):
        one = CTCRW(dt[k], 0.4, t05, centres[k], 30.0)
        assert float(log_prob(law, value)[k]) == pytest.approx(float(log_prob(one, value[k])))
        np.testing.assert_allclose(law.mean[k], one.mean)


@pytest.mark.parametrize("make", [ctcrw, brownian])
def test_a_pytree_under_jit(make):
    law = make()
    leaves, tree = jax.tree_util.tree_flatten(law)
    again = jax.tree_util.tree_unflatten(tree, leaves)
    assert (again.batch_shape, again.event_shape) == (law.batch_shape, law.event_shape)
    value = random_path(law)
    want = float(law.log_prob(value))
    assert float(again.log_prob(value)) == pytest.approx(want, rel=1e-14)
    assert float(jax.jit(lambda d, v: d.log_prob(v))(law, value)) == pytest.approx(want, rel=1e-12)
    drawn = jax.jit(lambda d, k: d.sample(k))(law, jax.random.key(0))
    np.testing.assert_allclose(drawn, value, rtol=1e-10)


@pytest.mark.parametrize("make", [ctcrw, brownian])
def test_expand_and_mask(make):
    law = make()
    wide = law.expand((3,))
    value = wide.sample(jax.random.key(0))
    assert value.shape == (3, *law.event_shape)
    assert wide.log_prob(value).shape == (3,)
    assert float(law.mask(False).log_prob(value[0])) == 0
    assert float(law.mask(True).log_prob(value[0])) == float(law.log_prob(value[0]))


def test_validation_names_the_parameter():
    with pytest.raises(ValueError, match="sigma_vel"):
        CTCRW(DT, -1.0, 60.0, CENTRE, validate_args=True)
    with pytest.raises(ValueError, match="dt"):
        Brownian(np.array([1.0, -1.0]), 1.0, CENTRE, validate_args=True)
    CTCRW(DT, 1.0, 60.0, CENTRE, validate_args=True).log_prob(jnp.zeros((7, 2, 2)))


def test_inside_a_numpyro_model():
    def model():
        sigma = numpyro.sample("sigma_vel", dist.LogNormal(-1.0, 0.5))
        numpyro.sample("track", CTCRW(DT, sigma, 60.0, CENTRE))

    trace = numpyro.handlers.trace(numpyro.handlers.seed(model, 0)).get_trace()
    assert trace["track"]["value"].shape == (7, 2, 2)
    assert trace["track"]["fn"].is_chain
    total, _ = log_density(model, (), {}, {"sigma_vel": 0.4, "track": trace["track"]["value"]})
    want = CTCRW(DT, 0.4, 60.0, CENTRE).log_prob(trace["track"]["value"])
    want += dist.LogNormal(-1.0, 0.5).log_prob(0.4)
    assert float(total) == pytest.approx(float(want))


class TestTagsEndToEnd:
    """Several tags in one path: the product of the single ones, whatever their parameters."""

    TAG = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3])  # 3 is padding
    DT = np.random.default_rng(0).uniform(0.5, 2.0, 11)
    CENTRE = jnp.array([1.0, 2.0])
    LAWS = ((Brownian, (0.7,)), (CTCRW, (0.4, 3.0)))

    def both(self, law, values, start):
        """One path of all tags with parameters by tag, and the single tags' paths."""
        by_tag = [jnp.array([v, 2 * v, 3 * v]) for v in values]
        whole = law(self.DT, *by_tag, self.CENTRE, 10.0, tag=jnp.array(self.TAG), start=start)
        parts = []
        for k in range(4):
            rows = np.flatnonzero(k == self.TAG)
            own = [min(k + 1, 3) * v for v in values]
            parts.append((rows, law(self.DT[rows[:-1]], *own, self.CENTRE, 10.0, start=start)))
        return whole, parts

    @pytest.mark.parametrize(("law", "values"), LAWS, ids=["rw", "ctcrw"])
    @pytest.mark.parametrize("start", [None, SoftBox(-5 * jnp.ones(2), 6 * jnp.ones(2), 0.3)])
    def test_density_is_the_product(self, law, values, start):
        whole, parts = self.both(law, values, start)
        path = jax.jit(whole.sample)(jax.random.key(1))
        log_prob = jax.jit(lambda d, p: d.log_prob(p))
        total = sum(log_prob(part, path[rows]) for rows, part in parts)
        np.testing.assert_allclose(whole.log_prob(path), total, rtol=1e-12)
        np.testing.assert_allclose(log_prob(whole, path), total)

    @pytest.mark.parametrize(("law", "values"), LAWS, ids=["rw", "ctcrw"])
    def test_draws_have_the_stated_moments(self, law, values):
        whole, parts = self.both(law, values, None)
        draws = np.asarray(jax.jit(lambda key: whole.sample(key, (20_000,)))(jax.random.key(2)))
        np.testing.assert_allclose(draws.var(0), whole.variance, rtol=0.06)
        sd = np.sqrt(whole.variance)
        assert (np.abs(draws.mean(0) - whole.mean) < 5 * sd / np.sqrt(20_000)).all()
        for rows, part in parts:
            np.testing.assert_allclose(whole.variance[rows], part.variance, rtol=1e-12)
        # states of different tags are independent, those of one are not
        apart = np.corrcoef(draws[:, :, 0].reshape(20_000, 12, -1)[:, :, 0].T)
        other = self.TAG[:, None] != self.TAG
        assert np.abs(apart[other]).max() < 0.04
        assert apart[0, 1] > 0.9

    def test_shapes_are_checked(self):
        with pytest.raises(ValueError, match="end to end"):
            Brownian(self.DT, 1.0, self.CENTRE, tag=jnp.zeros(3, int))
