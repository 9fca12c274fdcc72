"""How sure a sound speed is by where it comes from; tables and profiles of --sound-speed."""

from typing import Any

import numpy as np
import polars as pl
import pytest

from maloc.errors import InputError
from maloc.runs.depth import with_depth
from maloc.runs.load import load
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.sound import with_sound
from maloc.runs.speed import speed_error, speed_of_water, sync_speed
from tests.infer import cases

CAST = {"depth": [0.0, 5.0, 7.0, 12.0], "sound_speed": [1494.0, 1492.0, 1450.0, 1448.0]}


@pytest.fixture
def study(tmp_path):
    """A matrix of arrival times with depths, and its receivers 11 m deep."""
    toa = cases.toa(pings=6, unheard=())[0]
    names = toa.receivers.labels
    place = {"receiver": names, "x": toa.receivers.x, "y": toa.receivers.y, "depth": 11.0}
    pl.DataFrame(place).write_csv(tmp_path / "r.csv")
    table = pl.DataFrame(toa.toa + 1_600_000_000.0, schema=list(names)).fill_nan(None)
    table.with_columns(pl.Series("depth", [2.0, 3.0, 4.0, 6.5, 8.0, 11.0])).write_csv(
        tmp_path / "toa.csv"
    )
    return tmp_path


def read(study, **more: Any):
    """Arrival times as a fit gets them, and what was said on the way."""
    given: dict[str, Any] = {"toa": study / "toa.csv", "receivers": study / "r.csv"}
    options, log = TrackOptions(**given | more), Log(quiet=True)
    source = with_sound(with_depth(load(options, log), options, log), options, log)
    return source.toas[0], [*log.warnings, *log.notices]


def with_column(study, name, value):
    table = pl.read_csv(study / "toa.csv")
    table.with_columns(pl.lit(value).alias(name)).write_csv(study / "toa.csv")


@pytest.mark.parametrize(
    ("more", "speed", "sd"),
    [
        ({}, 1500.0, 30.0),
        ({"sound_speed": "1482.5"}, 1482.5, 3.0),
        ({"sound_speed": "1482.5", "sound_speed_sd": "0.4"}, 1482.5, 0.4),
        ({"sound_speed": "1482.5", "sound_speed_sd": "exact"}, 1482.5, None),
        ({"sound_speed": "1482.5", "sound_speed_sd": "0"}, 1482.5, None),
        ({"sound_speed": "estimated"}, 1500.0, 30.0),
    ],
)
def test_how_sure_a_number_is(study, more, speed, sd):
    toa, said = read(study, **more)
    np.testing.assert_allclose(toa.sound_speed, speed)
    assert toa.sound_speed_sd == sd
    assert any("1500 m/s assumed" in text for text in said) == (sd == 30.0)


def test_a_column_of_a_matrix_is_a_prior_too(study):
    with_column(study, "ss", 1470.0)
    assert read(study)[0].sound_speed_sd == 3.0
    assert read(study, sound_speed_sd="exact")[0].sound_speed_sd is None
    assert read(study, sound_speed="estimated")[0].sound_speed_sd is None  # 1 % in the model
    np.testing.assert_allclose(read(study, sound_speed_sd="2")[0].sound_speed, 1470.0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"sound_speed_sd": "3"}, "--sound-speed-sd needs --sound-speed C, or a column"),
        (
            {"sound_speed": "1500", "sound_speed_sd": "sure"},
            "sure is neither m/s, 0 to 100, nor ex",
        ),
        ({"sound_speed": "1500", "sound_speed_sd": "-1"}, "-1 is neither"),
        ({"sound_speed": "estimated", "sound_speed_sd": "1"}, "goes with a speed, not --sound-spe"),
        ({"sound_speed": "1482.5 exact"}, "no file.*--sound-speed-sd"),
        ({"receiver_sd": -1.0}, "--receiver-sd -1 m is negative"),
        ({"receiver_sd": 1.0, "model": "detections"}, "--receiver-sd goes with --model toa or joi"),
    ],
)
def test_sds_that_cannot_be_meant(study, more, message):
    with pytest.raises(InputError, match=message):
        read(study, **more)


def test_a_table_in_time(study):
    """Nothing is assumed beside it, and the equation is named."""
    time = ["2020-09-13T12:00:00Z", "2020-09-13T13:00:00Z"]
    water = pl.DataFrame({"time": time, "temperature": [10.0, 10.0], "salinity": [0.0, 0.0]})
    water.write_csv(study / "water.csv")
    toa, said = read(study, sound_speed=str(study / "water.csv"))
    assert toa.sound_speed == pytest.approx(np.full(6, 1447.27), abs=0.05) and toa.profile is None
    assert toa.sound_speed_sd == 1.0
    assert not any("assumed" in text for text in said)
    assert any("Chen & Millero (1977)" in text for text in said)
    exact, _ = read(study, sound_speed=str(study / "water.csv"), sound_speed_sd="exact")
    assert exact.sound_speed_sd is None
    water.drop("salinity").write_csv(study / "water.csv")
    with pytest.raises(InputError, match="no column 'salinity'; add it, 0 for fresh water"):
        read(study, sound_speed=str(study / "water.csv"))


