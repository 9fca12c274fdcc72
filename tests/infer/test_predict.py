"""Prediction against dense joint normals of states, times asked for and observations."""

import mpmath
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import maloc.infer
from maloc._jax import jnp
from maloc.errors import FitError, InputError
from maloc.infer._paths import path_draws
from maloc.infer.predict import TrackDraws, mixture
from maloc.movement import CTCRW, OU, Brownian
from tests import oracles
from tests.infer import cases

NOISE, SPREAD = 0.7, 10.0
TIMES = np.array([4.3, -2.0, 0.0, 7.7, 1e-3, 25.0, 40.0])  # in no order, and beyond the data
SIGMA, T05, HOME = 1.2, 6.0, np.array([3.0, -2.0])


def seen(path, observed):
    numpyro.sample("fix", dist.Normal(path, NOISE), obs=observed)


def brownian(dt, observed):
    seen(numpyro.sample("track", Brownian(dt, SIGMA, jnp.zeros(2), SPREAD)), observed)


def ctcrw(dt, observed):
    path = jnp.asarray(numpyro.sample("track", CTCRW(dt, SIGMA, T05, jnp.zeros(2), SPREAD)))
    seen(path[:, 0], observed)


def ou(dt, observed):
    seen(numpyro.sample("track", OU(dt, 5.0, T05, jnp.asarray(HOME))), observed)


def _prior(model, every, start):
    """Covariance of positions, then velocities, of one axis; start: index of the first state."""
    if model is ou:
        return 25.0 * 0.05 ** (np.abs(np.subtract.outer(every, every)) / T05)
    if model is brownian:  # from the first state both ways
        t = every - every[start]
        same = np.sign(t)[:, None] == np.sign(t)
        least = np.minimum.outer(np.abs(t), np.abs(t))
        return SPREAD**2 + SIGMA**2 * np.where(same, least, 0.0)
    beta = -np.log(0.05) / T05
    whole = oracles.ctcrw_covariance(every, SIGMA, mpmath.mpf(beta), 0.0)
    joint = oracles.as_floats(whole)
    n = len(every)  # positions from the first state: x - x[start], with a start of its own
    move = np.eye(2 * n)
    move[:n, start] -= 1.0
    joint = move @ joint @ move.T
    joint[:n, :n] += SPREAD**2
    return joint


def dense(model, dt, observed, times):
    """Posterior mean (n, d) and covariance (n, d, d) by conditioning one big normal."""
    clock = np.concatenate([[0.0], np.cumsum(np.asarray(dt))])
    every = np.unique(np.concatenate([clock, times]))
    joint = _prior(model, every, int(np.searchsorted(every, 0.0)))
    at = np.searchsorted(every, clock)
    gain = joint[:, at] @ np.linalg.inv(joint[np.ix_(at, at)] + NOISE**2 * np.eye(len(at)))
    centre = HOME if model is ou else np.zeros(2)
    mean = gain @ (np.asarray(observed) - centre)
    mean[: len(every)] += centre
    covariance = joint - gain @ joint[at]
    order = len(joint) // len(every)
    pick = np.searchsorted(every, times)[:, None] + len(every) * np.arange(order)
    block = covariance[pick[:, :, None], pick[:, None]]  # (n, order, order)
    both = np.einsum("tij,ab->tiajb", block, np.eye(2)).reshape(len(times), 2 * order, -1)
    return mean[pick].reshape(len(times), -1), both


@pytest.mark.parametrize("model", [brownian, ctcrw, ou])
def test_equals_a_dense_computation(model):
    dt, observed = cases.fixes_data()
    fit = maloc.infer.laplace(model, dt, observed)
    found = fit.predict(TIMES)
    mean, covariance = dense(model, dt, observed, TIMES)
    np.testing.assert_allclose(found.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9, atol=1e-9)
    end = float(jnp.sum(dt))
    np.testing.assert_array_equal(found.within, (TIMES >= 0) & (TIMES <= end))
    np.testing.assert_allclose(found.sd[:, 1] ** 2, covariance[:, 1, 1])
    np.testing.assert_array_equal(found.position, found.mean[:, :2])


def test_at_the_states_it_is_what_the_fit_says(laplace_fit):
    """Arrival times: states stand at their emission times, parameters are estimated."""
    mean, covariance = laplace_fit.moments()
    site = next(s for s in laplace_fit.cm.chain if s.name == "track")
    m = laplace_fit.marginal
    clock = laplace_fit.cm.natural(m.x, m.u, laplace_fit.args)["emission_time"]
    found = laplace_fit.predict(np.asarray(clock)[: laplace_fit.n_states])
    np.testing.assert_allclose(found.mean, mean[:, site.columns], atol=1e-8)
    wanted = covariance[:, site.columns, site.columns]
    # a state's own time moves with the parameters: by microseconds
    np.testing.assert_allclose(found.covariance, wanted, rtol=2e-3, atol=1e-4)
    between = laplace_fit.predict(0.5 * (clock[3] + clock[4]))
    assert (between.sd > np.minimum(found.sd[3], found.sd[4])).all()


