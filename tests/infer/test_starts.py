"""Starts of the joint model: a beat smoothed, a grid searched."""

from typing import Any

import numpy as np
import pytest

from maloc.data import Schedule, arrival_history
from maloc.infer._beat import _smooth, smooth_beat
from maloc.infer._grid import grid_paths
from maloc.model_data import to_model_data
from tests.infer import cases

EXTENDED = pytest.mark.extended


def test_smoother_is_a_dense_gaussian_posterior():
    """Offsets of an integrated random walk with gaps, against the normal equations."""
    rng = np.random.default_rng(0)
    n = np.array([1, 3, 1, 2])
    y, precision, drift = rng.normal(0, 0.01, 5), np.array([1e4, 0.0, 1e5, 1e4, 2e4]), 3e-3
    # the path of every single interval: offset o and drift b, then the pings among them
    steps = int(n.sum())
    size = 1 + 1 + 2 * steps  # o0, b0, then shocks of b and jitters of o by step
    offset = np.zeros((steps + 1, size))
    b = np.zeros((steps + 1, size))
    offset[0, 0], b[0, 1] = 1.0, 1.0
    for k in range(steps):
        offset[k + 1] = offset[k] + b[k]
        offset[k + 1, 2 + steps + k] = 1.0
        b[k + 1] = b[k]
        b[k + 1, 2 + k] = 1.0
    prior = np.diag(np.concatenate([[1.0, 0.25], np.full(steps, drift**2), np.full(steps, 1e-8)]))
    at = np.concatenate([[0], np.cumsum(n)])
    cov = offset[at] @ prior @ offset[at].T
    seen = precision > 0
    gain = cov[:, seen] @ np.linalg.inv(cov[np.ix_(seen, seen)] + np.diag(1 / precision[seen]))
    mean = gain @ y[seen]
    sd = np.sqrt(np.diag(cov - gain @ cov[seen]))
    got = _smooth(y, precision, n, drift)
    np.testing.assert_allclose(got[0], mean, atol=1e-8)
    np.testing.assert_allclose(got[1], sd, rtol=1e-4)


def test_beat_leaves_wild_times_out_of_account():
    """A tenth of the times off by up to .2 s: the beat is found to a few milliseconds all the same,
    and foretold where there is no time at all."""
    rng = np.random.default_rng(1)
    size = 120
    true = np.cumsum(28.6 + np.cumsum(rng.normal(0, 2e-3, size)))
    time = true + rng.normal(0, 1e-3, size)
    wild = rng.random(size) < 0.1
    time[wild] += rng.uniform(0.05, 0.2, wild.sum())
    time[40:44] = np.nan
    step = np.full(size - 1, 28.6)
    smooth, sd = smooth_beat(time, np.full(size, 1e-3), step, np.ones(size - 1))
    off = np.abs(smooth - true)
    assert np.median(off) < 2e-3
    assert off.max() < 20e-3
    assert sd[42] > 1.3 * np.median(sd)


def test_grid_finds_the_track():
    """Six receivers, all heard: mean path within a cell or two; draws scatter about it."""
    toa, _, position = cases.toa(pings=30, unheard=(4,))
    data = to_model_data(arrival_history(toa))
    paths = grid_paths(data, None, None, 1.0, 0.4, 2, np.random.default_rng(0))
    assert paths.shape == (3, len(data.time), 2)
    off = np.linalg.norm(paths[0][:30] - position, axis=1)
    assert np.median(off) < 6.0
    assert off.max() < 30.0
    assert np.median(np.linalg.norm(paths[1][:30] - position, axis=1)) < 12.0


def test_silence_alone_places_a_tag_on_the_grid():
    """No arrival differences, but who heard each ping: better than the middle of the array."""
    rng = np.random.default_rng(2)
    toa, _, position = cases.toa(pings=40, unheard=())
    away = np.linalg.norm(position[:, None] - toa.receivers.xy, axis=2)
    heard = rng.random(away.shape) < np.exp(-0.5 * (away / 50) ** 2)
    one = np.zeros_like(heard)
    one[np.arange(40), np.where(heard, away, np.inf).argmin(axis=1)] = True
    sparse = toa.replace(toa=np.where(heard & one, toa.toa, np.nan))
    data = to_model_data(arrival_history(sparse, known=True))

    def hit(d):
        return -0.5 * (d / 50) ** 2

    def miss(d):
        return np.log1p(-np.minimum(np.exp(hit(d)), 1 - 1e-6))

    with_silence = grid_paths(data, miss, hit, 1.0, 0.4, 0, rng)[0][:40]
    middle = np.asarray(data.receiver_xy)[:6].mean(axis=0)
    off = np.linalg.norm(with_silence - position, axis=1).mean()
    assert off < 0.8 * np.linalg.norm(middle - position, axis=1).mean()


HOW: dict[str, Any] = {"range_drift": False}


@pytest.fixture(scope="module")
def fits():
    """Data, truth and Laplace fit of 24 pings, by schedule; made when first asked for."""
    import maloc

    made = {}

    def get(kind: str):
        if kind not in made:
            toa, emission, position = cases.toa(pings=24, unheard=(7, 8), kind=kind, seed=3)
            fit = maloc.infer.laplace(maloc.models.joint, arrival_history(toa), **HOW)
            made[kind] = toa, emission, position, fit
        return made[kind]

    return get


@EXTENDED
@pytest.mark.parametrize("kind", ["stable", "random"])
def test_joint_fit_of_a_schedule(fits, kind):
    """End to end: near the truth, emission times to some milliseconds."""
    toa, emission, position, fit = fits(kind)
    assert toa.schedule == Schedule(kind, *((25.0, 0.02) if kind == "stable" else (20.0, 30.0)))
    mean, cov = fit.moments()
    off = mean[:, :2] - position
    assert np.linalg.norm(off, axis=1)[toa.n_heard > 0].mean() < 4.0
    inside = np.abs(off) < 3 * np.sqrt(np.einsum("tii->ti", cov)[:, :2])
    assert inside.mean() > 0.9
    sent = fit.draws()["emission_time"].mean(axis=(0, 1))
    heard = toa.n_heard > 0
    assert np.abs(sent - emission)[heard].max() < 0.03
    if kind == "stable":  # the beat foretells the pings that nobody heard
        assert np.abs(sent - emission)[~heard].max() < 0.1


@EXTENDED
def test_svi_of_the_joint_model(fits):
    """SVI comes to the states of the Laplace fit: means and widths."""
    import maloc
    from maloc._jax import jax

    toa, _, _, fit = fits("random")
    history = arrival_history(toa)
    guided = maloc.infer.svi(jax.random.key(0), maloc.models.joint, history, progress=False, **HOW)
    (mean, cov), (close, near) = fit.moments(), guided.moments()
    sd = np.sqrt(np.einsum("tii->ti", cov))
    heard = toa.n_heard > 0
    assert np.abs((close - mean) / sd)[heard].mean() < 0.3
    ratio = np.sqrt(np.einsum("tii->ti", near)) / sd
    assert np.median(ratio[heard]) == pytest.approx(1.0, abs=0.2)
