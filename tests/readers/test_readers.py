"""Readers, format by format: exact times, what is skipped, what is refused and in which words."""

import gzip

import numpy as np
import polars as pl
import pytest

from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers

VUE = "Date and Time (UTC),Receiver,Transmitter,Transmitter Name,Station Name"
NS = 1_000_000_000


def ns(stamp):
    return int(np.datetime64(stamp, "ns").astype(np.int64))


@pytest.mark.parametrize(
    ("written", "fraction"),
    [
        ("", 0), (".5", 500_000_000), (".05", 50_000_000), (".005", 5_000_000),
        (".123456789", 123_456_789), (".000000001", 1), (",25", 250_000_000), (".", 0),
        (".1234567891", 123_456_789), (".217Z", 217_000_000), (".217000+00:00", 217_000_000),
    ],
)  # fmt: skip
def test_fractions_are_exact(read, written, fraction):
    text = f"time\treceiver\ttag\n2021-06-01T10:00:00{written}\t1\tA\n"
    assert read(text).time.tolist() == [ns("2021-06-01T10:00:00") + fraction]


def test_offsets_and_zones(read):
    text = "time,receiver,tag\n2021-06-01 12:00:00.5+02:00,1,A\n2021-06-01T05:30:00.500-0430,1,A\n"
    d = read(text)
    assert set(d.time.tolist()) == {ns("2021-06-01T10:00:00.5")}
    winter = read("time,receiver,tag\n2021-01-01 12:00:00.5,1,A\n", tz="America/New_York")
    assert winter.time[0] == ns("2021-01-01T17:00:00.5")
    with pytest.raises(InputError, match="local time"):
        read("time_local,receiver,tag\n2021-01-01 12:00:00.5,1,A\n")
    with pytest.raises(InputError, match="'EST'.*not known"):
        read("Date and Time (EST),Receiver,Transmitter\n2021-01-01 12:00:00.5,VR2W-1,A-1\n")


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("01/06/2021 10:00", "day and month"),
        ("2021-06-01 10:00", "seconds are missing"),
        ("2021-06-31 10:00:00", "is not a date and time"),
        ("2021-13-01 10:00:00", "is not a date and time"),
        ("2021-06-01 24:00:01", "is not a date and time"),
        ("2021-06-01 10:00:60", "is not a date and time"),
        ("1021-06-01 10:00:00", "is not a date and time"),
        ("2021-06-01 10:00:00 PM", "is not a date and time"),
        ("yesterday", "is not a date and time"),
        ("44348.4167", "is not a date and time"),
    ],
)
def test_times_that_cannot_be_read_name_line_and_column(read, value, says):
    good = "2021-06-01 10:00:00.217"
    with pytest.raises(InputError, match=f"line 3, column 'time'.*{says}") as e:
        read(f"time,receiver,tag\n{good},1,A\n{value},1,A\n")
    assert e.value.row == 3 and e.value.column == "time"


def test_epo_and_frac(read):
    exact = read("tag,epo,frac,serial\n345,1622548800,0.000000001,7\n345,1622548801,.25,7\n")
    assert exact.time.tolist() == [1622548800 * NS + 1, 1622548801 * NS + 250_000_000]
    for rows, says in (
        ("345,1622548800,217,7", "outside 0..1"),
        ("345,1622548800,,7", "fraction of a second is missing"),
        ("345,1622548800.5,.25,7", "already has a fraction"),
        ("345,1.6225488E9,.25,7", "exponent"),
        ("345,1622548800217,.25,7", "milliseconds"),
        ("345,abc,.25,7", "not a number of seconds"),
    ):
        with pytest.raises(InputError, match=says):
            read(f"tag,epo,frac,serial\n{rows}\n")
    epo = read("receiver,tag,epo\n7,345,1622548800.123456789\n")
    assert epo.time.tolist() == [1622548800123456789]


