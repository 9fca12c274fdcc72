"""Tables of the water met in time, profiles met by depth, and what they lack."""

import numpy as np
import polars as pl
import pytest

from maloc import WaterColumn
from maloc.errors import InputError
from maloc.world.medium import chen_millero, sound_profile, speed_among, with_sound_speed
from tests.infer import cases

DEPTH, SPEED = np.array([0.0, 5.0, 7.0, 12.0]), np.array([1494.0, 1492.0, 1450.0, 1448.0])


def times():
    return cases.toa(pings=6, unheard=())[0].replace(origin=1_600_000_000 * 10**9)


def table(**columns):
    time = np.array([1_600_000_000, 1_600_000_400], "datetime64[s]")
    return pl.DataFrame({"time": np.datetime_as_string(time).tolist(), **columns})


def deep(toa, depth=11.0):
    from dataclasses import replace

    return toa.replace(
        receivers=replace(toa.receivers, depth=np.full(len(toa.receivers), depth, float))
    )


def test_speed_is_interpolated_in_time(tmp_path):
    path = tmp_path / "water.csv"
    table(temperature=[10.0, 14.0], salinity=[35.0, 30.0]).write_csv(path)
    got = with_sound_speed(times(), path, sd=0.5)
    share = got.first / 400.0
    ends = chen_millero(np.array([10.0, 14.0]), np.array([35.0, 30.0]))
    np.testing.assert_allclose(got.sound_speed, np.interp(share, [0, 1], ends), rtol=1e-9)
    assert got.sound_speed_sd == 0.5 and got.profile is None


def test_a_table_of_speeds_serves_too():
    got = with_sound_speed(times(), table(sound_speed=[1500.0, 1500.0]))
    np.testing.assert_allclose(got.sound_speed, 1500.0)
    assert got.sound_speed_sd == 1.0
    assert (
        with_sound_speed(times(), table(sound_speed=[1500.0, 1500.0]), sd=0).sound_speed_sd is None
    )


def test_stated_errors_add_up():
    """The equation's error, and the slopes of the equation times the loggers' errors."""
    water = {"temperature": [10.0, 10.0], "salinity": [20.0, 20.0]}
    got = with_sound_speed(
        times(), table(**water, temperature_sd=[0.5, 0.5], salinity_sd=[2.0, 2.0])
    )
    by_t = (chen_millero(10.1, 20.0) - chen_millero(9.9, 20.0)) / 0.2
    by_s = (chen_millero(10.0, 20.1) - chen_millero(10.0, 19.9)) / 0.2
    expected = np.sqrt(0.19**2 + (0.5 * by_t) ** 2 + (2.0 * by_s) ** 2)
    assert got.sound_speed_sd == pytest.approx(float(expected), rel=1e-3)
    own = with_sound_speed(times(), table(sound_speed=[1500.0, 1500.0], sound_speed_sd=[0.3, 0.4]))
    assert own.sound_speed_sd == pytest.approx(np.sqrt(0.125))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"salinity": [35.0, 35.0]}, "no column 'temperature'"),
        ({"temperature": [10.0, 10.0]}, "no column 'salinity'; add it, 0 for fresh water"),
        (
            {"temperature": [10.0, None], "salinity": [35.0, 35.0]},
            "line 3, column 'temperature': a value is missing",
        ),
        (
            {"temperature": [10.0, 50.0], "salinity": [35.0, 35.0]},
            "line 3, column 'temperature': temperature 50 is not between -2 and 35",
        ),
        ({"sound_speed": [1500.0, 1500.0], "sound_speed_sd": [1.0, -1.0]}, "line 3.*negative"),
        ({"sound_speed": ["fast", "1500"]}, "line 2, column 'sound_speed': 'fast' is not a number"),
    ],
)
def test_what_a_table_lacks(tmp_path, columns, message):
    path = tmp_path / "water.csv"
    table(**columns).write_csv(path)
    with pytest.raises(InputError, match=f"water.csv.*{message}"):
        with_sound_speed(times(), path)


def test_a_table_of_another_year():
    with pytest.raises(InputError, match="another time"):
        with_sound_speed(times().replace(origin=10**18), table(sound_speed=[1500.0, 1500.0]))


def test_arrival_times_without_a_date():
    with pytest.raises(InputError, match="have no date"):
        with_sound_speed(times().replace(origin=None), table(sound_speed=[1500.0, 1500.0]))


def test_a_table_in_time_may_say_the_loggers_depth():
    got = with_sound_speed(
        times(), table(temperature=[9.0, 9.0], salinity=[0, 0], depth=[4.0, 5.0])
    )
    assert got.profile is None
    ends = chen_millero(9.0, 0.0, np.array([4.0, 5.0]))
    np.testing.assert_allclose(got.sound_speed, np.interp(got.first / 400, [0, 1], ends))


