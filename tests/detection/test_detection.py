"""Detection functions and encounter histories against loops, quadrature and finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import expit, logit

from maloc._jax import jax, jnp
from maloc.detection import (
    CAP,
    Encounters,
    encounters,
    linear_shift,
    log_probabilities,
    squared_distance,
)
from maloc.detection.curve import log_product

KINDS = [("halfnormal", None), ("logistic", None), ("hazard", 3.0)]
FALSE_ALARM = 1e-4  # chance that a right sampler fails a statistical test
every_kind = pytest.mark.parametrize(("kind", "shape"), KINDS)


def by_hand(kind, d, p0, scale, shape, shift: Any = 0.0):
    """Probability of hearing, straight from the paper's equations 3 to 5."""
    top = expit(logit(p0) + shift)
    if kind == "halfnormal":
        return top * np.exp(-(d**2) / (2 * scale**2))
    d = np.sqrt(d**2 + (0.1 * scale) ** 2)
    if kind == "logistic":
        return expit(logit(p0) + shift - d / scale)
    return top * (1 - np.exp(-((d / scale) ** -shape)))


@jax.jit
def log_prob_of(law, heard):
    return law.log_prob(heard)


@jax.jit
def what_it_says(law, heard):
    return law.log_prob(heard), law.log_unheard, law.mean


