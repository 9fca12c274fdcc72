"""Sound speed: Mackenzie's own check value, another equation, tables met in time."""

import numpy as np
import polars as pl
import pytest

from maloc.errors import InputError
from maloc.world.medium import mackenzie, with_sound_speed
from tests.infer import cases


def test_mackenzie_check_value():
    """Mackenzie (1981): 25 deg C, salinity 35, 1000 m: 1550.744 m/s."""
    assert mackenzie(25.0, 35.0, 1000.0) == pytest.approx(1550.744, abs=1e-3)


def test_mackenzie_against_medwin():
    """Medwin (1975), a simpler equation: within 1 m/s in the shallow sea."""
    t, s, z = np.meshgrid([2.0, 10.0, 20.0, 30.0], [25.0, 35.0, 40.0], [0.0, 50.0, 100.0])
    medwin = 1449.2 + 4.6 * t - 0.055 * t**2 + 2.9e-4 * t**3 + (1.34 - 0.01 * t) * (s - 35)
    np.testing.assert_allclose(mackenzie(t, s, z), medwin + 0.016 * z, atol=1.0)


def test_what_is_no_water_is_refused():
    with pytest.raises(InputError, match="temperature 60 is not between"):
        mackenzie(60.0)


def times():
    return cases.toa(pings=6, unheard=())[0].replace(origin=1_600_000_000 * 10**9)


def table(**columns):
    time = np.array([1_600_000_000, 1_600_000_400], "datetime64[s]")
    return pl.DataFrame({"time": np.datetime_as_string(time).tolist(), **columns})


def test_speed_is_interpolated_in_time(tmp_path):
    path = tmp_path / "water.csv"
    table(temperature=[10.0, 14.0], salinity=[35.0, 30.0]).write_csv(path)
    got = with_sound_speed(times(), path, sd=0.5)
    share = got.first / 400.0
    ends = mackenzie(np.array([10.0, 14.0]), np.array([35.0, 30.0]))
    np.testing.assert_allclose(got.sound_speed, np.interp(share, [0, 1], ends), rtol=1e-9)
    assert got.sound_speed_sd == 0.5


def test_a_table_of_speeds_serves_too():
    got = with_sound_speed(times(), table(sound_speed=[1500.0, 1500.0]))
    np.testing.assert_allclose(got.sound_speed, 1500.0)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"salinity": [35.0, 35.0]}, "no column 'temperature'"),
        ({"temperature": [10.0, 10.0]}, "no column 'salinity'; give salinity="),
        ({"temperature": [10.0, None], "salinity": [35.0, 35.0]}, "line 3: a value is missing"),
    ],
)
def test_what_a_table_lacks(columns, message):
    with pytest.raises(InputError, match=message):
        with_sound_speed(times(), table(**columns))


def test_a_table_of_another_year():
    with pytest.raises(InputError, match="another time"):
        with_sound_speed(times().replace(origin=10**18), table(sound_speed=[1500.0, 1500.0]))


def test_arrival_times_without_a_date():
    with pytest.raises(InputError, match="have no date"):
        with_sound_speed(times().replace(origin=None), table(sound_speed=[1500.0, 1500.0]))
