"""Two transmitters with one code: split against truth; one transmitter stays whole."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from maloc.data import Schedule, prepare, toa_matrix
from maloc.emitters import CodeDesign, CodeScene, simulate_code, split_same_code
from maloc.emitters._chain_laws import Pings, Settings
from maloc.emitters._chains import ENTER, _flow, best_chains
from maloc.emitters.simulate_code import ORIGIN
from maloc.errors import InputError

DESIGN = CodeDesign(hours=1.5)


def table(scene: CodeScene, design: CodeDesign):
    """The code's arrival times as a study would have them."""
    tag, schedule = scene.detections.tags[0], design.schedule
    kept = prepare(scene.detections, scene.receivers, {tag: (schedule.lo, schedule.hi)}).kept
    return toa_matrix(
        kept, scene.receivers, tag, sound_speed=design.sound_speed, schedule=schedule, origin=ORIGIN
    )


def sender(scene: CodeScene, toa) -> np.ndarray:
    """Who truly sent each row (-1: nobody): its emission within the time sound takes."""
    out = np.full(len(toa), -1)
    for who, sent in enumerate(scene.time):
        before = toa.first - sent[np.maximum(np.searchsorted(sent, toa.first) - 1, 0)]
        out[(before > 0) & (before < 0.5)] = who
    return out


@pytest.fixture(scope="module")
def two():
    scene = simulate_code(np.random.default_rng(5), DESIGN)
    toa = table(scene, DESIGN)
    return scene, toa, split_same_code(toa)


@pytest.mark.compiles
def test_two_are_split_as_they_were(two):
    scene, toa, split = two
    truth = sender(scene, toa)
    assert split.n_transmitters == 2 and split.evidence > 100 and split.apart > 100
    assert "2 transmitters" in repr(split)
    several = (toa.n_heard >= 2) & (truth >= 0) & (split.chain >= 0)
    agree = (truth == split.chain)[several].mean()
    assert max(agree, 1 - agree) > 0.95
    assert (split.chain[toa.n_heard >= 3] >= 0).mean() > 0.95


def test_every_ping_is_somewhere(two):
    _, toa, split = two
    assert sum(map(len, split.tables)) + (split.chain < 0).sum() == len(toa)
    assert ((split.why == "") == (split.chain >= 0)).all()
    for k, part in enumerate(split.tables):
        np.testing.assert_array_equal(part.ping, toa.ping[split.chain == k])
        np.testing.assert_array_equal(part.detection, toa.detection[split.chain == k])
        sent = part.first[part.n_heard > 2]
        assert (np.diff(sent) > 60.0 - 0.5).all()  # each keeps the burst limits, give or take sound


@pytest.mark.parametrize("seed", range(3))
def test_one_stays_whole(seed):
    harsh = replace(
        DESIGN,
        n_transmitters=1,
        hearing=replace(DESIGN.hearing, p_na=0.5),
        p_echo=0.3,
        false_rate=1 / 600,
    )
    toa = table(simulate_code(np.random.default_rng([1, seed]), harsh), harsh)
    split = split_same_code(toa)
    assert split.n_transmitters == 1 and split.tables[0] is toa
    assert "one transmitter" in split.note


def test_wrong_limits_are_not_two_transmitters():
    """One tag that pings every 30 to 90 s, said to ping every 60 to 180."""
    true = replace(DESIGN, n_transmitters=1, schedule=Schedule("random", 30.0, 90.0))
    toa = table(simulate_code(np.random.default_rng(2), true), true)
    split = split_same_code(toa.replace(schedule=DESIGN.schedule))
    assert split.n_transmitters == 1 and split.n_conflicts > 10
    assert "limits are wrong" in split.note


def test_the_flow_is_the_best_of_all_labellings():
    """Eight pings of two tags and a false one: all 3^8 ways to give them to two chains or none."""
    rng = np.random.default_rng(0)
    schedule = Schedule("random", 60.0, 180.0)
    settings = Settings(schedule, 8, 1 / 3600, 0.2, missed=0.2, diffusion=0.5)
    time = np.array([10.0, 40.0, 120.0, 170.0, 190.0, 290.0, 300.0, 390.0])
    owner = np.array([0, 1, 0, 1, 2, 0, 1, 0])
    xy = np.array([[0.0, 0.0], [150.0, 90.0], [60.0, 200.0]])[owner] + rng.normal(0, 3, (8, 2))
    pings = Pings(time, xy, np.tile(np.eye(2), (8, 1, 1)), np.array([5, 5, 5, 5, 1, 5, 5, 5]))
    area = float(np.prod(np.ptp(xy, axis=0) + 100.0))
    worth = settings.worth(pings.n_heard)

    @cache
    def value(rows):
        rows = np.array(rows, int)
        if not len(rows):
            return 0.0
        a, b = rows[:-1], rows[1:]
        gap = settings.log_gap(time[b] - time[a]).sum()
        return worth[rows].sum() + gap + settings.log_move(pings, a, b, area).sum() - ENTER

    best = max(
        value(tuple(i for i in range(8) if label[i] == 1))
        + value(tuple(i for i in range(8) if label[i] == 2))
        for label in product(range(3), repeat=8)
    )
    chains, total = _flow(pings, settings, area, 2)
    assert total == pytest.approx(best)
    assert {tuple(c) for c in chains} == {(0, 2, 5, 7), (1, 3, 6)}
    assert sum(value(tuple(c)) for c in chains) == pytest.approx(total)


def test_an_absence_does_not_end_a_chain():
    """Both are away for a day, then both are back: still two chains."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(60.0, 180.0, (2, 40)), axis=1)
    time[:, 20:] += 86_400.0
    order = np.argsort(time, axis=None)
    place = np.array([[0.0, 0.0], [200.0, 0.0]])
    xy = np.repeat(place, 40, axis=0)[order] + rng.normal(0, 2, (80, 2))
    pings = Pings(time.ravel()[order], xy, np.tile(np.eye(2), (80, 1, 1)), np.full(80, 6))
    settings = Settings(Schedule("random", 60.0, 180.0), 8, 1 / 3600, 0.2)
    found = best_chains(pings, settings, 3)
    assert sorted(map(len, found.chains)) == [40, 40]


def test_a_stable_beat_tells_two_apart():
    rng = np.random.default_rng(6)
    time = np.cumsum(rng.normal(30.0, 0.02, (2, 60)), axis=1) + np.array([[0.0], [11.0]])
    order = np.argsort(time, axis=None)
    xy = np.repeat([[0.0, 0.0], [30.0, 0.0]], 60, axis=0)[order] + rng.normal(0, 2, (120, 2))
    pings = Pings(time.ravel()[order], xy, np.tile(np.eye(2), (120, 1, 1)), np.full(120, 6))
    found = best_chains(pings, Settings(Schedule("stable", 30.0, 0.02), 8, 1 / 3600, 0.2), 3)
    owner = np.repeat([0, 1], 60)[order]
    assert [len(set(owner[c])) for c in found.chains] == [1, 1]


def test_bad_input_is_refused(two):
    _, toa, _ = two
    with pytest.raises(InputError, match="burst interval"):
        split_same_code(toa.replace(schedule=Schedule()))
    with pytest.raises(InputError, match="most"):
        split_same_code(toa, most=0)
    with pytest.raises(InputError, match="some time"):
        CodeDesign(hours=0.0)
