"""Receivers that err for good: dense linear algebra, known truths, and arrays that do not err."""

from typing import Any

import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from scipy.stats import multivariate_normal

import maloc.infer
from maloc._jax import jax, jnp
from maloc.arrival import Gaussian
from maloc.infer._effects import LEVEL, standing_errors
from maloc.infer._model import chain_model
from maloc.infer.marginal import maximise_marginal
from maloc.models import toa_track
from simulations.wrong_arrivals import wrong_arrivals
from tests.infer import cases

EFFECT, SIGMA, STEP = 0.8, 0.5, 1.3


def linear(seen, heard):
    """A walk seen by receivers, each off by an effect of its own: all of it normal."""
    length, receivers = seen.shape
    path = dist.GaussianRandomWalk(STEP, length)
    x: Any = numpyro.sample("path", path, infer={"is_chain": True})
    each = dist.Normal(0.0, 1.0).expand([receivers]).to_event(1)
    z: Any = numpyro.sample("effect", each, infer={"inner": "receiver"})
    slope = jnp.linspace(0.5, 1.5, receivers)
    law = Gaussian(x[:, None] * slope[None] + EFFECT * z[None], SIGMA)
    numpyro.sample("seen", law.mask(heard), obs=seen, infer={"per_state": True})


@pytest.fixture(scope="module")
def dense():
    """Data of `linear`; mean and covariance of (path, effects) and log evidence by the book."""
    rng = np.random.default_rng(3)
    length, receivers = 9, 4
    heard = rng.random((length, receivers)) < 0.8
    # the walk starts at N(0, STEP) and adds as much each time
    walk = STEP**2 * np.minimum(*np.meshgrid(*[np.arange(1, length + 1)] * 2))
    prior = np.zeros((length + receivers,) * 2)
    prior[:length, :length], prior[length:, length:] = walk, np.eye(receivers)
    t, r = np.nonzero(heard)
    design = np.zeros((len(t), length + receivers))
    design[np.arange(len(t)), t] = np.linspace(0.5, 1.5, receivers)[r]
    design[np.arange(len(t)), length + r] = EFFECT
    spread: Any = design @ prior @ design.T + SIGMA**2 * np.eye(len(t))
    drawn = rng.multivariate_normal(np.zeros(len(t)), spread)
    seen = np.zeros((length, receivers))
    seen[t, r] = drawn
    gain = np.linalg.solve(spread, design @ prior).T
    evidence = multivariate_normal(np.zeros(len(t)), spread).logpdf(drawn)
    return (
        (jnp.asarray(seen), jnp.asarray(heard)),
        gain @ drawn,
        prior - gain @ design @ prior,
        evidence,
    )


def test_path_and_effects_are_the_dense_posterior(dense):
    args, mean, covariance, evidence = dense
    cm = chain_model(linear, {}, args)
    assert len(cm.inner) == 4 and not len(cm.outer)
    fit = maximise_marginal(cm, args, np.zeros((9, 1)), np.zeros(4))
    np.testing.assert_allclose(np.r_[fit.x[:, 0], fit.u], mean, atol=1e-7)
    np.testing.assert_allclose(fit.covariance, covariance[9:, 9:], atol=1e-9)
    # densities of 13 normal numbers stand in the value; the integral is over as many
    constant = 0.5 * 13 * np.log(2 * np.pi)
    assert -fit.value + constant == pytest.approx(evidence, abs=1e-8)
    whole = maloc.infer.laplace(linear, *args, draws=20_000)
    at, spread = whole.moments()
    np.testing.assert_allclose(at[:, 0], mean[:9], atol=1e-7)
    np.testing.assert_allclose(spread[:, 0, 0], np.diag(covariance)[:9], atol=1e-9)
    drawn = whole.draws()
    both = np.concatenate([drawn["path"][0], drawn["effect"][0]], axis=1)
    np.testing.assert_allclose(np.cov(both.T), covariance, atol=0.03)