def test_names_met_in_the_wild(read):
    glatos = read(
        "animal_id,detection_timestamp_utc,transmitter_codespace,transmitter_id,receiver_sn\n"
        "9,2021-06-01 10:00:00,A69-1602,12345,301001\n"
    )
    assert glatos.tags == ("A69-1602-12345",) and glatos.receivers == ("301001",)
    actel = read(
        "Timestamp,Receiver,CodeSpace,Signal,Sensor.Value,Sensor.Unit\n"
        "2021-06-01 10:00:00,301001,R64K,4529,NA,NA\n"
    )
    assert actel.tags == ("R64K-4529",) and not actel.extra
    etn = read(
        "date_time,acoustic_tag_id,receiver_id,snr\n2021-05-02T22:23:37.384Z,OPi-111,1514,14\n"
    )
    assert etn.tags == ("OPi-111",) and etn.extra["snr"].tolist() == [14.0]
    assert etn.time[0] == ns("2021-05-02T22:23:37.384")


def test_vue_receivers_split_at_the_last_dash(read):
    d = read(
        f"{VUE}\n2021-06-01 10:00:00.1,HR2-180K-100-LI-461548,A180-1702-5,,\n"
        "2021-06-01 10:00:00.2,VR2-7333c,A69-1602-5,,ST1\n2021-06-01 10:00:00.3,301001,A69-1-5,,\n"
    )
    assert d.receiver.tolist() == ["461548", "7333c", "301001"]
    assert d.extra["model"].tolist() == ["HR2-180K-100-LI", "VR2", None]
    assert d.tag.tolist() == ["A180-1702-5", "A69-1602-5", "A69-1-5"]


def test_zero_position_is_missing_but_zero_latitude_is_not(read):
    head = "Date and Time (UTC),Receiver,Transmitter,Latitude,Longitude"
    rows = ["+0,+0", "0.0,12.5", ",", "55.5,8.5"]
    body = "".join(f"2021-06-01 10:00:0{i}.5,VR2W-1,A-1,{r}\n" for i, r in enumerate(rows))
    d = read(f"{head}\n{body}")
    np.testing.assert_array_equal(d.extra["latitude"], [np.nan, 0.0, np.nan, 55.5])
    np.testing.assert_array_equal(d.extra["longitude"], [np.nan, 12.5, np.nan, 8.5])


def test_whole_seconds_are_pointed_out(read):
    body = "".join(f"2021-06-01 10:00:0{i},VR2W-1,A-1,,\n" for i in range(5))
    (warning,) = read(f"{VUE}\n{body}").report.warnings
    assert "millisecond time precision" in warning.text and "1 s = 1500 m" in warning.text
    assert not read(f"{VUE}\n{body}2021-06-01 10:00:09.001,VR2W-1,A-1,,\n").report.warnings


def test_line_ends_quotes_blank_lines_and_encodings(read):
    rows = ['"2021-06-01 10:00:00.5","VR2W-1","A69-1-1","a ""b"", c",', "", " ",
            '"2021-06-01 10:00:01.5",VR2W-1,A69-1-1,,Sø']  # fmt: skip
    for end in ("\n", "\r\n", "\r\r\n", "\r"):
        for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
            d = read(end.join([VUE, *rows]).encode(encoding))
            assert len(d) == 2
            assert d.extra["transmitter_name"].tolist() == ['a "b", c', None]
            assert d.extra["station"].tolist() == [None, "Sø"]


def test_rows_that_do_not_fit_the_header(read):
    good = "2021-06-01 10:00:00.5,VR2W-1,A69-1-1,,\n"
    with pytest.raises(InputError, match="line 3.*6 fields under 5"):
        read(f"{VUE}\n{good}2021-06-01 10:00:01,5,VR2W-1,A69-1-1,,x\n")
    assert len(read(f"{VUE}\n{good}2021-06-01 10:00:01.5,VR2W-1,A69-1-1,,,,,\n")) == 2
    with pytest.raises(InputError, match="line 3: unknown header"):
        read(f"{VUE}\n{good}{VUE.split(',')[0]},Colour,Receiver,,\n")
    with pytest.raises(InputError, match="broken quotes"):
        read(f'{VUE}\n{good}2021-06-01 10:00:01.5,"VR2W-1,A69-1-1,,\n')
    d = read(f"{VUE}\n{good}2021-06-01 10:00:01.5,VR2W-1,,,\n,VR2W-1,A69-1-1,,\n{good}")
    assert len(d) == 1
    assert "2 incomplete rows left out (lines 3, 4)" in [n.text for n in d.report.notes]


