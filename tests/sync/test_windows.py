"""Offsets between two clocks by window, against simulated truth."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from maloc import sync
from maloc.errors import InputError
from maloc.simulate.sync_array import sync_array
from tests.sync.simulated import ORIGIN, simulate

PAIR = ("R000", "R002")
METHODS: list[Any] = ["xcorr", "likelihood"]


def true_offset(truth, time):
    """R002's clock less R000's at a time shown by R000's (ns)."""
    mine = [np.flatnonzero(truth.clock == j) for j in (0, 2)]
    shown = (time - ORIGIN) * 1e-9
    own = truth.true[mine[0]] + truth.offset[mine[0]]
    at = np.interp(shown, own, truth.true[mine[0]])
    a, b = (np.interp(at, truth.true[m], truth.offset[m]) for m in mine)
    return b - a


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("reflected", [0.15, 0.6])
def test_hourly_offsets_two_hours_from_zero(method, reflected):
    offsets = np.array([20.0, 0.0, -7140.0, 5.0])
    truth = simulate(2, 4, 5.0, offsets=offsets, ppm=300.0, curve=0.5, reflected=reflected)
    given = (truth.detections, truth.receivers, PAIR)
    found = sync.window_offsets(*given, method=method, largest=7300.0, sound_speed=1480.0)
    assert 5 <= len(found.time) <= 6
    error = found.offset - true_offset(truth, found.time)
    # a tenth of a second is the resolution; of the first or last hour a part was heard
    assert np.abs(error[1:-1]).max() < (0.1 if reflected < 0.5 else 0.15)
    assert np.ptp(true_offset(truth, found.time)) > 0.3
    # a narrow search about what is known finds the same
    near = sync.window_offsets(
        *given, method=method, largest=5.0, around=found.measured + 1.0, sound_speed=1480.0
    )
    np.testing.assert_allclose(near.measured, found.measured, atol=0.05)


def test_windows_that_nobody_heard_are_put_on_the_line():
    truth = simulate(3, 4, 10.0, offsets=np.array([20.0, 0.0, -240.0, 5.0]), ppm=30.0)
    hour = (truth.true / 3600).astype(int)
    silent = (truth.clock == 2) & np.isin(hour, [3, 4])
    detections = truth.detections.select(mask=~silent)
    rng = np.random.default_rng(0)
    wrong = (truth.clock == 2)[~silent] & (hour[~silent] == 7)  # an hour of nonsense
    time = detections.time.copy()
    time[wrong] += np.round(rng.uniform(-60, 60, wrong.sum()) * 1e9).astype(np.int64)
    detections = dataclasses.replace(detections, time=time)
    given = (detections, truth.receivers, PAIR)
    found = sync.window_offsets(*given, sound_speed=1480.0)
    truly = true_offset(truth, found.time)
    off = np.abs(found.measured - truly)
    assert np.isnan(found.measured).sum() >= 1
    assert found.filled[~(off < 0.5)].all()
    assert found.filled.sum() <= 6
    assert np.abs(found.offset - truly).max() < 0.15
    bare = sync.window_offsets(*given, sound_speed=1480.0, fill=False)
    np.testing.assert_array_equal(bare.offset, found.measured)
    table = found.to_frame()
    assert table["measured"].null_count() == np.isnan(found.measured).sum()
    assert table["filled"].to_list() == found.filled.tolist()


@pytest.mark.parametrize("method", METHODS)
def test_a_jump_shows(method):
    array = sync_array(
        np.random.default_rng(8), 4, 0.5, offset=60.0, interval=(90.0, 150.0), jumps=(0, 0)
    )
    mine = array.clock == 2
    later = mine & (array.true > 6 * 3600)
    time = array.detections.time + np.where(later, 45 * 10**9, 0)
    detections = dataclasses.replace(array.detections, time=time)
    found = sync.window_offsets(detections, array.receivers, PAIR, method=method, fill=False)
    step = np.diff(found.measured[1:-1])
    big = np.flatnonzero(np.abs(step) > 10)
    assert len(big) in (1, 2)  # the hour of the jump may fall to either side
    assert step[big].sum() == pytest.approx(45, abs=10)  # it drifts by 2.5 s an hour at most
    assert not found.filled.any()


def test_pairs_of_an_order_and_what_is_refused():
    truth = simulate(4, 4, 2.0, offsets=np.array([20.0, 0.0, -240.0, 5.0]))
    order = sync.find_sync_order(sync.connectivity(truth.detections, truth.receivers))
    for pair in order.pairs:
        found = sync.window_offsets(truth.detections, truth.receivers, pair)
        assert (found.controller, found.target) == pair
    given = (truth.detections, truth.receivers)
    with pytest.raises(InputError, match="'X' is not in"):
        sync.window_offsets(*given, ("R000", "X"))
    with pytest.raises(InputError, match="neither xcorr nor likelihood"):
        sync.window_offsets(*given, PAIR, method="guess")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="window must be positive"):
        sync.window_offsets(*given, PAIR, window=0.0)
    alone = truth.detections.select(mask=(truth.clock != 2))
    with pytest.raises(InputError, match="no sync tag in common"):
        sync.window_offsets(alone, truth.receivers, PAIR)