def test_border_is_the_hessian_where_all_is_normal(dense):
    args = dense[0]
    cm = chain_model(linear, {}, args)
    rng = np.random.default_rng(0)
    x, u = jnp.asarray(rng.normal(size=(9, 1))), jnp.asarray(rng.normal(size=4))

    def joint(flat):
        return -cm.log_joint(flat[:9, None], flat[9:], args)

    wanted = jax.jit(jax.hessian(joint))(jnp.concatenate([x[:, 0], u]))
    mixed, block = cm.border(x, u, args)
    np.testing.assert_allclose(mixed[:, :, 0], wanted[9:, :9], atol=1e-10)
    np.testing.assert_allclose(block + np.eye(4), wanted[9:, 9:], atol=1e-10)


@pytest.fixture(scope="module")
def moved():
    """A track in an array whose third receiver stands 4 m from where its table says."""
    toa, _, position = cases.toa(seed=5, pings=24, sigma=0.3, p_late=0.0, unheard=())
    x = toa.receivers.x.copy()
    x[2] += 4.0
    told = cases.receivers(np.column_stack([x, toa.receivers.y]))
    return toa, toa.replace(receivers=told), position


def test_a_receiver_elsewhere_is_found(moved):
    true, told, position = moved
    fit = maloc.infer.laplace(toa_track, told)
    assert fit.options["receivers"] == "estimated"
    shift = fit.draws()["receiver_moved"]
    assert shift.shape[2:] == (6, 2)
    at, sd = shift.mean((0, 1)), shift.std((0, 1))
    off = np.zeros((6, 2))
    off[2, 0] = -4.0
    assert (np.abs(at - off) < 3 * sd).all()
    assert at[2, 0] < -2
    exact = maloc.infer.laplace(toa_track, told, receivers="exact")
    error = [np.linalg.norm(f.positions()[0] - position, axis=1).mean() for f in (fit, exact)]
    assert error[0] < 0.8 * error[1]
    right = maloc.infer.laplace(toa_track, true)
    assert right.options["receivers"] == "exact"


def test_right_receivers_are_left_alone():
    """P values of arrays without standing errors are those of chance."""
    found = []
    for seed in range(12):
        toa, _, _ = cases.toa(seed=20 + seed, pings=30, p_late=0.05, unheard=())
        fit = maloc.infer.laplace(toa_track, toa, receivers="exact")
        m = fit.marginal
        found.append(standing_errors(fit.cm, fit.args, m.x, m.u, m.factor))
    assert np.mean(np.array(found) < LEVEL) < 0.25
    assert 0.2 < np.median(found)


@pytest.mark.extended
def test_the_sampler_agrees():
    """Without Laplace: positions by NUTS, whose target is the density alone."""
    toa, _ = wrong_arrivals(np.random.default_rng(9), "wrong2all")
    fit = maloc.infer.laplace(toa_track, toa, receivers="estimated")
    drawn = maloc.infer.nuts(jax.random.key(1), fit, draws=500, progress=False)
    ours, theirs = fit.positions(), drawn.positions()
    sd = np.sqrt(np.einsum("tii->ti", theirs[1]))
    assert np.median(np.abs(ours[0] - theirs[0]) / sd) < 0.3
    assert 0.8 < np.median(np.sqrt(np.einsum("tii->ti", ours[1])) / sd) < 1.2


@pytest.mark.extended
@pytest.mark.parametrize("case", ["right", "wrong2all"])
def test_intervals_hold(case):
    """A share of .95 within the limits, over tracks of arrays that err and do not."""
    inside = []
    for seed in range(12):
        toa, position = wrong_arrivals(np.random.default_rng([4, seed]), case)
        low, high = maloc.infer.laplace(toa_track, toa).positions()[2:]
        inside.append(((low < position) & (position < high)).mean())
    assert 0.88 < np.mean(inside) < 0.99