def test_last_line_cut_within_an_id_is_left_out(read):
    good = "2021-06-01 10:00:00.5,VR2W-1,A69-1602-12345,,\n"
    d = read(f"{VUE}\n{good}2021-06-01 10:00:07.5,VR2W-1,A69-1602-12")
    assert d.tags == ("A69-1602-12345",) and d.report.warnings[0].row == 3
    assert len(read(f"{VUE}\n{good}2021-06-01 10:00:07.5,VR2W-1,A69-1602-12345,,")) == 2


def test_ids_damaged_by_excel(read):
    with pytest.raises(InputError, match="lost digits"):
        read("time,receiver,tag\n2021-06-01 10:00:00.5,1,9.72006E+11\n")


def test_what_is_not_a_table(read):
    for data, says in (
        (b"PK\x03\x04\x00rest", "Excel"),
        (b"\x00\x01\x02", "binary"),
        (gzip.compress(b"time,receiver,tag\n")[:-9], "broken gzip"),
        (b"PAR1 but not really", "Parquet"),
        (b"SQLite format 3\x00 nonsense", "SQLite"),
        (b"\xef\xbb\xbf\r\n  \r\n", "empty file"),
        (b"\x81\x8d\x8f time,receiver,tag", "neither UTF-8"),
        (b"VEMCO DATA LOG,2.0.0,vdat\n", "Fathom/VDAT"),
    ):
        with pytest.raises(InputError, match=says):
            read(data)
    with pytest.raises(InputError, match="format 'vemco' is not one of"):
        read(f"{VUE}\n", format="vemco")
    with pytest.raises(InputError, match="does not fit format 'thelma'"):
        read(f"{VUE}\n", format="thelma")
    with pytest.raises(InputError, match="no file"):
        read_detections()


def test_thelma_cross_checks_its_two_clocks(read):
    head = "Date and Time UTC,Unix Timestamp UTC,TBR Serial Number,Millisecond,CodeType,Id,Data\n"
    for row, says in (
        ("2021-06-01 14:00:00,1622548800,1234,5,R64K,345,-", "date and Unix time differ"),
        ("2021-06-01 12:00:00,1622548800,1234,1005,R64K,345,-", "milliseconds"),
        ("2021-06-01 12:00:00,1622548800.5,1234,5,R64K,345,-", "fraction"),
    ):
        with pytest.raises(InputError, match=f"line 2.*{says}"):
            read(head + row + "\n")


def test_several_files_are_joined_and_overlap_counted(tmp_path):
    rows = [f"2021-06-01 10:00:0{i}.5,VR2W-{i % 2},A69-1-1,," for i in range(6)]
    for name, part in (("a.csv", rows[:4]), ("b.csv", rows[2:])):
        (tmp_path / name).write_text("\n".join([VUE, *part]) + "\n")
    d = read_detections(tmp_path / "a.csv", tmp_path / "b.csv")
    assert len(d) == 6 and len(d.report.files) == 2
    assert "2 detections present in more than one file" in str(d.report)


# --- the receivers table ---------------------------------------------------------------------


