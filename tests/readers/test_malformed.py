"""Malformed tables thrown at the readers: an InputError or the right answer, nothing else."""

import gzip

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maloc.data import Receivers
from maloc.errors import InputError
from maloc.readers import (
    read_detections,
    read_events,
    read_positions,
    read_receivers,
    read_tags,
    read_toa,
)
from maloc.readers.check import check

NS = 1_000_000_000
R = Receivers(
    np.array(["301001", "301002", "S18-2"]), np.array([0.0, 300, 0]), np.array([0.0, 0, 400])
)

HEADERS = [
    "Date and Time (UTC),Receiver,Transmitter,Transmitter Name,Transmitter Serial,Sensor Value,"
    "Sensor Unit,Station Name,Latitude,Longitude",
    "Date and Time (Local),Receiver,Transmitter",
    "time,receiver,tag",
    "tag,epo,frac,serial",
    "timestamp,detect_id,type",
    "Date and Time UTC,Unix Timestamp UTC,TBR Serial Number,Millisecond,CodeType,Id,Data",
    "Date and Time (UTC),Unix Timestamp (UTC),ID,Data,Protocol,SNR,Receiver",
    "receiver,x,y,depth,sync_tag,start,end",
    "receiver;longitude;latitude",
    "ping,301001,301002,S18-2,ss",
    "Date and Time (UTC),Receiver,Description,Data,Units",
    "Device Time (UTC),Time,Time Offset (h),Time Correction (s),Serial Number,Full ID",
    "dateCollectedUTC,receiver,tagName,station,unqDetecID",
    "DETECTEDID,DATETIME,X,Y,HPE,LAT,LON",
    "TAG,TIME,X,Y,NBS,VARX,VARY",
    "timestamp,location-long,location-lat,visible",
    "tag,animal,sensor,slope,min_delay,max_delay,start",
    "WHS4K-1,45391.95142361,0.43875,37910,9416,12",
    "Name,Latitude,Longitude,Device,Device Depth",
    "INS_SERIAL_NO,DEPLOY_LAT,DEPLOY_LONG,RECOVER_LAT,RECOVER_LONG",
    "VEMCO DATA LOG,2.0.0,x",
    "VEMCO DATA LOG,2.0.0,x\nDET_DESC,Device Time (UTC),Time,Serial Number,Full ID\n"
    "CLOCK_REF_DESC,Device Time (UTC),Serial Number,External Difference (s),Source",
    "Serial Number: WHS3K-1\nGMT Correction: 00:00\nDecoded Tag Data:",
    "",
    "a,b",
]
CELLS = st.one_of(
    st.sampled_from(
        ["", "NA", "NaN", "-", "+0", "0", "1", "-1", "1e9", "inf", "1.5", "1,5", "301001", '"', "'",
         "2021-06-01 10:00:00.217", "2021-06-01 10:00:00", "2021-06-01T25:00:00Z", "2021-02-30",
         "1622548800", "1622548800.5", "99999999999999999999", "VR2W-301001", "A69-1602-12345", ";",
         "Date and Time (UTC)", "time", "R64K", "\ufeff", "\x00", "\r", "9.7E+11",
         "2021-06-01 10:00", "DET", "CLOCK_REF", "UTC", "release", "INITIALIZATION",
         "04/19/24  22:50:03     0.43875        37910       P       9.1        12"]
    ),
    st.text(max_size=8),
    st.floats().map(repr),
)  # fmt: skip
TABLES = st.tuples(
    st.sampled_from(HEADERS),
    st.lists(st.lists(CELLS, max_size=11), max_size=6),
    st.sampled_from([",", ";", "\t"]),
    st.sampled_from(["\n", "\r\n", "\r\r\n"]),
    st.booleans(),
)


def text_of(table):
    header, rows, delimiter, end, ended = table
    lines = [header.replace(",", delimiter), *(delimiter.join(r) for r in rows)]
    return (end.join(lines) + end * ended).encode("utf-8", "surrogatepass")


def attempt(work):
    try:
        return work()
    except InputError as e:
        assert "\n" not in str(e) and str(e).strip()
        return None


@given(TABLES, st.booleans(), st.sampled_from([None, "UTC", "Europe/Copenhagen"]))
def test_any_table_is_read_or_refused(tmp_path_factory, table, zipped, tz):
    path = tmp_path_factory.getbasetemp() / "malformed.csv"
    data = text_of(table)
    path.write_bytes(gzip.compress(data) if zipped else data)
    d = attempt(lambda: read_detections(path, tz=tz))
    rows = len(table[1]) + text_of(table).count(b"\n") + 1
    if d is not None:
        assert len(d) <= rows
        assert ((d.time >= 0) & (d.time < 7_300_000_000 * NS)).all()
        assert (d.receiver != "").all() and (d.tag != "").all()
    r = attempt(lambda: read_receivers(path))
    if r is not None:
        assert len(r) <= rows and np.isfinite(r.xy).all()
    a = attempt(lambda: read_toa(path, R, ignore_columns=("a", "b")))
    if a is not None:
        assert a.n_pings <= len(table[1]) and (a.sound_speed > 0).all()
    if (p := attempt(lambda: read_positions(path, tz=tz))) is not None:
        assert len(p) <= rows and np.isfinite(p.time).all()
    if (tags := attempt(lambda: read_tags(path))) is not None:
        assert len(tags) <= rows and (tags.tag != "").all()
    if (events := attempt(lambda: read_events(path, tz=tz))) is not None:
        assert np.isfinite(events.references.behind).all()
    str(check([path]))


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "bytes.csv"
    for head in (
        b"",
        b"\x1f\x8b",
        b"PAR1",
        b"SQLite format 3\x00",
        b"time,receiver,tag\n",
        b"PK\x03\x04",
        b"VEMCO DATA LOG,",
        b"Decoded Tag Data:",
    ):
        path.write_bytes(head + data)
        attempt(lambda: read_detections(path))
        attempt(lambda: read_receivers(path))


