"""The containers: validation, immutability, round trips."""

# pyright: reportArgumentType=false

import pickle
import subprocess
import sys

import numpy as np
import polars as pl
import pytest

from maloc.data import (
    ArrivalTimes,
    Detections,
    Note,
    ReadReport,
    Receivers,
    Schedule,
    SetAside,
    SoundProfile,
    collinear,
    match_tag,
)
from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers, read_toa

T0 = 1_622_548_800_217_000_001


def detections(**changes):
    fields = {
        "time": np.array([T0, T0 + 5]),
        "receiver": ["301001", "301002"],
        "tag": ["A69-1602-12345", "A69-9001-12345"],
        "extra": {"snr": [1.5, np.nan], "station": np.array(["Sø 1", None], dtype=object)},
    }
    return Detections(**(fields | changes))


def receivers():
    return Receivers(["a", "b", "c"], [0.0, 100.0, 50.0], [0.0, 0.0, 80.0])


def test_detections_survive_frame_and_pickle_to_the_nanosecond():
    d = detections()
    for other in (Detections.from_frame(d.to_frame()), pickle.loads(pickle.dumps(d))):
        assert other.time.tolist() == [T0, T0 + 5]
        assert other.receiver.tolist() == ["301001", "301002"]
        assert other.tag.tolist() == d.tag.tolist()
        assert other.extra["station"].tolist() == ["Sø 1", None]
        np.testing.assert_array_equal(other.extra["snr"].astype(float), [1.5, np.nan])


def test_arrays_are_read_only_and_do_not_share_the_input():
    time = np.array([T0, T0 + 5])
    d = detections(time=time)
    time[0] = 0
    assert d.time[0] == T0
    with pytest.raises(ValueError, match="read-only"):
        d.time[0] = 1
    with pytest.raises(AttributeError):
        d.time = time  # pyright: ignore


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"time": [1.5, 2.5]}, "int64 ns"),
        ({"time": np.array(["2021-06-01", "NaT"], "datetime64[ns]")}, "NaT"),
        ({"receiver": ["301001"]}, "shape"),
        ({"tag": [1, 2]}, "text"),
        ({"tag": ["x", None]}, "missing"),
        ({"extra": {"snr": [1.0]}}, "snr"),
    ],
)
def test_detections_refuse(changes, says):
    with pytest.raises(InputError, match=says):
        detections(**changes)


def test_pandas_like_frames_and_zones_are_taken():
    df = (
        detections()
        .to_frame()
        .with_columns(pl.col("time").dt.convert_time_zone("America/New_York"))
    )
    assert Detections.from_frame(df).time.tolist() == [T0, T0 + 5]
    assert Detections.from_frame(
        {c: df[c].to_list() for c in ("receiver", "tag")}
        | {"time": np.array([T0, T0 + 5], "datetime64[ns]")}
    ).time.tolist() == [T0, T0 + 5]


def test_select_and_concat():
    d = detections()
    assert d.select(tag="1602-12345").receiver.tolist() == ["301001"]
    assert d.select(receiver=["301002"]).tag.tolist() == ["A69-9001-12345"]
    assert len(d.select(mask=np.array([True, False]))) == 1
    both = Detections.concat([d, detections(extra={})])
    assert len(both) == 2
    assert [n.count for n in both.report.notes] == [2]
    assert both.report.rows == 2


def test_find_tag_needs_a_unique_ending():
    d = detections()
    assert d.find_tag("A69-9001-12345") == "A69-9001-12345"
    for short in ("12345", 12345):
        with pytest.raises(InputError, match="ambiguous, 2 transmitters: A69-1602-12345, A69-9001"):
            d.find_tag(short)
    with pytest.raises(InputError, match="no tag '2345'.*A69-1602-12345"):
        d.find_tag("2345")
    assert match_tag(["A69-1602-59334", "59335"], "59334") == "A69-1602-59334"
    with pytest.raises(InputError, match="no tag ''"):
        match_tag(["A69-1602-59334"], "")


