"""The narrow mode beside the wide one: worlds with walls, exact pings, stretches laid wrong."""

import numpy as np
import pytest

import maloc.infer
from maloc.infer._ping_path import ping_paths, places
from maloc.infer._rejoin import rejoined
from maloc.infer.initial import _column, put_positions
from maloc.infer.mode import find_mode
from maloc.model_data import to_model_data
from maloc.models import toa_track
from simulations.walls import WallWorld, wall_world
from simulations.wrong_arrivals import wrong_arrivals
from tests.infer import cases


def test_places_of_exact_pings_are_the_pings():
    """Arrivals without error: one place of each ping is the tag's, and so is the path."""
    toa, emission, position = cases.toa(pings=20, sigma=0.0, p_late=0.0, unheard=())
    data = to_model_data(toa)
    found = places(data)
    assert found is not None
    assert list(found.rows) == list(range(20))
    state, _ = found.best(0.3, float(data.phi))
    off = np.linalg.norm(state[:, :, :2] - position[:, None], axis=2)
    assert off.min(axis=1).max() < 1e-6
    sent = (emission - np.nanmin(toa.toa, axis=1)) * cases.SPEED
    best = off.argmin(axis=1)
    np.testing.assert_allclose(state[np.arange(20), best, 2], sent, atol=1e-6)
    ((xy, when),) = ping_paths(data, (0.3,))
    np.testing.assert_allclose(xy[:20], position, atol=1e-5)
    np.testing.assert_allclose(when[:20], sent, atol=1e-5)
    assert np.isnan(when[20:]).all()


def test_pings_of_two_arrivals_tell_no_place():
    toa, _, _ = cases.toa(pings=5, unheard=())
    heard = toa.toa.copy()
    heard[:, 2:] = np.nan
    assert places(to_model_data(toa.replace(toa=heard))) is None
    assert ping_paths(to_model_data(toa.replace(toa=heard)), (1.0,)) == []


@pytest.fixture(scope="module")
def walls():
    """A walker; receivers of the other side of a wall hear it 12 to 40 m late, by .25 m sure."""
    return wall_world(np.random.default_rng(2), WallWorld(pings=120))


def test_the_narrow_mode_is_found(walls):
    toa, position = walls
    fit = maloc.infer.laplace(toa_track, toa, receivers="exact")
    rows = {row["name"]: row["mean"] for row in fit.parameters()}
    assert 0.2 < rows["sigma"] < 0.32
    assert 0.1 < rows["w"] < 0.5
    error = np.linalg.norm(fit.positions()[0] - position, axis=1)
    assert np.median(error) < 0.4 and np.quantile(error, 0.95) < 2


def test_a_stretch_on_the_wrong_side_comes_back(walls):
    """Eight pings in a row laid elsewhere hold one another there; single pings say where."""
    toa, _ = walls
    fit = maloc.infer.laplace(toa_track, toa, receivers="exact")
    cm, args, m = fit.cm, fit.args, fit.marginal
    x = m.x.copy()
    xy = x[:, :2].copy()
    xy[60:68] += [0.0, 35.0]
    put_positions(cm, x, xy)
    emission = _column(cm, "emission")
    assert emission is not None
    x[60:68, emission] -= 20.0
    x = find_mode(cm, args, x, m.u).x
    away = np.linalg.norm(x[60:68, :2] - m.x[60:68, :2], axis=1)
    back = rejoined(cm, args, x, m.u)
    rest = np.linalg.norm(back[60:68, :2] - m.x[60:68, :2], axis=1)
    assert away.max() > 2
    assert rest.max() < 0.05
    assert rejoined(cm, args, m.x, m.u) is m.x


@pytest.mark.parametrize(("case", "law"), [("right", "ddetect"), ("shortlate", "multipath")])
def test_the_law_of_late_arrivals_goes_by_evidence(case, law):
    """A quarter late by some 5 m, or 6 % by anything up to 375 m."""
    toa, position = wrong_arrivals(np.random.default_rng(1), case)
    fit = maloc.infer.laplace(toa_track, toa)
    assert fit.options["error"] == law
    other = {"ddetect": "multipath", "multipath": "ddetect"}[law]
    second = maloc.infer.laplace(toa_track, toa, error=other, receivers="exact")
    assert fit.marginal.value < second.marginal.value
    error = [np.linalg.norm(f.positions()[0] - position, axis=1).mean() for f in (fit, second)]
    assert error[0] < 1.05 * error[1]
    assert any("law that decays" in text for text in fit.notices) == (law == "multipath")


def test_spells_are_warned_of():
    """Each receiver late for some twelve pings at a time; and arrivals that err independently."""
    said = []
    for case in ("persist", "right"):
        toa, _ = wrong_arrivals(np.random.default_rng(3), case)
        fit = maloc.infer.laplace(toa_track, toa, error="ddetect")
        said.append(any("err alike for several pings" in text for text in fit.warnings))
    assert said == [True, False]
