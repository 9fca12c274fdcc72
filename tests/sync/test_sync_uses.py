"""What a synchronisation is used for: anchors, draws, a moved sound speed, the study."""

import numpy as np
import polars as pl
import pytest

from maloc import sync
from maloc.errors import InputError
from maloc.simulate.sync_array import ORIGIN, sync_array
from simulations.sync import score

ARRAY = sync_array(np.random.default_rng([4, 5]), 8, 0.5, jumps=(2, 2), jump_size=(0.02, 60.0))


@pytest.fixture(scope="module")
def fitted():
    return sync.fit(ARRAY.detections, ARRAY.receivers)


def test_study_of_one_small_array(fitted):
    s = score(ARRAY, fitted)
    assert np.sqrt(np.mean(s.error**2)) < 3e-4
    assert (s.jumps, s.found, s.dated, s.false) == (2, 2, 2, 0)
    assert np.mean(np.abs(s.error) < 1.96 * s.sd) > 0.85
    assert len(s.error) > 2500


def test_a_jump_that_is_missed_or_invented_is_counted(fitted):
    import dataclasses

    none = dataclasses.replace(
        fitted.jumps, **{f: getattr(fitted.jumps, f)[:0] for f in vars(fitted.jumps)}
    )
    s = score(ARRAY, dataclasses.replace(fitted, jumps=none))
    assert (s.found, s.false) == (0, 0)
    wrong = dataclasses.replace(fitted.jumps, size=fitted.jumps.size + 1.0)
    s = score(ARRAY, dataclasses.replace(fitted, jumps=wrong))
    assert (s.found, s.false) == (0, 2)


def test_anchored_at_moments_of_known_true_time(fitted):
    j = int(np.flatnonzero(fitted.synced & (np.array(fitted.receivers.names) != "R000"))[2])
    quiet = ~np.isin(ARRAY.clock, ARRAY.jump_clock)
    rows = np.flatnonzero((ARRAY.clock == j) | quiet)[[5, 700, -5]]
    true = ORIGIN + np.round(ARRAY.true[rows] * 1e9).astype(np.int64)
    recorded = true + np.round(ARRAY.offset[rows] * 1e9).astype(np.int64)
    right = fitted.anchored(ARRAY.detections.receiver[rows], recorded, true)
    everywhere = np.flatnonzero(quiet & ~ARRAY.late)[::50]
    d = ARRAY.detections.select(mask=np.isin(np.arange(len(ARRAY.true)), everywhere))
    error = right.offset(d.receiver, d.time) - ARRAY.offset[everywhere]
    # the reference swings, a line through three moments leaves that
    assert np.abs(error).max() < 0.05
    back = right.apply(d)
    off = (back.time - ORIGIN) * 1e-9 - ARRAY.true[everywhere]
    assert np.abs(off).max() < 0.05
    # relations between clocks are as before
    change = right.offset(d.receiver, d.time) - fitted.offset(d.receiver, d.time)
    line = np.polyfit(ARRAY.true[everywhere], change, 1)
    assert np.abs(change - np.polyval(line, ARRAY.true[everywhere])).max() < 1e-6
    with pytest.raises(InputError, match="no anchor"):
        fitted.anchored("nobody", recorded, true)


def test_draws_scatter_as_the_standard_errors_say(fitted):
    reference = fitted.receivers.names.index(fitted.reference)
    others = np.arange(8) != reference
    spread = (fitted.value_draws - fitted.values).std(axis=0)[others]
    ratio = spread / fitted.values_sd[others]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.25)
    assert (fitted.value_draws[:, reference] == 0).all()
    one = fitted.draws()[0]
    assert not np.array_equal(one.values, fitted.values)
    assert one.residuals is fitted.residuals


def test_apply_gives_each_time_its_standard_error(fitted):
    common = fitted.apply(ARRAY.detections)
    sd = common.extra["clock_sd"]
    assert sd.shape == common.time.shape
    mine = common.receiver == fitted.reference
    assert sd[~mine].min() > 0
    assert np.median(sd) < 5e-4


def test_sound_speed_from_a_table_of_temperatures():
    from maloc.world.medium import mackenzie

    table = pl.DataFrame(
        {
            "time": ["2020-09-13T00:00:00Z", "2020-09-14T12:00:00Z"],
            "temperature": [10.0, 12.0],
            "salinity": [35.0, 35.0],
        }
    )
    given = sync.fit(ARRAY.detections, ARRAY.receivers, sound_speed=table)
    assert (given.speeds_sd == 0).all()
    low, high = mackenzie(np.array([10.0, 12.0]), 35.0)
    assert low < given.speeds.min() < given.speeds.max() < high
    with pytest.raises(InputError, match="another time"):
        late = table.with_columns(time=pl.col("time").str.replace("2020", "2010"))
        sync.fit(ARRAY.detections, ARRAY.receivers, sound_speed=late)


def test_a_number_is_a_prior_of_its_sd():
    """It meets what the pings tell by themselves as two measurements of one speed do."""
    free = sync.fit(ARRAY.detections, ARRAY.receivers, sound_speed="constant")
    told, sure = free.sound_speed, free.sound_speed_sd
    asked = told + 3 * sure
    got = sync.fit(ARRAY.detections, ARRAY.receivers, sound_speed=asked, sound_speed_sd=sure)
    assert got.sound_speed == pytest.approx(0.5 * (told + asked), abs=0.1 * sure)
    assert got.sound_speed_sd == pytest.approx(sure / np.sqrt(2), rel=0.1)
    with pytest.raises(InputError, match="sound_speed_sd must be at least 0"):
        sync.fit(ARRAY.detections, ARRAY.receivers, sound_speed=1500.0, sound_speed_sd=-1.0)


def test_receivers_without_a_tag_and_tags_without_a_receiver():
    import dataclasses

    tags = ARRAY.receivers.sync_tag.copy()
    heard = ARRAY.clock != 6  # place 6 is a reference tag: nobody listens there
    tags[7] = ""  # receiver 7 has no tag
    table = dataclasses.replace(ARRAY.receivers, sync_tag=tags)
    fitted = sync.fit(ARRAY.detections.select(mask=heard), table)
    assert fitted.synced.tolist() == [True] * 6 + [False, True]
    rows = np.flatnonzero(heard)[fitted.residuals.row]
    reference = fitted.receivers.names.index(fitted.reference)
    error = fitted.residuals.offset - ARRAY.relative(reference)[rows]
    assert np.sqrt(np.nanmean(error**2)) < 6e-4
    assert fitted.residuals.used[fitted.residuals.sync_tag == "A69-1602-60006"].sum() > 100