def test_receivers_by_time_and_place():
    day = np.int64(86_400_000_000_000)
    lowest, highest = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    r = Receivers(
        ["a", "b", "a"], [0, 1, 2.0], [0, 1, 5.0], start=[lowest, 0, 2 * day], end=[day, 3, highest]
    )
    assert r.names == ("a", "b") and r.labels == ("a#1", "b", "a#2")
    names = np.array(["a", "a", "a", "a", "b", "z"])
    times = np.array([-5, day, 2 * day - 1, 2 * day, 2, 2])
    assert r.deployment_of(names, times).tolist() == [0, -1, -1, 2, 1, -1]
    again = read_receivers(r.to_frame())
    assert again.start.tolist() == r.start.tolist() and again.end.tolist() == r.end.tolist()
    np.testing.assert_array_equal(again.xy, r.xy)
    assert pickle.loads(pickle.dumps(r)).labels == r.labels
    assert r.subset([2, 0]).labels == ("a#1", "a#2")


def test_model_and_serial_name_one_receiver():
    r = Receivers(["VR2W-301001", "301002", "S18-2"], [0, 1, 2.0], [0, 1, 5.0])
    names = np.array(["301001", "VR2W-301001", "HR2-180K-301002", "S18", "2", "S18-2"])
    assert r.deployment_of(names, np.zeros(6, np.int64)).tolist() == [0, 0, 1, -1, -1, 2]
    assert r.knows("VR2Tx-301002") and not r.knows("2")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"x": [0, 1, np.nan]}, "x is not finite"),
        ({"y": [0, np.inf, 1]}, "y is not finite"),
        ({"receiver": ["a", "a", "b"]}, "two deployments of receiver a overlap"),
        ({"start": [5, 5, 5], "end": [6, 5, 6]}, "receiver b ends .* before it starts"),
        ({"receiver": ["a", "", "b"]}, "no name"),
        ({"depth": [1.0]}, "shape"),
    ],
)
def test_receivers_refuse(changes, says):
    fields = {"receiver": ["a", "b", "c"], "x": [0, 1, 2.0], "y": [0, 0, 0.0]}
    with pytest.raises(InputError, match=says):
        Receivers(**(fields | changes))


def test_collinear_in_any_direction():
    t = np.linspace(0, 900, 5)
    names = list("abcde")
    for angle in (0.0, 0.7, np.pi / 2):
        x, y = t * np.cos(angle) + 5e5, t * np.sin(angle) + 6e6
        assert collinear(Receivers(names, x, y))
        bent = y + np.array([0, 0, 8.0, 0, 0]) if angle == 0 else y
        bent_x = x + np.array([0, 0, 12.0, 0, 0]) if angle else x
        assert not collinear(Receivers(names, bent_x, bent))
    assert collinear(Receivers(["a", "b"], [0, 1.0], [0, 9.0]))


def test_arrival_times_properties_and_round_trip():
    toa = [[1, 2, np.nan], [np.nan] * 3, [4, 5, 6], [np.nan] * 3]
    a = ArrivalTimes(toa, receivers(), 1480.0, "t", depth=[1, 2, np.nan, 4])
    assert (a.n_pings, a.n_receivers) == (4, 3)
    assert a.n_heard.tolist() == [2, 0, 3, 0]
    assert a.first.tolist() == [1.0, 2.5, 4.0, 5.5]
    assert a.ping.tolist() == [1, 2, 3, 4]
    b = read_toa(a.to_frame(), receivers())
    np.testing.assert_array_equal(b.toa, a.toa)
    np.testing.assert_array_equal(b.sound_speed, a.sound_speed)
    np.testing.assert_array_equal(b.depth, a.depth)
    assert b.tag == "t"
    assert np.isnan(ArrivalTimes([[np.nan] * 3], receivers(), 1480.0).first).all()
    assert a.replace(tag="u").tag == "u"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"toa": [[1, 2]]}, r"toa must be \(P, 3\)"),
        ({"toa": [[1, 2, np.inf]]}, "not finite"),
        ({"toa": [[5, 6, 7], [1, 2, 3]]}, "time order"),
        ({"sound_speed": 0.0}, "positive"),
        ({"sound_speed": [np.nan, 1500.0]}, "sound_speed"),
        ({"ping": [1.5, 2.5]}, "whole"),
    ],
)
def test_arrival_times_refuse(changes, says):
    fields = {"toa": [[1, 2, 3], [5, 6, 7]], "receivers": receivers(), "sound_speed": 1500.0}
    with pytest.raises((InputError, ValueError), match=says):
        ArrivalTimes(**(fields | changes))


