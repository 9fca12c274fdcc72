"""Worlds that are drawn: what their descriptions say is what is in them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, norm

from simulations._walk import SPEED, grid, walk
from simulations.outside import far_animal
from simulations.walls import WallWorld, wall_world
from simulations.wrong_arrivals import CASES, wrong_arrivals


def lateness(toa, place):
    """Arrival minus way, up to each ping's emission, which is not told: minus the row's least."""
    late = toa.toa * SPEED - np.linalg.norm(place[:, None] - toa.receivers.xy, axis=-1)
    return late - np.nanmin(late, axis=1, keepdims=True)


def test_a_walk_has_the_speed_and_memory_asked_for():
    rng, time = np.random.default_rng(0), np.arange(0.0, 100_000.0)
    v = np.diff(walk(rng, time, 0.3, 260.0, np.zeros(2)), axis=0)
    assert v.std() == pytest.approx(0.3, rel=0.05)
    after = np.mean(v[260:] * v[:-260]) / np.mean(v**2)
    assert after == pytest.approx(0.05, abs=0.04)


def test_a_fixed_tag_has_its_late_receivers_for_good():
    world = WallWorld(fixed=True, share=1 / 3, late=(12.0, 135.0), spread=(0.2, 4.0))
    toa, place = wall_world(np.random.default_rng(1), world)
    assert len(np.unique(place, axis=0)) == 1
    middle = np.nanmedian(lateness(toa, place), axis=0)
    assert (middle > 8).sum() == 4 and (middle < 1.5).sum() == 8
    assert toa.heard[:, middle < 1.5].mean() == pytest.approx(0.92, abs=0.03)
    assert toa.heard[:, middle > 8].mean() == pytest.approx(0.5, abs=0.06)


def test_behind_the_wall_others_are_late():
    toa, place = wall_world(np.random.default_rng(1), WallWorld())
    late = lateness(toa, place) > 8
    halves = place[:, 0] > 120
    for side in (halves, ~halves):  # either side has its own receivers
        assert 0.1 < late[side][toa.heard[side]].mean() < 0.6
    share = late.sum(axis=0) / toa.heard.sum(axis=0)
    assert ((share > 0.05) & (share < 0.95)).sum() >= 8  # late to and fro, as the tag crosses
    assert place.min() >= 0 and (place.max(axis=0) <= [240, 90]).all()


def errors(case, n=60):
    """All errors of a case, each up to its ping's emission, over n tracks."""
    out = []
    for i in range(n):
        toa, place = wrong_arrivals(np.random.default_rng([0, i]), case)
        late = toa.toa * SPEED - np.linalg.norm(place[:, None] - toa.receivers.xy, axis=-1)
        late = late[toa.n_heard >= 6]
        out.append(late - np.nanmedian(late, axis=1, keepdims=True))
    out = np.concatenate(out)
    return out[np.isfinite(out)]


def test_the_right_case_is_the_model_s():
    """Differences of direct arrivals at one ping are normal of variance 2 m2; 6 % are late."""
    two = []
    for i in range(150):
        toa, place = wrong_arrivals(np.random.default_rng([1, i]), "right", 20)
        late = toa.toa * SPEED - np.linalg.norm(place[:, None] - toa.receivers.xy, axis=-1)
        off = late[:, 4] - late[:, 7]
        two.append(off[np.isfinite(off)])
    off = np.concatenate(two)
    direct = np.abs(off) < 6
    assert (~direct).mean() == pytest.approx(1 - 0.94**2, abs=0.03)
    assert kstest(off[direct], norm(scale=np.sqrt(2)).cdf).pvalue > 0.001


def test_cases_break_one_thing_each():
    right = errors("right")
    share = {c: (errors(c) > 4).mean() - (right > 4).mean() for c in ("shortlate", "persist")}
    assert share["shortlate"] == pytest.approx(0.25 * np.exp(-4 / 5), abs=0.06)
    assert 0.08 < share["persist"] < 0.3
    assert (errors("early") < -6).mean() > 0.015 > 3 * (right < -6).mean()
    wide = {c: np.subtract(*np.quantile(errors(c), [0.84, 0.16])) / 2 for c in CASES}
    assert wide["ar1"] == pytest.approx(wide["right"] * np.sqrt(2), rel=0.15)
    assert wide["wrong2all"] > 1.3 * wide["right"]
    assert wide["early"] == pytest.approx(wide["right"], rel=0.15)


def test_far_animals_are_far():
    for diameter, distance in ((400.0, 800.0), (800.0, 2500.0)):
        toa, place = far_animal(np.random.default_rng(3), diameter, distance)
        xy = toa.receivers.xy
        across = np.linalg.norm(xy[:, None] - xy, axis=-1).max()
        assert across == pytest.approx(diameter, rel=0.02)
        away = np.linalg.norm(place - xy.mean(axis=0), axis=1)
        assert (np.abs(away - distance) < 200).all()


def test_a_seed_gives_the_same_world():
    a, b, c = (wrong_arrivals(np.random.default_rng(s), "persist")[0].toa for s in (5, 5, 6))
    np.testing.assert_array_equal(a, b)
    assert a.shape != c.shape or not np.array_equal(a, c, equal_nan=True)
    assert grid(np.random.default_rng(0), 4, 3, 170.0, 30.0).shape == (12, 2)
