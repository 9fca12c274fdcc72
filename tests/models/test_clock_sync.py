"""The clock model in NumPyro against `maloc.sync.fit`, which is linear algebra of its own."""

from typing import Any

import numpy as np
import pytest
from numpyro import handlers
from numpyro.infer import MCMC, NUTS
from scipy.stats import multivariate_normal

import maloc.infer
from maloc import sync
from maloc._jax import jax, jnp
from maloc.model_data.clock_pings import as_clock_pings
from maloc.models import clock_sync
from maloc.simulate.sync_array import sync_array
from maloc.world.clock_walk import ClockWalk

ARRAY = sync_array(
    np.random.default_rng([4, 7]), 3, 0.12, jumps=(0, 0), interval=(250.0, 350.0), offset=100.0
)


@pytest.fixture(scope="module")
def fitted():
    how = {"sound_speed": "constant", "progress": False}
    return sync.fit(ARRAY.detections, ARRAY.receivers, **how)


@pytest.fixture(scope="module")
def laplace(fitted):
    return maloc.infer.laplace(clock_sync, fitted, draws=400)


def test_walk_is_normal_with_the_covariance_of_its_steps():
    """SciPy's normal density, the covariance built from the noise that each step adds."""
    rng = np.random.default_rng(0)
    dt, noise, first = np.array([0.3, 1.1, 0.05]), np.array([0.4, 2.0]), (5.0, 3.0)
    curves = rng.normal(0, 4, (4, 2, 2))
    law = ClockWalk(jnp.asarray(dt), jnp.asarray(noise), jnp.asarray(curves), first)
    density, value = jax.jit(law.log_prob), np.asarray(law.sample(jax.random.key(5)))
    total = 0.0
    for c, q in enumerate(noise**2):
        moves = np.zeros((4, 2, 4, 2))  # state at t from the noise of step s
        for s in range(4):
            moves[s, :, s] = np.eye(2)
            for t in range(s + 1, 4):
                moves[t, :, s] = np.array([[1, dt[t - 1]], [0, 1]]) @ moves[t - 1, :, s]
        own = np.zeros((4, 2, 4, 2))
        own[0, :, 0] = np.diag(np.square(first))
        for s, h in enumerate(dt, 1):
            own[s, :, s] = q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
        move, own = moves.reshape(8, 8), own.reshape(8, 8)
        start = curves[0, :, c]
        mean = moves[:, :, 0] @ start
        walk = (curves + value)[..., c].ravel()
        spread: Any = move @ own @ move.T
        total += multivariate_normal.logpdf(walk, mean.ravel(), spread)
        straight = (np.asarray(law.mean) + curves)[..., c]
        np.testing.assert_allclose(straight, mean, atol=1e-12)
    assert float(density(jnp.asarray(value))) == pytest.approx(total, rel=1e-6)


def test_walk_samples_have_its_spread():
    law = ClockWalk(jnp.array([0.5, 2.0]), jnp.array([0.7]), jnp.ones((3, 2, 1)), (2.0, 0.3))
    x = np.asarray(law.sample(jax.random.key(0), (4000,)))[..., 0] + 1  # the curves are ones
    q, t = 0.49, 2.5
    var = 4.0 + 0.09 * t**2 + q * (0.5**3 / 3 + 2.0**3 / 3 + 2.0**2 * 0.5 + 2.0 * 0.5**2)
    assert x[:, 2, 0].var() == pytest.approx(var, rel=0.1)
    assert x[:, 2, 1].var() == pytest.approx(0.09 + q * t, rel=0.1)
    assert x[:, 2].mean(0) == pytest.approx([1 + t, 1.0], abs=0.15)


def test_arrivals_at_the_start_are_those_of_the_fit(fitted):
    """Nothing departed from: the residuals are those that the linear fit found."""
    data = as_clock_pings(fitted)
    still = {n: jnp.asarray(v) for n, v in data.start.items()}
    still |= {"clock": jnp.zeros_like(data.curves), "emission": jnp.zeros_like(data.emission)}

    @jax.jit
    def start(values):
        known = handlers.substitute(handlers.seed(clock_sync, 0), values)
        trace = handlers.trace(known).get_trace(data)
        found = {n: trace[n]["value"] for n in ("delay", "shift", "sound_speed")}
        return trace["arrival"]["fn"].base_dist.loc, found

    loc, found = start(still)
    ours = np.asarray(data.arrival - loc)[np.asarray(data.heard)] / 1e3
    theirs = fitted.residuals.residual[np.isfinite(fitted.residuals.p_direct)]
    assert len(ours) == len(theirs)
    np.testing.assert_allclose(np.sort(ours), np.sort(theirs), atol=3e-6)
    assert np.asarray(found["delay"]) == pytest.approx(1e3 * fitted.delay)
    assert np.asarray(found["shift"]) == pytest.approx(fitted.shift)
    assert float(found["sound_speed"]) == pytest.approx(fitted.sound_speed)


