"""Straight rays through layers: quadrature, gradients, and Bellhop's arrivals."""

import json

import jax
import numpy as np
import polars as pl
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from maloc.world.medium import chen_millero
from maloc.world.ray import mean_slowness, ray_data

KNOT = np.array([0.0, 3.0, 6.0, 6.4, 9.0, 12.0])
SPEED = np.array([[1494.0, 1494.0, 1480.0, 1450.0, 1448.0, 1447.0]])


def test_mean_slowness_against_quadrature():
    tag = np.array([-0.5, 1.0, 5.0, 6.2, 8.999, 9.0, 11.0, 11.003, 13.0])
    receiver = np.array([0.5, 6.3, 11.0, 14.0])
    got = mean_slowness(ray_data(KNOT, SPEED, np.full(len(tag), 1500.0)), tag, receiver)
    for i, a in enumerate(tag):
        for j, b in enumerate(receiver):
            inside = KNOT[(min(a, b) < KNOT) & (max(a, b) > KNOT)]
            whole = quad(lambda z: 1 / np.interp(z, KNOT, SPEED[0]), a, b, points=inside)[0]
            expected = whole / (b - a) if a != b else 1 / np.interp(a, KNOT, SPEED[0])
            assert got[i, j] == pytest.approx(1500.0 * expected, rel=1e-9)


@pytest.mark.compiles
def test_a_profile_a_state_and_padding():
    """Each state has its own row of speeds, in JAX as in NumPy."""
    rows = np.concatenate([SPEED, SPEED + 10.0, SPEED[:, ::-1]])
    tag, receiver, reference = (
        np.array([1.0, 4.0, 7.0]),
        np.array([2.0, 11.0]),
        np.array([1.0, 2, 3]),
    )
    ray = ray_data(KNOT, rows, reference)
    got = mean_slowness(ray, tag, receiver)
    for i in range(3):
        alone = ray_data(KNOT, rows[i : i + 1], reference[i : i + 1])
        np.testing.assert_allclose(got[i : i + 1], mean_slowness(alone, tag[i : i + 1], receiver))
    traced = jax.jit(lambda z: mean_slowness(ray, z, receiver))(tag)
    np.testing.assert_allclose(traced, got, rtol=1e-13)


@pytest.mark.compiles
def test_gradient_across_layers_and_at_the_receivers_depth():
    receiver = np.array([6.3])
    ray = ray_data(KNOT, SPEED, np.ones(1))

    def slow(z):
        return 1e6 * mean_slowness(ray, z[None], receiver)[0, 0]

    for z in (1.0, 2.9999, 6.1, 6.2951, 6.35, 8.0, 11.0):
        step = 1e-4
        by_hand = (slow(np.asarray(z + step)) - slow(np.asarray(z - step))) / (2 * step)
        assert float(jax.grad(slow)(z)) == pytest.approx(float(by_hand), rel=1e-4, abs=1e-4)


def thermocline(params: dict) -> np.ndarray:
    """Sound speed every cm of fresh water, 24 deg C above and 10 below 6.5 m (the data's README).

    The width of the step is what the stated speed at the receivers' depth tells.
    """
    depth = np.arange(0.0, 12.005, 0.01)

    def speed(width, z):
        return chen_millero(10.0 + 14.0 / (1 + np.exp((z - 6.5) / width)), 0.0, z)

    width = brentq(lambda w: float(speed(w, 11.0)) - params["c_receiver"], 0.5, 1.0)
    return np.stack([depth, speed(width, depth)])


@pytest.mark.parametrize(
    ("name", "near", "before"),
    [("s08_thermo_mud_deep", 0.15, 4.0), ("s03_thermo_mud_69", 1.0, 2.0)],
)
def test_a_straight_ray_against_bellhop(shared_dir, name, near, before):
    """Half of the arrivals are within `near` m of it; not by the column's mean speed, as before."""
    place = shared_dir / "data" / "rays" / name
    params = json.loads((place / "params.json").read_text())
    depth, speed = thermocline(params)
    assert speed.mean() == pytest.approx(params["c_mean"], abs=0.02)
    taken = pl.read_csv(place / "arrivals_truth.csv")
    z = pl.read_csv(place / "toa.csv", null_values=["NA"])["z"].to_numpy()
    tag = z[taken["ping"].to_numpy()]
    ray = ray_data(depth, speed[None], np.full(len(tag), params["c_mean"]))
    slow = np.asarray(mean_slowness(ray, tag, np.array([11.0])))[:, 0]
    time = params["c_mean"] * taken["taken_s"].to_numpy()
    late, mean = (np.abs(time - taken["slant"].to_numpy() * s) for s in (slow, 1.0))
    assert np.median(late) < near and np.median(mean) > before
