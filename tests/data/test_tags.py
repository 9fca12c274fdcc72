"""The tags table: codes of one animal, sensor values in units, burst limits, other names."""

import numpy as np
import pytest

from maloc.data import Detections, sensor_values
from maloc.data._codespaces import canonical, same_tags
from maloc.errors import InputError
from maloc.readers import read_tags

NS = 1_000_000_000
T0 = 1_622_548_800 * NS


@pytest.fixture
def read(tmp_path):
    def from_text(text):
        (tmp_path / "tags.csv").write_text(text)
        return read_tags(tmp_path / "tags.csv")

    return from_text


TABLE = (
    "tag,animal,sensor,slope,intercept,min_delay,max_delay,start,end\n"
    "A69-9006-501,pike1,Pressure,0.3,-1.2,60,120,2021-06-01 00:00,\n"
    "A69-9006-502,pike1,temp,0.15,-5,60,120,2021-06-01 00:00,2021-06-02 00:00\n"
    "A69-1303-345,perch,,,,,,,\n"
)


def some(tags, values, times=None, **extra):
    n = len(tags)
    times = T0 + 1000 * NS * np.arange(n) if times is None else np.array(times)
    extra = {"sensor": np.array(values, float), **extra}
    return Detections(times, np.array(["A"] * n), np.array(tags), extra)


def test_two_codes_are_one_animal_with_depth_and_temperature(read):
    tags = read(TABLE)
    late = T0 + 30 * 86400 * NS
    d = some(
        ["A69-9006-501", "A69-9006-502", "R64K-345", "A69-1-9", "A69-9006-502"],
        [10, 100, np.nan, np.nan, 100],
        [T0, T0 + NS, T0 + 2 * NS, T0 + 3 * NS, late],
    )
    by_animal = tags.apply(d)
    assert by_animal.tag.tolist() == ["pike1", "pike1", "perch", "A69-1-9", "A69-9006-502"]
    assert by_animal.extra["code"].tolist() == d.tag.tolist()
    np.testing.assert_allclose(by_animal.extra["depth"], [1.8] + [np.nan] * 4)
    np.testing.assert_allclose(by_animal.extra["temperature"], [np.nan, 10.0] + [np.nan] * 3)
    said = str(by_animal.report)
    assert "1 detections of A69-9006-502 are from when pike1 did not carry it" in said
    assert "not in the tags table: A69-1-9" in said


def test_limits_by_code_and_by_animal(read):
    tags = read(TABLE)
    assert tags.limits("A69-9006-501") == tags.limits("pike1") == (60.0, 120.0)
    assert tags.limits("perch") is None and tags.limits("nobody") is None
    etn = read(
        "tag_serial_number,acoustic_tag_id,manufacturer,model,frequency,step1_min_delay,"
        "step1_max_delay,step1_power\n1,A69-1601-5,VEMCO,V13,69,80,160,High\n"
    )
    assert etn.limits("A69-1601-5") == (80.0, 160.0)
    assert "columns not used: tag_serial_number, manufacturer" in str(etn.report)
    apart = read("transmitter_codespace,transmitter_id,animal_id\nA69-1601,5,9\n")
    assert apart.tag.tolist() == ["A69-1601-5"] and apart.animal.tolist() == ["9"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("animal,min_delay\nx,1\n", "no column names the tag"),
        ("tag,animal\nA-1,x\nA-1,y\n", "tag A-1 is there twice"),
        ("tag,animal\nR64K-345,x\nA69-1303-345,y\n", "tag A69-1303-345 is there twice"),
        ("tag,min_delay,max_delay\nA-1,40,20\n", "burst interval of tag A-1: 40 to 20 s"),
        ("tag,min_delay,max_delay\nA-1,soon,20\n", "line 2, column 'min_delay': 'soon'"),
    ],
)
def test_tables_that_cannot_be(read, text, says):
    with pytest.raises(InputError, match=says):
        read(text)


def test_sync_tags_beside_receivers(read):
    from maloc.data import Receivers

    r = Receivers(np.array(["301001", "VR2W-301002"]), np.zeros(2), np.arange(2.0))
    tags = read("serial,transmitter\n301001,A69-1602-60001\nVR2W-301002,A69-1602-60002\n")
    assert tags.beside(r).sync_tag.tolist() == ["A69-1602-60001", "A69-1602-60002"]
    assert read(TABLE).beside(r) is r
    with pytest.raises(InputError, match="stands beside 9, which is not a receiver"):
        read("serial,transmitter\n9,A-1\n").beside(r)
    with pytest.raises(InputError, match="has two sync tags"):
        read("serial,transmitter\n301001,A-1\n301001,A-2\n").beside(r)


def test_values_that_say_their_unit():
    d = some(
        ["A-1", "A-2", "A-1", "A-3"], [2.5, 11.0, 3.5, 77],
        sensor_unit=np.array(["m", "°C", "m", "ADC"], object),
    )  # fmt: skip
    found = sensor_values(d)
    np.testing.assert_allclose(found.extra["depth"], [2.5, np.nan, 3.5, np.nan])
    np.testing.assert_allclose(found.extra["temperature"], [np.nan, 11.0, np.nan, np.nan])
    assert "1 sensor values are raw counts" in str(found.report)
    assert sensor_values(some(["A-1"], [2.5])).extra.keys() == {"sensor"}


def test_names_of_code_spaces():
    assert canonical("R64K-345") == canonical("R64K-69kHz-345") == "A69-1303-345"
    assert canonical("S256-1") == "A69-1105-1" and canonical("R256-1") == "A69-1008-1"
    assert canonical("R04K-1") == canonical("R94K-1") == "A69-1206-1"
    assert canonical("OPS-7") == "OPs-7" and canonical("A69-1602-1") == "A69-1602-1"
    assert same_tags(["R64K-1", "A69-1303-1", "b0", "B0", "OPS-7", "OPs-7"]) == {
        "R64K-1": "A69-1303-1", "OPS-7": "OPs-7"}  # fmt: skip