names = st.text("ABCabc019_-. ", min_size=1, max_size=10).map(str.strip).filter(
    lambda s: s and s.upper() not in ("NA", "NAN", "N/A", "NAT", "NULL", "NONE")
    and not s.replace("E", "").replace("e", "").replace("+", "").replace(".", "").isdigit()
)  # fmt: skip
instants = st.integers(0, 7_258_118_399 * NS + 999_999_999)


PADS = st.lists(st.sampled_from(["", " ", "  "]), min_size=6, max_size=6)


def stamp(ns):
    return str(np.datetime64(ns // NS, "s")) + f".{ns % NS:09d}"


@given(st.lists(st.tuples(instants, names, names), min_size=1, max_size=20, unique=True))
def test_written_tables_come_back_exactly(tmp_path_factory, rows):
    """ISO stamps, Unix seconds and fractions, a plain epoch and Parquet: one answer, to the ns."""
    folder = tmp_path_factory.getbasetemp()
    (folder / "iso.csv").write_text(
        "time,receiver,tag\n" + "".join(f"{stamp(t)}Z,{r},{g}\n" for t, r, g in rows)
    )
    (folder / "epo.csv").write_text(
        "epo,frac,receiver,tag\n"
        + "".join(f"{t // NS},0.{t % NS:09d},{r},{g}\n" for t, r, g in rows)
    )
    (folder / "vue.csv").write_text(
        "\ufeffDate and Time (UTC),Receiver,Transmitter\r\n"
        + "".join(f"{stamp(t)},VR2W-x{i},{g}\r\n" for i, (t, _, g) in enumerate(rows))
    )  # fmt: skip
    pl.DataFrame({"time": [t for t, _, _ in rows], "receiver": [r for _, r, _ in rows],
                  "tag": [g for _, _, g in rows]}).with_columns(
        pl.col("time").cast(pl.Datetime("ns", "UTC"))
    ).write_parquet(folder / "typed.parquet")  # fmt: skip
    for name in ("iso.csv", "epo.csv", "vue.csv", "typed.parquet"):
        d = read_detections(folder / name)
        assert d.time.tolist() == [t for t, _, _ in rows]
        assert d.tag.tolist() == [g for _, _, g in rows]
        if name != "vue.csv":
            assert d.receiver.tolist() == [r for _, r, _ in rows]


@given(st.permutations(range(6)), PADS)
def test_order_and_padding_of_columns_do_not_matter(tmp_path_factory, order, pad):
    header = ["serial", "x", "y", "z", "sync_tag", "start_utc"]
    row = ["301001", "12.5", "-7.25", "3", "59334", "2021-06-01 10:00"]
    path = tmp_path_factory.getbasetemp() / "order.csv"
    lines = [",".join(f"{pad[i]}{v[i]}{pad[i]}" for i in order) for v in (header, row)]
    path.write_text("\n".join(lines) + "\n")
    r = read_receivers(path)
    assert (r.names, r.xy.tolist(), r.depth.tolist()) == (("301001",), [[12.5, -7.25]], [3.0])
    assert r.sync_tag.tolist() == ["59334"]
    assert r.start[0] == np.datetime64("2021-06-01T10:00", "ns").astype(np.int64)


@given(st.data())
def test_one_damaged_cell_is_never_read_as_another_number(tmp_path_factory, data):
    """Damage one time: the reader refuses, leaves the row out, or reads what is written there."""
    good = [f"2021-06-01 10:00:0{i}.{217 + i}" for i in range(4)]
    which = data.draw(st.integers(0, 3))
    where = data.draw(st.integers(0, len(good[0]) - 1))
    letter = data.draw(st.sampled_from("0123456789:-. TZx,"))
    hurt = good[which][:where] + letter + good[which][where + 1 :]
    stamps = [hurt if i == which else g for i, g in enumerate(good)]
    path = tmp_path_factory.getbasetemp() / "hurt.csv"
    path.write_text("time,receiver,tag\n" + "".join(f"{s},A,B-{i}\n" for i, s in enumerate(stamps)))
    d = attempt(lambda: read_detections(path))
    if d is None:
        return
    assert len(d) == 4
    for i in range(4):
        expected = np.datetime64(stamps[i].strip().replace("Z", ""), "ns").astype(np.int64)
        assert d.time[i] == expected


@pytest.mark.parametrize("bad", ["", "NaN", "NA", "x", "inf", "-inf", "1e400"])
@pytest.mark.parametrize("column", ["x", "y"])
def test_a_coordinate_is_never_made_up(tmp_path, bad, column):
    row = {"x": "1.5", "y": "2.5"} | {column: bad}
    path = tmp_path / "r.csv"
    path.write_text(f"receiver,x,y\nA,0,0\nB,{row['x']},{row['y']}\n")
    with pytest.raises(InputError, match=f"line 3, column '{column}'"):
        read_receivers(path)
