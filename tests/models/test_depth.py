"""Depth in the models: the density by hand, the block-tridiagonal Hessian, and known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from maloc._jax import jax
from maloc.data import WaterColumn, arrival_history
from maloc.data.sound_profile import SoundProfile
from maloc.errors import InputError
from maloc.infer._model import chain_model
from maloc.model_data import to_model_data
from maloc.models import joint, toa_track
from maloc.world.depth import depth_of
from simulations import depth as study

PROFILE = SoundProfile(
    np.array([0.0, 20.0, 35.0, 80.0]), np.array([[1510.0, 1508.0, 1470.0, 1465.0]])
)


@pytest.fixture(scope="module")
def simulated():
    """Eight pings, half of them with a depth; sensor's sd 1 m, water 80 m deep."""
    return study.simulate(np.random.default_rng(3), 8)


def point(cm, args, seed: int = 0):
    """A path near the middle of the array at depths within the water, and parameters."""
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, 1.0, (cm.length(args), cm.d))
    for site in cm.chain:
        if site.name == "track":
            x[:, site.columns.start : site.columns.start + 2] += 150.0
        if site.name == "emission":
            x[:, site.columns] -= 60.0
        if site.name == "depth_path":
            x[:, site.columns] = rng.uniform(1.0, 79.0, (len(x), 1))
    values = {k: np.asarray(v) for k, v in cm.prior_medians(args).items()}
    return x, cm.flat_globals(values | {"depth_level": 0.4, "depth_sd": 12.0, "depth_t05": 900.0})


def test_depth_between_the_bounds():
    z = np.array([-500.0, -3.0, 0.0, 20.0, 40.0, 77.0, 80.0, 500.0])
    found = np.asarray(depth_of(z, 80.0))
    assert (found >= 0).all() and (found <= 80).all() and (np.diff(found) >= 0).all()
    np.testing.assert_allclose(found[3:5], z[3:5], atol=1e-9)
    np.testing.assert_allclose(found + depth_of(80.0 - z, 80.0), 80.0)  # surface as bottom


@pytest.mark.parametrize("model", [pytest.param("toa", marks=pytest.mark.extended), "joint"])
def test_chain_against_dense_hessian(simulated, model):
    toa = simulated.toa.replace(column=WaterColumn(80.0, 1.0))
    toa = toa if model == "toa" else toa.replace(profile=PROFILE)
    how = {"error": "gaussian"} if model == "toa" else {"arrivals": "gaussian"}
    fn, data = (toa_track, toa) if model == "toa" else (joint, arrival_history(toa))
    args = (to_model_data(data, pad=False),)
    cm = chain_model(fn, how, args)
    x, u = point(cm, args)
    band = np.asarray(cm.exact(x, u, args, 0.0)[2])
    size = x.size
    dense = np.empty((size, size))
    step = 1e-4 * np.eye(size).reshape(size, *x.shape)
    for k in range(size):
        ahead, behind = (np.asarray(cm.gradient(x + s, u, args, 0.0)) for s in (step[k], -step[k]))
        dense[:, k] = (ahead - behind).ravel() / 2e-4
    built = np.zeros((size, size))
    for k, line in enumerate(band):
        built[np.arange(size - k) + k, np.arange(size - k)] = line[: size - k]
    np.testing.assert_allclose(np.tril(dense), built, atol=1e-6 * np.abs(dense).max())


