"""Which arrivals are one emission: against every partition of small scenes, and known truth."""

from typing import Any

import numpy as np
import pytest

from maloc.emitters import SCENES, Sensing, associate, fuse, simulate
from maloc.emitters._hypotheses import enumerate_hypotheses
from maloc.emitters.association import pack
from maloc.emitters.tracking import Tracks
from maloc.errors import InputError
from tests.oracles import best_packing, emission_log_ratio

pytestmark = pytest.mark.compiles

SQUARE = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 400.0], [0.0, 400.0]])


def sensing_of(**changes: Any) -> Sensing:
    """Four receivers at the corners of a square, in water."""
    known: dict[str, Any] = {"receivers": SQUARE, "speed": 1500.0, "sigma": 1e-3}
    known.update({"p_detect": 0.9, "n_false": 0.5}, **changes)
    return Sensing(**known)


def _scan(rng, sensing, emitters, sent):
    """Measurements (N,) and columns of emitters (E, 2): one missed once, and one more false."""
    distance = np.linalg.norm(emitters[:, None] - sensing.receivers, axis=2)
    if sensing.reference is not None:
        distance = distance - distance[:, [sensing.reference]]
        sent = np.zeros(len(emitters))
    value = sent[:, None] + distance / sensing.speed
    value = value + sensing.sigma * rng.standard_normal(value.shape)
    column = np.tile(np.arange(len(sensing.receivers)), (len(emitters), 1))
    keep = np.ones(value.shape, bool)
    keep[0, 3] = False
    if sensing.reference is not None:
        keep[:, sensing.reference] = False
    return np.append(value[keep], 0.05), np.append(column[keep], 1)