def problem(seed=1, n=12, k=11):
    """Positions, receivers, who listened, and who heard."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, 6, (n, 2))
    near_xy = rng.uniform(0, 6, (n, k, 2))
    listening = rng.uniform(size=(n, k)) < 0.8
    heard = (rng.uniform(size=(n, k)) < 0.3) & listening
    heard[:4] = False
    shift = rng.normal(0, 0.7, (n, k))
    return position, near_xy, listening, heard, shift


def history_by_hand(p, listening, heard, lost):
    """Log probability of one history, receiver by receiver."""
    total = 1.0
    for p_j, on, y in zip(p, listening, heard, strict=True):
        if on:
            total *= p_j if y else 1 - p_j
    return math.log((1 - lost) * total + (0.0 if heard.any() else lost))


# -- curves --------------------------------------------------------------------------------------


@every_kind
@pytest.mark.parametrize("shift", [None, 0.8, -2.0])
def test_curves_are_the_papers(kind, shape, shift):
    d = np.array([[0.0, 0.01, 0.3, 0.75, 1.5, 4.0, 9.0]])
    moved = None if shift is None else jnp.full(d.shape, shift)
    log_p, log_miss = log_probabilities(kind, d, 0.56, 0.75, shape, moved)
    want = CAP * by_hand(kind, d, 0.56, 0.75, shape, shift or 0.0)
    np.testing.assert_allclose(np.exp(log_p), want, rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(log_miss, np.log1p(-want), rtol=1e-9)


@pytest.mark.parametrize("d", [0.5, 1.0, 3.0])
def test_smoothed_cusp_is_eq_4_and_5_but_near_a_receiver(d):
    log_p, _ = log_probabilities("logistic", jnp.full((1, 1), d), 0.9, 1.0)
    np.testing.assert_allclose(np.exp(log_p), expit(logit(0.9) - d), rtol=0.01)
    log_p, _ = log_probabilities("hazard", jnp.full((1, 1), d), 1.0, 1.0, 4.0)
    want = 1 - np.exp(-((d**2) ** -2.0))  # eq. 5, theta 2
    np.testing.assert_allclose(np.exp(log_p), want, rtol=0.05)


@every_kind
@pytest.mark.parametrize("shifted", [False, True])
def test_derivatives_are_finite_at_a_receiver_and_far_away(kind, shape, shifted):
    receiver, listening = jnp.zeros((1, 1, 2)), jnp.ones((1, 1), bool)

    def score(xy, p0, scale, shift, heard):
        moved = jnp.full((1, 1), shift) if shifted else None
        law = encounters(kind, xy[None], receiver, listening, p0, scale, shape, shift=moved)
        return law.log_prob(jnp.full((1, 1), heard))[0]

    def elementwise(d, p0, scale, shift):
        moved = jnp.full((1, 1), shift) if shifted else None
        log_p, log_miss = log_probabilities(kind, jnp.full((1, 1), d), p0, scale, shape, moved)
        return (log_p + log_miss)[0, 0]

    @jax.jit
    @jax.vmap
    def everything(far, p0, shift, heard):
        at = jnp.stack([far, 0.0 * far]), p0, 0.75, shift, heard
        both = jax.value_and_grad(score, argnums=(0, 1, 2, 3))(*at)
        plain = jax.value_and_grad(elementwise, argnums=(0, 1, 2, 3))(far, p0, 0.75, shift)
        return both, jax.hessian(score, argnums=(0, 1, 2))(*at[:-2], shift, heard), plain

    at = np.meshgrid(
        [0.0, 1e-200, 1e-9, 0.5, 30.0, 1e4, 1e9],
        [1e-9, 0.5, 1 - 1e-12, 1.0],
        [-40.0, 0.0, 40.0] if shifted else [0.0],
        [False, True],
    )
    for leaf in jax.tree_util.tree_leaves(everything(*(np.ravel(a) for a in at))):
        assert np.all(np.isfinite(leaf))


OPTIONS: list[dict[str, Any]] = [{"p_lost": 0.2}, {"shift": 1}, {"dispersion": 0.6}]
EACH_ONCE = [  # each kind and each option; all their pairs in the long run
    pytest.param(*kind, option, marks=[pytest.mark.extended] if i != j else [])
    for i, kind in enumerate(KINDS)
    for j, option in enumerate(OPTIONS)
]


@pytest.mark.parametrize(("kind", "shape", "options"), EACH_ONCE)
def test_gradients_by_finite_differences(kind, shape, options: dict[str, Any]):
    position, near_xy, listening, heard, shift = problem(5)
    if "shift" in options:
        options = {"shift": jnp.asarray(shift)}

    @jax.jit
    def score(position, p0, scale):
        law = encounters(kind, position, near_xy, listening, p0, scale, shape, **options)
        return jnp.sum(law.log_prob(heard))

    at = jnp.asarray(position), 0.7, 1.2
    gradient = jax.jit(jax.grad(score, argnums=(0, 1, 2)))
    slopes = gradient(*at)
    step = 1e-5
    for i in (0, 5, 11):
        for axis in (0, 1):
            off = np.zeros(at[0].shape)
            off[i, axis] = step
            want = (score(at[0] + off, *at[1:]) - score(at[0] - off, *at[1:])) / (2 * step)
            np.testing.assert_allclose(slopes[0][i, axis], want, rtol=1e-5, atol=1e-7)
    want = [(score(at[0], 0.7 + step, 1.2) - score(at[0], 0.7 - step, 1.2)) / (2 * step)]
    want += [(score(at[0], 0.7, 1.2 + step) - score(at[0], 0.7, 1.2 - step)) / (2 * step)]
    np.testing.assert_allclose(slopes[1:], want, rtol=1e-5)
    # the engine's second derivatives: forward over reverse
    tangent = np.random.default_rng(0).normal(size=position.shape)
    push = jax.jit(lambda x, way: jax.jvp(lambda x: jax.grad(score)(x, *at[1:]), (x,), (way,))[1])
    ahead, behind = (gradient(at[0] + way, *at[1:])[0] for way in (step * tangent, -step * tangent))
    np.testing.assert_allclose(
        push(at[0], tangent), (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("k", [0, 1, 7, 8, 9, 100])
def test_log_product_is_the_sum_of_logs(k):
    rng = np.random.default_rng(k)
    x = jnp.asarray(10 ** rng.uniform(-30, 0, (4, k)))
    np.testing.assert_allclose(log_product(x), np.log(x).sum(axis=1), rtol=1e-12)
    slope = jax.jit(jax.grad(lambda x: jnp.sum(log_product(x))))(x)
    np.testing.assert_allclose(slope, 1 / x, rtol=1e-12)


def test_refusals():
    d = jnp.ones((1, 1))
    with pytest.raises(ValueError, match="none of"):
        log_probabilities("uniform", d, 0.5, 1.0)
    with pytest.raises(ValueError, match="takes a shape"):
        log_probabilities("hazard", d, 0.5, 1.0)
    with pytest.raises(ValueError, match="takes no shape"):
        log_probabilities("logistic", d, 0.5, 1.0, 2.0)


# -- histories -----------------------------------------------------------------------------------


@every_kind
@pytest.mark.parametrize("lost", [None, 0.0, 0.3, "each"])
@pytest.mark.parametrize("shifted", [False, True])
def test_histories_receiver_by_receiver(kind, shape, lost, shifted):
    position, near_xy, listening, heard, shift = problem()
    lost = np.linspace(0, 0.5, len(position)) if lost == "each" else lost
    law = encounters(
        kind, position, near_xy, listening, 0.7, 1.5, shape,
        shift=jnp.asarray(shift) if shifted else None, p_lost=lost,
    )  # fmt: skip
    d = np.linalg.norm(near_xy - position[:, None], axis=-1)
    p = CAP * by_hand(kind, d, 0.7, 1.5, shape, shift if shifted else 0.0)
    each = np.broadcast_to(0.0 if lost is None else lost, len(position))
    log_prob, log_unheard, mean = (np.asarray(x) for x in what_it_says(law, heard))
    for s in range(len(position)):
        want = history_by_hand(p[s], listening[s], heard[s], each[s])
        assert log_prob[s] == pytest.approx(want, rel=1e-9, abs=1e-12)
        silence = history_by_hand(p[s], listening[s], np.zeros_like(heard[s]), each[s])
        assert log_unheard[s] == pytest.approx(silence, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(mean[s], (1 - each[s]) * p[s] * listening[s], rtol=1e-9)


def test_probabilities_of_all_histories_sum_to_one():
    position, near_xy, listening, _, _ = problem(k=6)
    options: dict[str, Any]
    for options in ({}, {"p_lost": 0.3}, {"p_lost": 0.3, "dispersion": 1.0}):
        law = encounters("logistic", position, near_xy, listening, 0.7, 1.5, **options)
        every = np.array(np.meshgrid(*[[False, True]] * 6)).reshape(6, -1).T
        every = np.broadcast_to(every[:, None], (64, len(position), 6))
        possible = np.all(listening[None] | ~every, axis=2)
        total = np.sum(np.exp(log_prob_of(law, every)) * possible, axis=0)
        np.testing.assert_allclose(total, 1, rtol=1e-12)


@every_kind
@pytest.mark.parametrize("lost", [None, 0.2])
def test_dispersion_by_adaptive_quadrature(kind, shape, lost):
    position, near_xy, listening, heard, shift = problem(3)
    law = encounters(
        kind, position, near_xy, listening, 0.7, 1.5, shape,
        shift=jnp.asarray(shift), p_lost=lost, dispersion=0.7,
    )  # fmt: skip
    d = np.linalg.norm(near_xy - position[:, None], axis=-1)
    log_prob = np.asarray(log_prob_of(law, heard))
    for s in range(0, len(position), 2):

        def density(z, s=s):
            p = CAP * by_hand(kind, d[s], 0.7, 1.5, shape, shift[s] + 0.7 * z)
            return np.exp(history_by_hand(p, listening[s], heard[s], 0.0)) * stats.norm.pdf(z)

        whole, _ = integrate.quad(density, -9, 9, epsabs=0, epsrel=1e-9)
        pi = lost or 0.0
        want = np.log((1 - pi) * whole + (0.0 if heard[s].any() else pi))
        assert log_prob[s] == pytest.approx(want, abs=1e-4)


def test_pings_that_may_be_lost_never_break_at_sure_detection():
    """A hundred receivers at the animal, none heard it: it was lost; slopes are finite."""
    near_xy, nobody = jnp.zeros((1, 100, 2)), jnp.zeros((1, 100), bool)

    @jax.jit
    def score(lost, p0, xy):
        law = encounters("halfnormal", xy, near_xy, ~nobody, p0, 1.0, p_lost=lost)
        return law.log_prob(nobody)[0]

    both = jax.jit(jax.value_and_grad(score, argnums=(0, 1, 2)))
    for lost in (1e-12, 0.2):
        value, slopes = both(lost, 1.0, jnp.zeros((1, 2)))
        assert float(value) == pytest.approx(math.log(lost))
        assert float(slopes[0]) == pytest.approx(1 / lost)
        assert all(np.all(np.isfinite(s)) for s in slopes)
    assert np.isfinite(score(0.0, 1.0, jnp.zeros((1, 2))))


@pytest.mark.parametrize("options", [{}, {"p_lost": 0.3}, {"p_lost": 0.3, "dispersion": 1.5}])
def test_draws_have_the_histories_probabilities(options):
    position, near_xy, listening, _, _ = problem(k=4)
    law = encounters("hazard", position, near_xy, listening, 0.8, 3.0, 2.0, **options)
    n = 20_000
    drawn = np.asarray(jax.jit(lambda key: law.sample(key, (n,)))(jax.random.key(2)))
    assert drawn.shape == (n, 12, 4) and drawn.dtype == bool
    assert not np.any(drawn & ~listening)
    every = np.array(np.meshgrid(*[[False, True]] * 4)).reshape(4, -1).T
    code = drawn @ (2 ** np.arange(4))
    for s in (0, 7):
        on = np.all(listening[s] | ~every, axis=1)
        whole = np.broadcast_to(every[on][:, None], (on.sum(), 12, 4))
        expected = n * np.exp(np.asarray(log_prob_of(law, whole))[:, s])
        counts = np.bincount(code[:, s], minlength=16)[every[on] @ (2 ** np.arange(4))]
        assert stats.chisquare(counts, expected * n / expected.sum()).pvalue > FALSE_ALARM
    np.testing.assert_allclose(drawn.mean(axis=0), law.mean, atol=5 / math.sqrt(n))


def test_numpyros_habits():
    position, near_xy, listening, heard, shift = problem()
    law = encounters(
        "logistic", position, near_xy, listening, 0.7, 1.5,
        shift=jnp.asarray(shift), p_lost=0.1, dispersion=0.5,
    )  # fmt: skip
    want = np.asarray(law.log_prob(heard))
    assert law.local and law.batch_shape == (12,) and law.event_shape == (11,)
    some = jnp.asarray(np.arange(12) % 2 == 0)
    np.testing.assert_allclose(law.mask(some).log_prob(heard), want * some, rtol=1e-12)
    leaves, tree = jax.tree_util.tree_flatten(law)
    again = jax.tree_util.tree_unflatten(tree, leaves)
    np.testing.assert_array_equal(again.log_prob(heard), want)
    inside = jax.jit(lambda law, y: law.log_prob(y))(law, heard)
    np.testing.assert_allclose(inside, want, rtol=1e-10)
    assert bool(jnp.all(law.support(jnp.asarray(heard))))


def test_a_curve_of_ones_own():
    log_p = jnp.log(jnp.asarray([[0.2, 0.5, 0.9]]))
    law = Encounters(log_p, jnp.ones((1, 3), bool))
    heard = np.array([[True, False, True]])
    assert float(law.log_prob(heard)[0]) == pytest.approx(math.log(0.2 * 0.5 * 0.9))
    assert float(law.log_unheard[0]) == pytest.approx(math.log(0.8 * 0.5 * 0.1))


# -- covariates, effects, effective distance -----------------------------------------------------


def test_shift_by_covariates_and_receivers():
    rng = np.random.default_rng(0)
    covariates, receiver = rng.normal(size=(5, 3, 2)), rng.integers(0, 4, (5, 3))
    effects = rng.normal(size=4)
    coefficients = jnp.asarray([0.5, -2.0])
    shift: Any = linear_shift(covariates, coefficients, effects, receiver)
    for s in range(5):
        for k in range(3):
            want = 0.5 * covariates[s, k, 0] - 2 * covariates[s, k, 1] + effects[receiver[s, k]]
            assert shift[s, k] == pytest.approx(want)
    alone: Any = linear_shift(effects=effects, receiver=receiver)
    np.testing.assert_array_equal(alone, effects[receiver])
    assert linear_shift(covariates) is None


def test_a_wall_that_doubles_the_distance():
    def behind(position, near_xy):
        side = jax.nn.sigmoid(position[:, :1] / 0.01), jax.nn.sigmoid(near_xy[..., 0] / 0.01)
        apart = side[0] * (1 - side[1]) + (1 - side[0]) * side[1]
        return squared_distance(position, near_xy) * (1 + apart) ** 2

    position = jnp.asarray([[1.0, 0.0]])
    near_xy = jnp.asarray([[[3.0, 0.0], [-1.0, 0.0]]])
    law = encounters(
        "halfnormal", position, near_xy, jnp.ones((1, 2), bool), 0.5, 2.0, squared=behind
    )
    want = CAP * 0.5 * np.exp(-(np.array([2.0, 4.0]) ** 2) / 8)
    np.testing.assert_allclose(law.mean[0], want, rtol=1e-9)