def test_longitude_and_latitude_are_projected(read):
    from pyproj import Geod

    places = [(-80.5, 25.1), (-80.497, 25.1), (-80.5, 25.1027)]
    text = "Station Name,deploy_lat,deploy_long\n" + "".join(
        f"S{i},{lat},{lon}\n" for i, (lon, lat) in enumerate(places)
    )
    r = read(text, read_receivers)
    assert r.crs == "EPSG:32617" and r.names == ("S0", "S1", "S2")
    for i in (1, 2):
        metres = Geod(ellps="WGS84").inv(*places[0], *places[i])[2]
        assert np.hypot(*(r.xy[i] - r.xy[0])) == pytest.approx(metres, rel=1e-3)
    lon, lat = r.lonlat(r.x, r.y)
    np.testing.assert_allclose(np.column_stack([lon, lat]), places, atol=1e-9)
    south = read("receiver,lon,lat\nA,179.9,-40\nB,-179.95,-40\n", read_receivers)
    assert south.crs in ("EPSG:32701", "EPSG:32760") and np.ptp(south.x) < 20_000
    other = read(text, read_receivers, crs="EPSG:3086")
    assert other.crs == "EPSG:3086" and other.x[0] != r.x[0]
    for crs, says in (
        ("EPSG:4326", "metres"),
        ("EPSG:1", "unknown frame"),
        ("EPSG:2263", "metres"),
    ):
        with pytest.raises(InputError, match=says):
            read(text, read_receivers, crs=crs)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("receiver,x\nA,1\n", "no coordinates"),
        ("x,y\n1,2\n", "names the receiver"),
        ("receiver,x,y\n", "no receivers"),
        ("receiver,x,y\nA,1,2\nA,1,3\n", "line 3: two deployments of receiver A overlap"),
        ("receiver,x,y,start,end\nA,1,2,2021-06-02,2021-06-01 10:00\n", "line 2.*before it starts"),
        ("receiver,x,y\nA,1,2\nB,1e400,3\n", "line 3, column 'x': a number is infinite"),
        ("receiver,x,y\nA,1,2\nB,one,3\n", "line 3, column 'x': 'one' is not a number"),
        ("receiver,lon,lat\nA,8,55\nB,8,95\n", "line 3, column 'lat': 95 is not in degrees"),
        ("receiver,lon,lat\nA,8,55\nB,+0,+0\n", r"B \(lon, lat, line 3\)"),
        ("receiver,x,y,x\nA,1,2,3\n", "column 'x' is there twice"),
        ("receiver;x;y\nA;1.234,5;2\n", "decimal commas and decimal points"),
    ],
)
def test_receivers_table_refusals(read, text, says):
    with pytest.raises(InputError, match=says):
        read(text, read_receivers)


def test_errors_of_the_places(read):
    text = "receiver,x,y,sd\nA,0,0,0.5\nB,90,2,\nC,1,80,0\n"
    r = read(text, read_receivers, position_sd=2.0)
    assert r.position_sd.tolist() == [0.5, 2.0, 0.0]
    assert "sd" not in " ".join(n.text for n in r.report.notes)
    assert r.to_frame()["sd"].to_list() == [0.5, 2.0, 0.0]
    with pytest.raises(InputError, match="line 3, column 'sd'.*missing.*--receiver-sd"):
        read(text, read_receivers)
    with pytest.raises(InputError, match="line 3, column 'sd': .*-1 m is negative"):
        read("receiver,x,y,sd\nA,0,0,0.5\nB,90,2,-1\n", read_receivers)
    bare = "receiver,x,y,sd\nA,0,0,\nB,90,2,\n"
    assert read(bare, read_receivers).position_sd is None
    assert (
        read("receiver,x,y\nA,0,0\nB,9,2\n", read_receivers, position_sd=1.0).position_sd.sum() == 2
    )


def test_receivers_table_remarks(read):
    r = read("receiver,x,y,colour\nA,1,2,red\nA,1,2,red\nB,90,2,red\nC,1,2,red\n", read_receivers)
    text = str(r.report)
    assert len(r) == 3 and "1 duplicated row removed (line 3)" in text
    assert "columns not used: colour" in text
    assert "receivers A and C are at the same place" in text and "collinear" in text
    r = read("receiver,x,y\nA,8.1,55.01\nB,8.2,55.02\nC,8.1,55.05\n", read_receivers)
    assert "degrees?" in str(r.report)


def test_typed_parquet_ids_come_out_as_text(tmp_path):
    df = pl.DataFrame(
        {"receiver": [301001.0, 301002.0], "x": [1, 2], "y": [1.5, None], "sync_tag": [59334, None]}
    )
    df.write_parquet(tmp_path / "r.parquet")
    with pytest.raises(InputError, match="301002"):
        read_receivers(tmp_path / "r.parquet")
    df.with_columns(y=pl.lit(0.0)).write_parquet(tmp_path / "r.parquet")
    r = read_receivers(tmp_path / "r.parquet")
    assert r.names == ("301001", "301002") and r.sync_tag.tolist() == ["59334", ""]
