"""Home-range movement in the models: what was simulated is found again."""

import numpy as np
import pytest
from numpyro import handlers

import maloc
import maloc.infer
from maloc._jax import jax, jnp
from maloc.data import ArrivalTimes
from maloc.model_data import to_model_data
from maloc.models import joint, known_interval, toa_track
from maloc.movement import OU
from tests.infer import cases

HOME, SD, T05 = np.array([25.0, -10.0]), 30.0, 600.0


def arrivals(seed, pings, home=HOME, tag="A"):
    """Arrival times of an animal around its home in a ring of receivers."""
    rng = np.random.default_rng(seed)
    emission = 50.0 + np.cumsum(rng.uniform(40, 80, pings))
    law = OU(np.diff(emission), SD, T05, home)
    xy = np.asarray(law.sample(jax.random.key(seed)))
    angle = 2 * np.pi * np.arange(6) / 6
    ring = np.column_stack([120 * np.cos(angle), 90 * np.sin(angle)])
    distance = np.linalg.norm(xy[:, None] - ring, axis=-1)
    arrival = emission[:, None] + (distance + rng.normal(0, 0.5, distance.shape)) / cases.SPEED
    return ArrivalTimes(
        toa=np.where(rng.random(distance.shape) < 0.9, arrival, np.nan),
        receivers=cases.receivers(ring),
        sound_speed=np.full(pings, cases.SPEED),
        tag=tag,
    )


def test_a_home_range_is_found_again():
    """60 pings over six memories: interval of each parameter holds what was simulated."""
    fit = maloc.infer.laplace(toa_track, arrivals(0, 60), movement="ou", error="gaussian")
    assert not fit.warnings
    rows = {row["name"]: row for row in fit.parameters()}
    truth = {"home[0]": HOME[0], "home[1]": HOME[1], "home_sd": SD, "home_t05": T05}
    for name, value in truth.items():
        assert abs(rows[name]["mean"] - value) < 3 * rows[name]["sd"], name
    assert rows["home[0]"]["unit"] == rows["home_sd"]["unit"] == "m"
    # long after the data the animal is anywhere in its home range: sd, and home's own uncertainty
    far = fit.predict([1e6])
    np.testing.assert_allclose(
        far.position[0], [rows["home[0]"]["mean"], rows["home[1]"]["mean"]], atol=1.0
    )
    wanted = np.hypot(rows["home_sd"]["mean"], [rows["home[0]"]["sd"], rows["home[1]"]["sd"]])
    np.testing.assert_allclose(far.sd[0], wanted, rtol=0.1)


@pytest.mark.extended
def test_each_tag_has_its_own_home():
    toas = [arrivals(1, 25), arrivals(2, 25, home=np.array([-40.0, 30.0]), tag="B")]
    fit = maloc.infer.laplace(joint, toas, movement="ou", arrivals="gaussian", detection=None)
    homes = fit.draws()["home"].mean(axis=(0, 1))
    spread = fit.draws()["home"].std(axis=(0, 1))
    assert homes.shape == (2, 2)
    assert (np.abs(homes - [HOME, [-40.0, 30.0]]) < 4 * spread).all()
    far = [fit.predict([1e6], tag=k).position[0] for k in (0, 1)]
    np.testing.assert_allclose(far, homes, atol=2.0)


def test_detection_models_take_it():
    """Density of the path's site is that of `OU` with the homes of the trace."""
    data = to_model_data(maloc.EncounterHistory.from_arrivals(arrivals(3, 8), True), pad=False)
    how = {"movement": "ou", "hierarchical": True}

    @jax.jit
    def densities(key):
        trace = handlers.trace(handlers.seed(known_interval, key)).get_trace(data, **how)
        value = {name: site["value"] for name, site in trace.items()}
        sd = value["home_sd"] * jnp.exp(value["home_sd_between"] * value["home_sd_tag"][0])
        t05 = value["home_t05"] * jnp.exp(value["home_t05_between"] * value["home_t05_tag"][0])
        alone = OU(data.dt, sd, t05, value["home"][0])
        return trace["track"]["fn"].log_prob(value["track"]), alone.log_prob(value["track"])

    np.testing.assert_allclose(*densities(jax.random.key(0)), rtol=1e-10)