def test_depths_of_a_logger_are_no_profile(study):
    time = ["2020-09-13T12:00:00Z", "2020-09-13T13:00:00Z"]
    columns = {"time": time, "depth": [0.0, 9.0], "sound_speed": [1490.0, 1450.0]}
    pl.DataFrame(columns).write_csv(study / "water.csv")
    toa, said = read(study, sound_speed=str(study / "water.csv"))
    assert toa.profile is None
    assert any("these are a logger's depths; a profile has one time" in text for text in said)


def test_a_profile_with_and_without_depths(study):
    path = study / "cast.csv"
    pl.DataFrame(CAST).write_csv(path)
    how = {"sound_speed": str(path)}
    deep, said = read(study, **how, depth="sensor", depth_sd=0.5, bottom="12")
    assert deep.profile is not None and deep.column is not None
    assert any("1448.0 to 1494.0 m/s from 0 to 12 m" in text for text in said)
    assert not any("give or take" in text for text in said)
    flat, said = read(study, **how)
    np.testing.assert_allclose(flat.sound_speed, deep.sound_speed)
    assert any("by the profile at the sensed depths" in text for text in said)
    at_five, _ = read(study, **how, depth="5")
    assert np.ptp(at_five.sound_speed) < 1e-9 < np.ptp(deep.sound_speed)
    table = pl.read_csv(study / "toa.csv").drop("depth")
    table.write_csv(study / "toa.csv")
    blind, said = read(study, **how)
    assert blind.sound_speed_sd is not None and 8 < blind.sound_speed_sd < 15
    assert any("depth neither sensed nor estimated" in text for text in said)
    found, said = read(study, **how, depth="3d")
    assert found.sound_speed_sd == 1.0 and not any("neither" in text for text in said)


def test_what_the_clocks_are_fitted_with(study):
    """A number is a prior there, too; a profile counts at the receivers' depths."""
    receivers = load(
        TrackOptions(toa=study / "toa.csv", receivers=study / "r.csv"), Log(True)
    ).receivers
    assert sync_speed(None, None, receivers) == {"sound_speed": None}
    assert sync_speed(1480.0, None, receivers) == {"sound_speed": 1480.0, "sound_speed_sd": 3.0}
    assert sync_speed(1480.0, 0.0, receivers)["sound_speed_sd"] == 0.0
    path = study / "cast.csv"
    pl.DataFrame(CAST).write_csv(path)
    got = sync_speed(path, None, receivers)
    assert got["sound_speed"] == pytest.approx(1448.4) and got["sound_speed_sd"] == 1.0
    casts = {"time": ["2020-09-13T12:00:00Z"] * 4 + ["2020-09-13T13:00:00Z"] * 4}
    casts |= {k: [*v, *v] for k, v in CAST.items()}
    pl.DataFrame(casts).write_csv(path)
    found = sync_speed(path, None, receivers)["sound_speed"]
    np.testing.assert_allclose(found["sound_speed"], 1448.4)
    assert str(found["time"][1]).startswith("2020-09-13T13:00")


def test_words_of_the_options(tmp_path):
    assert speed_error(None) is None and speed_error("exact") == 0.0 and speed_error("2.5") == 2.5
    assert speed_of_water("1480") == 1480.0 and speed_of_water(None) is None


def test_errors_of_the_receivers_places(study):
    toa, _ = read(study)
    assert toa.receivers.position_sd is None
    toa, _ = read(study, receiver_sd=1.5)
    assert toa.receivers.position_sd is not None
    np.testing.assert_allclose(toa.receivers.position_sd, 1.5)


@pytest.mark.extended
def test_limits_hold_below_a_thermocline(shared_dir, tmp_path):
    """Rays bent by Bellhop: exact, the column's mean speed misleads; a profile does not."""
    from maloc import infer, models
    from maloc.infer.track import track_table

    place = shared_dir / "data" / "rays" / "s08_thermo_mud_deep"
    depth = np.arange(0.0, 12.25, 0.25)
    step = 10.0 + 14.0 / (1 + np.exp((depth - 6.5) / 0.8))
    cast = {"depth": depth, "temperature": step, "salinity": np.zeros(len(depth))}
    pl.DataFrame(cast).write_csv(tmp_path / "cast.csv")
    files = {"toa": place / "toa_depth.csv", "receivers": place / "receivers.csv"}
    truth = pl.read_csv(place / "toa.csv", null_values=["NA"]).select("x", "y").to_numpy()
    held = {}
    for name, how in {
        "mean": {"sound_speed": "1473.25", "sound_speed_sd": "exact"},
        "profile": {"sound_speed": str(tmp_path / "cast.csv")},
    }.items():
        toa, _ = read(tmp_path, **files, **how, depth="sensor", depth_sd=0.5, bottom="12")
        fit = infer.laplace(models.toa_track, toa, draws=400, seed=1)
        table = track_table(fit, toa, 1).filter(pl.col("heard"))
        low, high = (table.select(f"x_{end}", f"y_{end}").to_numpy() for end in ("lo", "hi"))
        held[name] = float(np.mean((low <= truth) & (truth <= high)))
    assert held["mean"] < 0.8 and 0.92 <= held["profile"] <= 0.97