def slowness(a, b, speed=SPEED):
    """Mean of 1 / c between two depths, by brute force."""
    at = a + (np.arange(200_000) + 0.5) / 200_000 * (b - a)
    return np.mean(1 / np.interp(at, DEPTH, speed))


def test_a_ping_has_the_speed_of_its_own_depth():
    """A flat track's: between the tag's depth and the receivers', without a date."""
    sensed = np.array([2.0, np.nan, 6.0, 6.5, 11.0, np.nan])
    toa = deep(times()).replace(origin=None, depth=sensed)
    got = with_sound_speed(toa, {"depth": DEPTH, "sound_speed": SPEED}, sd=0.5)
    between = 2.0 + 4.0 * (toa.first[1] - toa.first[0]) / (toa.first[2] - toa.first[0])
    at = [2.0, between, 6.0, 6.5, 11.0, 11.0]
    expected = [1 / slowness(z, 11.0 + 1e-6) for z in at]
    np.testing.assert_allclose(got.sound_speed, expected, rtol=1e-7)
    assert got.sound_speed_sd == pytest.approx(0.5)
    assert got.profile == sound_profile({"depth": DEPTH, "sound_speed": SPEED}, sd=0.5)


def test_an_unknown_depth_makes_the_speed_less_sure():
    toa = deep(times())
    profile = sound_profile({"depth": DEPTH, "sound_speed": SPEED}, sd=0.5)
    depths = np.random.default_rng(1).uniform(0, 11, 2000)
    at = np.linspace(0, 11, 5001)
    whole = np.append(0, np.cumsum(1 / np.interp(0.5 * (at[1:] + at[:-1]), DEPTH, SPEED))) * at[1]
    mean = (whole[-1] - np.interp(depths, at, whole)) / (11 - depths)
    got = with_sound_speed(toa, profile)
    np.testing.assert_allclose(got.sound_speed, 1 / mean.mean(), rtol=3e-4)
    assert got.sound_speed_sd == pytest.approx(np.sqrt(0.25 + np.var(1 / mean)), rel=0.05)
    told = with_sound_speed(toa.replace(column=WaterColumn(12.0)), profile)
    assert told.sound_speed_sd == pytest.approx(0.5)  # the model finds the depth


def test_casts_in_time(tmp_path):
    """Two casts an hour apart, knots of their own; linear in time between, constant beyond."""
    path = tmp_path / "casts.csv"
    hours = ["2020-09-13T12:00:00Z"] * 2 + ["2020-09-13T13:00:00Z"] * 3
    columns = {
        "time": hours,
        "depth": [0, 10, 10, 0, 5],
        "sound_speed": [1500, 1480, 1490, 1500, 1494],
    }
    pl.DataFrame(columns).write_csv(path)
    profile = sound_profile(path)
    np.testing.assert_allclose(profile.depth, [0, 5, 10])
    np.testing.assert_allclose(profile.speed, [[1500, 1490, 1480], [1500, 1494, 1490]])
    start = 1_599_998_400.0
    got = profile.at(start + np.array([-60.0, 900.0, 7200.0]))
    np.testing.assert_allclose(got, [[1500, 1490, 1480], [1500, 1491, 1482.5], [1500, 1494, 1490]])
    met = with_sound_speed(deep(times(), 10.0).replace(depth=np.full(6, 10.0)), path)
    share = (1_600_000_000 - start + met.first) / 3600
    np.testing.assert_allclose(met.sound_speed, 1480 + 10 * share, atol=1e-6)
    with pytest.raises(InputError, match="another time"):
        with_sound_speed(times().replace(origin=10**18), path)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"depth": [1.0, 1.0], "sound_speed": [1500, 1500]},
            "line 3, column 'depth': depth 1 m is",
        ),
        ({"depth": [1.0, 2.0], "temperature": [9, 9]}, "no column 'salinity'"),
        ({"temperature": [9.0, 9.0], "salinity": [0, 0]}, "no column 'time' and no column 'depth'"),
    ],
)
def test_what_a_profile_lacks(tmp_path, columns, message):
    path = tmp_path / "cast.csv"
    pl.DataFrame(columns).write_csv(path)
    with pytest.raises(InputError, match=f"cast.csv.*{message}"):
        with_sound_speed(times(), path)


def test_speed_among_receivers():
    profile = sound_profile({"depth": DEPTH, "sound_speed": SPEED})
    at = np.array([2.0, 11.0])
    pairs = [1 / np.interp(2.0, DEPTH, SPEED), 1 / np.interp(11.0, DEPTH, SPEED)]
    expected = 1 / np.mean([*pairs, *[slowness(2.0, 11.0)] * 2])
    np.testing.assert_allclose(speed_among(profile, at), expected, rtol=1e-8)