def test_parameters_widen_it_by_how_the_mean_moves(fixes_fit):
    dt, observed = (np.asarray(a) for a in cases.fixes_data())
    times = np.array([2.2, 9.1, 30.0])
    m = fixes_fit.marginal

    def at(u):
        sigma, noise = np.exp(u)
        clock = np.concatenate([[0.0], np.cumsum(dt)])
        every = np.unique(np.concatenate([clock, times]))
        joint = oracles.brownian_covariance(every, sigma, cases.SPREAD)
        at = np.searchsorted(every, clock)
        gain = joint[:, at] @ np.linalg.inv(joint[np.ix_(at, at)] + noise**2 * np.eye(len(at)))
        pick = np.searchsorted(every, times)
        return (gain @ observed)[pick], (joint - gain @ joint[at])[pick, pick]

    mean, variance = at(m.u)
    step = 1e-4
    moved = [(at(m.u + step * e)[0] - at(m.u - step * e)[0]) / (2 * step) for e in np.eye(2)]
    spread = np.einsum("kti,kl,ltj->tij", moved, m.covariance, moved)
    found = fixes_fit.predict(times)
    np.testing.assert_allclose(found.mean, mean, atol=1e-5)
    wanted = variance[:, None, None] * np.eye(2) + spread
    np.testing.assert_allclose(found.covariance, wanted, rtol=1e-4, atol=1e-7)
    assert (np.einsum("tii->ti", spread) > 1e-6).any()


def test_a_sampled_fit_is_the_mixture_of_its_draws(sampled_fit):
    """Mean and covariance of one bridge a draw, worked out draw by draw."""
    clock = sampled_fit.draws()["emission_time"].reshape(-1, sampled_fit.n_states)
    middle = 0.5 * (clock[:, 5] + clock[:, 6]).mean()
    path = path_draws(sampled_fit).take(np.arange(0, 400, 4))
    found = mixture(path, np.array([middle]))
    means, variances = [], []
    for d in range(len(path.clock)):
        some = CTCRW.step(
            middle - path.clock[d, 5], path.scale["sigma_vel"][d], path.scale["t05"][d]
        )
        rest = CTCRW.step(
            path.clock[d, 6] - middle, path.scale["sigma_vel"][d], path.scale["t05"][d]
        )
        # by precisions: what comes from before, and what must lead to the state after
        prior = np.linalg.inv(some[1])
        ahead = rest[0].T @ np.linalg.inv(rest[1])
        variance = np.linalg.inv(prior + ahead @ rest[0])
        means.append(variance @ (prior @ some[0] @ path.state[d, 5] + ahead @ path.state[d, 6]))
        variances.append(variance)
    flat = np.array(means).reshape(len(means), -1)
    wanted = np.cov(flat.T, bias=True) + np.kron(np.mean(variances, axis=0), np.eye(2))
    np.testing.assert_allclose(found.mean[0], flat.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(found.covariance[0], wanted, rtol=1e-8, atol=1e-12)


def test_whole_tracks_have_the_predicted_moments(fixes_fit):
    times = np.array([-3.0, 1.0, 1.5, 8.0, 33.0])
    tracks = fixes_fit.sample_tracks(times, n=20_000, seed=3, name="A", crs="EPSG:32617")
    assert (len(tracks), tracks.tag, tracks.crs, tracks.velocity) == (
        20_000,
        "A",
        "EPSG:32617",
        None,
    )
    # seven parts in a hundred thousand beyond five standard errors; the parameters are not normal
    # once they are exponentiated, so moments are those of the mixture rather than of `predict`
    found = mixture(path_draws(fixes_fit, n=20_000, seed=3), times)
    error = found.sd / np.sqrt(20_000)
    assert (np.abs(tracks.position.mean(0) - found.position) < 5 * error).all()
    np.testing.assert_allclose(tracks.position.std(0), found.sd, rtol=0.03)
    near = np.corrcoef(tracks.position[:, 1, 0], tracks.position[:, 2, 0])[0, 1]
    assert near > 0.5  # times half a second apart go together
    again = fixes_fit.sample_tracks(times, n=20_000, seed=3)
    np.testing.assert_array_equal(again.position, tracks.position)


def two_tags(dt, tag, observed, by_tag):
    """Two tags end to end, each with a step of its own where asked."""
    sigma = jnp.array([0.8, 2.0]) if by_tag else 1.2
    law = Brownian(dt, sigma, jnp.zeros(2), SPREAD, tag=tag)
    seen(numpyro.sample("track", law), observed)


@pytest.mark.parametrize("by_tag", [False, True])
def test_each_of_several_tags_is_as_if_alone(by_tag):
    dt, observed = cases.fixes_data()
    tag = jnp.asarray([0] * 6 + [1] * 8)
    both = maloc.infer.laplace(two_tags, dt, tag, observed, by_tag=by_tag)
    for k, rows in enumerate((slice(0, 6), slice(6, 14))):

        def alone(dt, observed, sigma):
            seen(numpyro.sample("track", Brownian(dt, sigma, jnp.zeros(2), SPREAD)), observed)

        sigma = (0.8, 2.0)[k] if by_tag else 1.2
        one = maloc.infer.laplace(alone, dt[rows.start : rows.stop - 1], observed[rows], sigma)
        found, wanted = both.predict(TIMES, tag=k), one.predict(TIMES)
        np.testing.assert_allclose(found.mean, wanted.mean, atol=1e-9)
        np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-9)
        np.testing.assert_array_equal(found.within, wanted.within)
    with pytest.raises(InputError, match="no tag 2"):
        both.predict(TIMES, tag=2)


def test_bad_input_is_named(fixes_fit):
    with pytest.raises(InputError, match="finite"):
        fixes_fit.predict([1.0, np.nan])
    with pytest.raises(InputError, match="ascend"):
        fixes_fit.sample_tracks([2.0, 1.0])
    with pytest.raises(InputError, match="do not go with"):
        TrackDraws(np.arange(3.0), np.zeros((5, 2, 2)))
    observed = jnp.asarray(np.random.default_rng(0).poisson(3.0, 12))
    counted = maloc.infer.laplace(cases.counts, observed, path=("level",))
    with pytest.raises(FitError, match="one path of maloc.movement"):
        counted.predict([0.0])
