"""Initial values: the right place from nothing but the data, in awkward arrays too."""

import numpy as np
import pytest

import maloc.infer
from maloc._jax import jnp
from maloc.infer._model import chain_model
from maloc.infer.initial import initial_values, repair
from maloc.infer.mode import find_mode
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests.infer import cases

OPTIONS = {"movement": "rw", "error": "ddetect"}


@pytest.fixture(scope="module")
def problem():
    times, emission, position = cases.toa(seed=1, p_late=0.15, unheard=())
    args = (to_model_data(times),)
    return chain_model(toa_track, OPTIONS, args), args, position


@pytest.mark.parametrize("seed", range(8))
def test_a_fit_from_nothing_is_the_fit_from_the_truth(seed, problem):
    """15 % of the arrivals late: the same mode as a start on the true track finds."""
    times, _, position = cases.toa(seed=seed, p_late=0.15, unheard=())
    x, u = initial_values(problem[0], (to_model_data(times),))
    values, _ = problem[0].sites(jnp.asarray(x), jnp.asarray(u))
    assert 0.1 < values["sigma"] < 3
    assert 0.01 < values["w"] < 0.5
    assert np.median(np.linalg.norm(x[:13, :2] - position, axis=1)) < 1
    ours, wanted = (
        maloc.infer.laplace(toa_track, times, movement="rw", positions=start)
        for start in (None, position)
    )
    assert ours.warnings == wanted.warnings == ()
    assert abs(ours.marginal.value - wanted.marginal.value) < 0.05
    np.testing.assert_allclose(ours.moments()[0][:, :2], wanted.moments()[0][:, :2], atol=0.05)


def test_given_positions_are_a_start(problem):
    cm, args, position = problem
    x, _ = initial_values(cm, args, np.concatenate([position, position[-3:]]))
    assert np.linalg.norm(x[:13, :2] - position, axis=1).max() < 3


def test_repair_frees_a_ping_that_was_left_behind(problem):
    """One emission time put 40 m too early, where all arrivals look late: found and set right."""
    cm, args, position = problem
    x, u = initial_values(cm, args)
    mode = find_mode(cm, args, x, u)
    spoilt = mode.x.copy()
    spoilt[6, -1] -= 40.0
    stuck = find_mode(cm, args, spoilt, u)
    assert stuck.value > mode.value + 5  # Newton alone does not come back
    mended = repair(cm, args, spoilt, u)
    np.testing.assert_allclose(mended, mode.x, atol=0.05)
    # a path that needs nothing is not made worse
    assert float(cm.exact(repair(cm, args, mode.x, u), u, args, 0.0)[0]) < mode.value + 1e-3


def test_receivers_on_one_line():
    """The track comes out on one side of the line: the true one or its mirror image."""
    rng = np.random.default_rng(3)
    along = np.linspace(-150, 150, 6)
    xy = np.column_stack([along, 0.5 * along])
    normal = np.array([-0.5, 1.0]) / np.hypot(0.5, 1.0)
    emission = 100 + 25.0 * np.arange(13)
    position = np.linspace([-60, 20], [60, 60], 13)
    toa, _, _ = cases.toa(unheard=())
    distance = np.linalg.norm(position[:, None] - xy, axis=-1) + rng.normal(0, 0.3, (13, 6))
    toa = toa.replace(toa=emission[:, None] + distance / cases.SPEED, receivers=cases.receivers(xy))
    fit = maloc.infer.laplace(toa_track, toa, movement="rw")
    found = fit.moments()[0][:, :2]
    mirrored = position - 2 * np.outer(position @ normal, normal)
    off = [np.linalg.norm(found - p, axis=1).max() for p in (position, mirrored)]
    assert min(off) < 3


def test_other_models_start_from_zero_and_the_prior():
    args = cases.fixes_data()
    cm = chain_model(cases.fixes, {}, args)
    x, u = initial_values(cm, args)
    assert x.shape == (14, 2)
    assert not x.any()
    assert np.abs(u).max() < 2  # log-normal priors around 1