@pytest.mark.parametrize("reference", [None, 0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_best_set_is_that_of_all_partitions(reference, seed):
    rng = np.random.default_rng(seed)
    sensing = sensing_of(reference=reference, expected=2.0)
    emitters = rng.uniform(50.0, 350.0, (2, 2))
    value, column = _scan(rng, sensing, emitters, rng.uniform(0.0, 0.2, 2))
    found = associate(value, column, sensing)
    every, cut = enumerate_hypotheses(value, column, sensing)
    assert cut == 0
    sets = [frozenset(m[m >= 0]) for m in every.member]
    best, worth = best_packing(sets, every.log_ratio)
    assert found.log_ratio.sum() == pytest.approx(worth)
    assert {frozenset(m[m >= 0]) for m in found.member} == {sets[i] for i in best}


@pytest.mark.parametrize("reference", [None, 0])
def test_hypotheses_are_all_sets_that_fit(reference):
    """Every set of measurements at three receivers or four, each tried by itself."""
    rng = np.random.default_rng(3)
    sensing = sensing_of(reference=reference, expected=2.0)
    emitters = rng.uniform(50.0, 350.0, (2, 2))
    value, column = _scan(rng, sensing, emitters, np.array([0.0, 0.1]))
    found, _ = enumerate_hypotheses(value, column, sensing)
    for member, position, emission, ratio in zip(
        found.member, found.position, found.emission, found.log_ratio, strict=True
    ):
        expected = emission_log_ratio(member, position, emission / 1500.0, value, sensing)
        assert ratio == pytest.approx(expected, abs=2e-3)  # the reference is exact to 1e-3 sigma
    # the true sets are among them, whole and without any one of their measurements
    sets = {frozenset(m[m >= 0]) for m in found.member}
    n = 2 if reference is not None else 3
    assert frozenset(range(n)) in sets
    assert frozenset(range(n, 2 * n + 1)) in sets


def test_the_laplace_integral_is_the_integral():
    """log_ratio by quadrature over place, the emission time integrated in closed form."""
    sensing = sensing_of(reference=None, expected=1.0)
    rng = np.random.default_rng(5)
    distance = np.linalg.norm(np.array([180.0, 230.0]) - SQUARE, axis=1)
    value = 0.02 + distance / 1500.0 + 1e-3 * rng.standard_normal(4)
    found, _ = enumerate_hypotheses(value, np.arange(4), sensing)
    whole = found.rows(np.flatnonzero((found.member >= 0).all(axis=1)))
    side = np.linspace(-15.0, 15.0, 301)
    x, y = np.meshgrid(whole.position[0, 0] + side, whole.position[0, 1] + side)
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    reach = value * 1500.0 - np.linalg.norm(grid[:, None] - SQUARE, axis=2)
    s = 1.5
    square = ((reach - reach.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) / s**2
    inner = np.exp(-square / 2) / (np.sqrt(2 * np.pi) * s) ** 3 / np.sqrt(4)
    integral = inner.sum() * 0.1**2
    expected = (
        np.log(integral * sensing.emission_density)
        + 4 * np.log(0.9)
        - np.log(sensing.false_density).sum()
    )
    assert whole.log_ratio[0] == pytest.approx(expected, abs=0.02)


def test_emission_times_and_places_are_found():
    rng = np.random.default_rng(7)
    sensing = sensing_of(sigma=1e-5, n_false=0.0, expected=2.0)
    emitters, sent = rng.uniform(50.0, 350.0, (2, 2)), np.array([0.01, 0.17])
    distance = np.linalg.norm(emitters[:, None] - SQUARE, axis=2)
    value = (sent[:, None] + distance / 1500.0).ravel()
    found = associate(value, np.tile(np.arange(4), 2), sensing)
    order = np.argsort(found.emission)
    np.testing.assert_allclose(found.emission[order], sent, atol=1e-4)
    np.testing.assert_allclose(found.position[order], emitters, atol=0.2)
    assert sorted(map(sorted, found.member.tolist())) == [[0, 1, 2, 3], [4, 5, 6, 7]]


def test_packing_against_all_subsets():
    rng = np.random.default_rng(11)
    member = np.where(rng.random((12, 4)) < 0.7, rng.integers(0, 5, (12, 4)), -1)
    member[:, 1:] += np.where(member[:, 1:] >= 0, 5 * np.arange(1, 4), 0)
    worth = rng.uniform(0.5, 3.0, 12)
    chosen = pack(member, worth, 20)
    _, best = best_packing([frozenset(m[m >= 0]) for m in member], worth)
    assert worth[chosen].sum() == pytest.approx(best)


def test_a_track_rescues_what_three_receivers_heard():
    """Three arrivals with others about are too little by themselves, not where one is expected."""
    sensing = sensing_of(n_false=3.0)
    place = np.array([150.0, 210.0])
    value = 0.01 + np.linalg.norm(place - SQUARE[:3], axis=1) / 1500.0
    assert len(associate(value, np.arange(3), sensing)) == 0
    tracks = Tracks(np.array([4]), place[None] + 2.0, np.zeros((1, 2)), 9.0 * np.eye(4)[None])
    found = associate(value, np.arange(3), sensing, tracks)
    np.testing.assert_allclose(found.position, place[None], atol=0.5)
    twice = np.append(value, value + 0.1)  # a track calls once
    assert len(associate(twice, np.tile(np.arange(3), 2), sensing, tracks)) == 1


def test_known_identities_are_one_emission_each():
    scans, truth = simulate(np.random.default_rng(2), SCENES["known"].replace(n_receivers=4))
    sensing = SCENES["known"].replace(n_receivers=4).sensing
    found = fuse(scans[0].value, scans[0].column, scans[0].emitter, sensing)
    assert len(found) == 4
    error = np.linalg.norm(found.position - truth[0], axis=1)
    sd = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    assert (error < 4 * sd).all()


def test_nothing_heard_is_nothing_found():
    sensing = sensing_of()
    assert len(associate([], [], sensing)) == 0
    assert len(associate([0.1, 0.2], [0, 1], sensing)) == 0
    assert len(fuse([], [], [], sensing)) == 0


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="3"):
        sensing_of(receivers=SQUARE[:2])
    with pytest.raises(InputError, match="p_detect"):
        sensing_of(p_detect=0.0)
    with pytest.raises(InputError, match="reference"):
        sensing_of(reference=4)
    sensing = sensing_of(reference=0)
    with pytest.raises(InputError, match="itself"):
        associate([0.1], [0], sensing)
    with pytest.raises(InputError, match="columns"):
        associate([0.1], [9], sensing)
    with pytest.raises(InputError, match="no numbers"):
        associate([np.nan], [1], sensing)