def test_density_by_hand(simulated):
    """What depth adds to the density: slant ranges, the path's law, the sensor's."""
    toa = simulated.toa.replace(column=WaterColumn(80.0, 1.5))
    args, flat = (to_model_data(toa),), (to_model_data(simulated.toa),)
    how = {"error": "gaussian"}
    cm, plain = chain_model(toa_track, how, args), chain_model(toa_track, how, flat)
    x, u = point(cm, args)
    values = {k: np.asarray(v) for k, v in cm.values(x, u).items()}
    found = float(jax.jit(cm.log_joint)(x, u, args))
    rest = np.concatenate([x[:, s.columns] for s in cm.chain if s.name != "depth_path"], axis=1)
    before = float(jax.jit(plain.log_joint)(rest, plain.flat_globals(values), flat))

    data, z = args[0], values["depth_path"][:, 0]
    keep = 0.05 ** (np.asarray(data.dt) / 900.0)
    law = norm.logpdf(z[0], 0.4 * 80.0, 12.0)
    law += norm.logpdf(z[1:], 32.0 + keep * (z[:-1] - 32.0), 12.0 * np.sqrt(1 - keep**2)).sum()
    depth = 0.5 * (np.logaddexp(0, z / 0.5) - np.logaddexp(0, (z - 80.0) / 0.5))
    n = len(toa)
    says = np.flatnonzero(np.isfinite(toa.depth))
    law += norm.logpdf(toa.depth[says], depth[says], 1.5).sum()
    prior = norm.logpdf(np.log(12.0 / 16.0), 0, 0.7) + norm.logpdf(np.log(0.5), 0, 1.5)
    prior += np.log(0.4 * 0.6)  # a uniform level through a logit
    off = values["track"][:n, 0, None] - toa.receivers.xy
    level = np.sqrt((off**2).sum(-1) + 0.25)
    slant = np.sqrt(level**2 + (depth[:n, None] - toa.receivers.depth) ** 2)
    heard = toa.heard
    emission, sigma = values["emission"][:n, None], float(values["sigma"])
    said = np.asarray(data.range)[:n, : heard.shape[1]]

    def arrivals(away):
        return norm.logpdf(said, emission + away, sigma)[heard].sum()

    added = law + prior + arrivals(slant) - arrivals(level)
    assert found - before == pytest.approx(added, abs=1e-9 * abs(found))


def test_arrivals_take_the_mean_slowness_between_the_depths(simulated):
    """What a profile adds: each range is longer by the harmonic mean's share, by quadrature."""
    toa = simulated.toa.replace(column=WaterColumn(80.0, 1.5))
    plain, args = (to_model_data(toa),), (to_model_data(toa.replace(profile=PROFILE)),)
    how = {"error": "gaussian"}
    cm, before = chain_model(toa_track, how, args), chain_model(toa_track, how, plain)
    x, u = point(cm, args)
    gained = float(jax.jit(cm.log_joint)(x, u, args)) - float(
        jax.jit(before.log_joint)(x, u, plain)
    )
    values, n = {k: np.asarray(v) for k, v in cm.values(x, u).items()}, len(toa)
    depth = depth_of(values["depth_path"][:n, 0], 80.0)
    at = (np.arange(20_000) + 0.5) / 20_000
    down = toa.receivers.depth - depth[:, None]
    speed = np.interp(depth[:, None, None] + down[..., None] * at, PROFILE.depth, PROFILE.speed[0])
    slow = toa.sound_speed[:, None] * (1 / speed).mean(axis=-1)
    off = values["track"][:n, 0, None] - toa.receivers.xy
    slant = np.sqrt((off**2).sum(-1) + 0.25 + down**2)
    heard, said = toa.heard, np.asarray(args[0].range)[:n, : toa.heard.shape[1]]
    sigma, emission = float(values["sigma"]), values["emission"][:n, None]
    by_slow, by_plain = (
        norm.logpdf(said, emission + r, sigma)[heard].sum() for r in (slant * slow, slant)
    )
    assert gained == pytest.approx(by_slow - by_plain, rel=1e-6)
    assert abs(gained) > 1.0


def test_exact_depths_cost_no_path(simulated):
    known = simulated.toa.replace(depth=simulated.place[:, 2], column=WaterColumn(80.0, 0.0))
    args = (to_model_data(known),)
    assert args[0].depth.known
    flat = (to_model_data(simulated.toa),)
    assert chain_model(toa_track, {}, args).d == chain_model(toa_track, {}, flat).d
    one = simulated.toa.replace(depth=np.full(len(known), 12.0), column=WaterColumn(80.0, 0.0))
    assert to_model_data(one).depth.known


def test_what_cannot_be():
    toa = study.simulate(np.random.default_rng(0), 5).toa
    lost = toa.receivers.depth.copy()
    lost[2] = np.nan
    wrong = toa.replace(receivers=replace(toa.receivers, depth=lost), column=WaterColumn())
    with pytest.raises(InputError, match="receiver R2 has no depth"):
        to_model_data(wrong)
    with pytest.raises(InputError, match="below the bottom at 20 m"):
        to_model_data(toa.replace(depth=np.full(5, 40.0), column=WaterColumn(20.0)))
    with pytest.raises(InputError, match="not below the surface"):
        WaterColumn(-3.0)
    with pytest.raises(InputError, match="is negative"):
        WaterColumn(30.0, -1.0)
