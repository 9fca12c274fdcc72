"""Filters of impossible positions against small cases by hand and a slow loop."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from maloc.classical import (
    interval_filter,
    land_filter,
    speed_filter,
    three_stage_filter,
    threshold_filter,
    two_stage_filter,
)
from maloc.data import ArrivalTimes, Receivers, Schedule
from maloc.errors import InputError
from maloc.simulate import canal_toa

SOUND = 1450.0
TIME = 30.0 * np.arange(9)
STRAIGHT = np.column_stack([15.0 * np.arange(9), np.zeros(9)])


def moved(row, by):
    xy = STRAIGHT.copy()
    xy[row] += by
    return xy


def slow_speed_filter(time, xy, limit, neighbours):
    """Round by round, position by position."""
    rows = [i for i in range(len(time)) if np.isfinite(xy[i]).all()]
    while len(rows) > 2:
        mean = []
        for k, i in enumerate(rows):
            near = [rows[m] for m in range(k - neighbours, k + neighbours + 1)
                    if m != k and 0 <= m < len(rows)]  # fmt: skip
            v = [np.hypot(*(xy[i] - xy[j])) / abs(time[i] - time[j]) for j in near]
            mean.append(np.sqrt(np.mean(np.square(v))))
        drop, run = [], []
        for k, value in enumerate([*mean, 0.0]):
            if value > limit:
                run.append(k)
            elif run:
                drop.append(rows[max(run, key=lambda k: mean[k])])
                run = []
        if not drop:
            break
        rows = [i for i in rows if i not in drop]
    return np.isin(np.arange(len(time)), rows)


@pytest.mark.parametrize("neighbours", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_speeds_against_the_slow_loop(neighbours, seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(10, 60, 80))
    xy = np.cumsum(rng.normal(0, 6, (80, 2)), axis=0)
    xy[rng.random(80) < 0.15] += rng.normal(0, 150, 2)
    xy[[4, 40]] = np.nan
    found = speed_filter(time, xy, 1.0, neighbours=neighbours)
    np.testing.assert_array_equal(found.keep, slow_speed_filter(time, xy, 1.0, neighbours))
    assert 5 < (~found.keep).sum() < 60
    assert found.why[4] == "no position" and set(found.why) == {"", "speed", "no position"}


def test_one_position_far_off_goes_alone():
    """60 m aside in a track of .5 m/s: 2 m/s there and back, its neighbours' means less."""
    for screen in (speed_filter, two_stage_filter, three_stage_filter):
        found = screen(TIME, moved(4, [0, 60]), 1.2)
        assert np.flatnonzero(~found.keep).tolist() == [4]
    assert two_stage_filter(TIME, moved(4, [0, 200]), 1.2).why[4] == "all speeds"
    assert str(found).startswith("8 of 9 kept; 1 ")
    assert speed_filter(TIME, STRAIGHT, 0.51).keep.all()


def test_turns():
    """There and back within the speed: 180 degrees; a right angle stays."""
    xy = moved(4, [-30.0, 0.1])
    found = three_stage_filter(TIME, xy, 5.0)
    assert np.flatnonzero(~found.keep).tolist() == [3, 4]
    assert set(found.why[[3, 4]]) == {"turning angle"}
    corner = STRAIGHT.copy()
    corner[5:] = corner[4] + np.column_stack([np.zeros(4), 15.0 * np.arange(1, 5)])
    assert three_stage_filter(TIME, corner, 5.0).keep.all()
    assert three_stage_filter(TIME, corner, 5.0, angle=80).why[4] == "turning angle"


def test_measure_and_land():
    found = threshold_filter([1.0, 9.0, np.nan, 3.0], 3.0)
    assert found.why.tolist() == ["", "error measure", "no position", ""]
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    found = land_filter([[5.0, 5.0], [11.0, 5.0], [np.nan, 1.0]], square)
    assert found.why.tolist() == ["", "on land", "no position"]


def test_refusals():
    with pytest.raises(InputError, match="do not ascend"):
        speed_filter(TIME[::-1], STRAIGHT, 1.0)
    with pytest.raises(InputError, match="wanted, got"):
        speed_filter(TIME[:-1], STRAIGHT, 1.0)
    with pytest.raises(InputError, match="is no speed"):
        speed_filter(TIME, STRAIGHT, 0.0)
    with pytest.raises(InputError, match="give 1 or more"):
        speed_filter(TIME, STRAIGHT, 1.0, neighbours=0)
    with pytest.raises(InputError, match="0 to 180"):
        three_stage_filter(TIME, STRAIGHT, 1.0, angle=200)


def test_pings_sooner_than_possible_by_trying_every_set():
    """Twelve pings, the set of most detections among those far enough apart."""
    rng = np.random.default_rng(4)
    xy = np.array([[0.0, 0.0], [150.0, 0.0], [0.0, 150.0], [150.0, 150.0], [75.0, 75.0]])
    receivers = Receivers(np.array(list("ABCDE")), xy[:, 0], xy[:, 1])
    first = np.sort(rng.uniform(0, 120, 12))
    toa = first[:, None] + rng.uniform(0, 0.1, (12, 5))
    toa[rng.random(toa.shape) < 0.5] = np.nan
    toa[5] = np.nan
    order = np.argsort(np.where(np.isnan(toa), np.inf, toa).min(axis=1), kind="stable")
    data = ArrivalTimes(
        toa[order], receivers, np.full(12, SOUND), schedule=Schedule("random", 20.0, 40.0)
    )
    heard = np.flatnonzero(data.n_heard > 0)
    when = np.nanmin(data.toa[heard], axis=1)
    apart = 20.0 - np.hypot(150, 150) / SOUND
    best = max(
        sum(data.n_heard[heard[list(some)]])
        for n in range(1, len(heard) + 1)
        for some in combinations(range(len(heard)), n)
        if (np.diff(when[list(some)]) >= apart).all()
    )
    found = interval_filter(data)
    kept = np.flatnonzero(found.keep)
    assert data.n_heard[kept].sum() == best and len(kept) < len(heard)
    assert (np.diff(np.nanmin(data.toa[kept], axis=1)) >= apart).all()
    assert set(found.why[data.n_heard == 0]) == {"not heard"}
    assert set(found.why[heard]) == {"", "too soon for a ping"}
    assert interval_filter(data, 1e-3 + np.hypot(150, 150) / SOUND).keep.sum() >= len(kept)
    with pytest.raises(InputError, match="shortest burst interval is not known"):
        interval_filter(ArrivalTimes(data.toa, receivers, data.sound_speed))


def test_a_reflection_that_looks_like_a_ping_goes():
    toa, _ = canal_toa(np.random.default_rng(0), p_na=0.0, p_mp=0.0)
    late = toa.toa[10:11] + 3.0
    late[0, 2:] = np.nan
    rows = np.insert(toa.toa, 11, late, axis=0)
    speed = np.full(len(rows), SOUND)
    both = ArrivalTimes(rows, toa.receivers, speed, schedule=toa.schedule)
    assert np.flatnonzero(~interval_filter(both).keep).tolist() == [11]