def test_schedule_and_set_aside_refuse():
    assert Schedule("random", 20, 40).shortest == 20
    assert Schedule("stable", 60, 0.001).shortest == pytest.approx(59.994)
    assert np.isnan(Schedule().shortest)
    for bad in (("random", 40, 20), ("random", -1, 5), ("stable", 60, np.nan), ("weekly", 1, 2)):
        with pytest.raises(InputError):
            Schedule(*bad)
    with pytest.raises(InputError):
        SetAside(["a"], [np.nan], [0], ["why"])


def test_reports_merge_without_repeats():
    a = ReadReport("f", ("x",), 2).note("warning", "odd", file="x")
    b = ReadReport("f", ("y",), 3).add(Note("info", "fine"))
    both = ReadReport.merge([a, b, a])
    assert (both.format, both.files, both.rows) == ("f", ("x", "y"), 7)
    assert len(both.notes) == 2 and len(both.warnings) == 1
    with pytest.raises(ValueError, match="level"):
        Note("bad", "x")


def test_errors_of_the_receivers_places():
    r = Receivers(["a", "b"], [0.0, 100.0], [0.0, 0.0], position_sd=[0.5, 0.0])
    np.testing.assert_array_equal(r.subset([1]).position_sd, [0.0])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(r)).position_sd, [0.5, 0.0])
    assert receivers().position_sd is None and receivers().subset([0]).position_sd is None
    for wrong, says in (([1.0], "shape"), ([1.0, -1.0], "negative"), ([1.0, np.nan], "not finite")):
        with pytest.raises(InputError, match=says):
            Receivers(["a", "b"], [0.0, 100.0], [0.0, 0.0], position_sd=wrong)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"depth": [0.0, 0.0]}, "do not ascend"),
        ({"speed": [1500.0, -1.0]}, "positive"),
        ({"speed": [[1500.0, 1480.0]] * 2}, "needs their times"),
        ({"speed": [[1500.0, 1480.0]] * 2, "time": [5.0, 5.0]}, "times of the casts"),
        ({"speed": [1500.0]}, "shape"),
        ({"sd": -1.0}, "negative"),
    ],
)
def test_profiles_that_cannot_be(changes, says):
    fields = {"depth": [0.0, 10.0], "speed": [1500.0, 1480.0]}
    assert SoundProfile(**fields) == SoundProfile(**fields) != SoundProfile(**fields, sd=1.0)
    with pytest.raises(InputError, match=says):
        SoundProfile(**(fields | changes))


def test_importing_the_data_package_loads_neither_jax_nor_polars():
    code = (
        "import sys; from maloc.data import Detections, Receivers, ArrivalTimes, toa_matrix; "
        "import maloc.readers.check; "
        "bad = {'jax', 'polars', 'pyproj'} & set(sys.modules); print(bad)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "set()"


def test_reprs_say_what_is_there():
    assert "2 of 2 tags by 2 receivers" in repr(detections())
    assert "3, 100 x 80 m" in repr(receivers())
    assert repr(Detections([], [], [])) == "Detections: none"


def test_frames_of_pandas_and_of_text():
    import pandas as pd

    times = pd.to_datetime([T0, T0 + 5]).tz_localize("UTC")
    df = pd.DataFrame({"time": times, "receiver": ["1", "2"], "tag": ["A", "B"], "snr": [1.0, 2.0]})
    for other in (df, df.assign(time=df["time"].dt.tz_convert("Asia/Tokyo"))):
        d = Detections.from_frame(other)
        assert d.time.tolist() == [T0, T0 + 5] and d.extra["snr"].tolist() == [1.0, 2.0]
    text = pl.DataFrame({"epo": ["1622548800"], "frac": ["0.25"], "serial": ["7"], "tag": ["A"]})
    assert read_detections(text).time.tolist() == [1622548800 * 10**9 + 250_000_000]
    with pytest.raises(InputError, match="unknown header"):
        read_detections(pl.DataFrame({"a": [1]}))
    with pytest.warns(DeprecationWarning, match="another layout is maloc.readers.read_detections"):
        assert len(Detections.from_frame(text)) == 1
    with pytest.raises(InputError, match="1 missing values"):
        Detections.from_frame(detections().to_frame().with_columns(tag=pl.Series(["A", None])))