def agree(fit, fitted, within, width):
    """Offsets at the knots, delays and sound speed, in standard errors of the linear fit."""
    found = fit.draws()
    draws = {
        k: found[k].reshape(-1, *found[k].shape[2:]) for k in ("offset", "delay", "sound_speed")
    }
    others = [n != fitted.reference for n in fitted.receivers.names]
    known, sd = fitted.values[others].T, fitted.values_sd[others].T
    off = (draws["offset"].mean(0) - known) / sd
    assert np.sqrt(np.mean(off**2)) < within
    assert np.abs(draws["offset"].std(0) / sd - 1).max() < width
    for name, value, sd in (
        ("delay", 1e3 * fitted.delay, 1e3 * fitted.delay_sd),
        ("sound_speed", fitted.sound_speed, fitted.sound_speed_sd),
    ):
        assert np.abs((draws[name].mean(0) - value) / sd).max() < within
        assert np.abs(draws[name].std(0) / sd - 1).max() < width


def test_laplace_agrees_with_the_linear_fit(laplace, fitted):
    # 400 draws: a mean is known to .05, a standard deviation to 4 %
    assert not laplace.warnings
    agree(laplace, fitted, 0.25, 0.2)


def test_residuals_are_those_of_the_linear_fit(laplace, fitted):
    found, direct = laplace.residuals(), laplace.p_direct()
    heard = np.asarray(laplace.args[0].heard)
    np.testing.assert_array_equal(np.isfinite(found), heard)
    assert ((direct[heard] >= 0) & (direct[heard] <= 1)).all()
    theirs = fitted.residuals
    clear = theirs.p_direct > 0.99  # late ones pull the two laws differently
    ours = np.sort(found[heard][direct[heard] > 0.99])
    assert np.std(ours) == pytest.approx(np.std(theirs.residual[clear]), rel=0.1)
    assert abs(np.mean(clear) - np.mean(direct[heard] > 0.99)) < 0.1


@pytest.mark.extended
def test_nuts_mixes_and_agrees(laplace, fitted):
    """Late arrivals in the law: two chains say the same, and what the linear fit says."""
    found = maloc.infer.nuts(jax.random.key(0), laplace, draws=500, progress=False)
    assert not found.warnings  # an R-hat above 1.05 would be one
    agree(found, fitted, 0.3, 0.25)


@pytest.mark.extended
def test_plain_nuts_runs(fitted):
    sampler = MCMC(NUTS(clock_sync, max_tree_depth=4), num_warmup=5, num_samples=5,
                   progress_bar=False)  # fmt: skip
    sampler.run(jax.random.key(3), as_clock_pings(fitted), position_sd=0.0, noise="given")
    assert np.isfinite(sampler.get_samples()["offset"]).all()


@pytest.mark.parametrize("wrong", [{"error": "t"}, {"noise": "none"}, {"position_sd": -1.0}])
def test_unknown_options_are_refused(fitted, wrong):
    with pytest.raises(ValueError, match="is none of|at least 0"):
        handlers.trace(handlers.seed(clock_sync, 0)).get_trace(fitted, **wrong)


def test_what_is_held_stays(fitted):
    data = as_clock_pings(fitted)

    @jax.jit
    def run(key):
        seeded = handlers.seed(clock_sync, key)
        trace = handlers.trace(seeded).get_trace(
            data, position_sd=0.0, sound_speed="given", error="gaussian", noise="given"
        )
        assert "clock_noise" not in trace and "w" not in trace
        return {n: trace[n]["value"] for n in ("shift", "sound_speed", "delay")}

    one, two = run(jax.random.key(0)), run(jax.random.key(1))
    assert np.asarray(one["shift"]) == pytest.approx(fitted.shift)
    assert float(one["sound_speed"]) == pytest.approx(fitted.sound_speed)
    assert np.ptp([one["delay"], two["delay"]], axis=0).min() > 1e-3
