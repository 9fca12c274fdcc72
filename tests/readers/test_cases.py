"""The small hard inputs of ../shared/cases: each one's right value, warning or refusal."""

import csv

import numpy as np
import pytest

from maloc.data import toa_matrix
from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers, read_toa
from maloc.readers.check import check

FISH = "A69-1602-12345"
C = 1475.0
NS = 1_000_000_000


def truth(path):
    with open(path) as f:
        rows = list(csv.DictReader(f))
    xy = np.array([[float(r["x"]), float(r["y"])] for r in rows])
    return np.array([r["emission_utc"] for r in rows], "datetime64[ns]").astype(np.int64), xy


def assert_matches_geometry(toa, path, within=0.001):
    """Each arrival = emission + distance / c, to the millisecond that the files are rounded to."""
    emission, xy = truth(path)
    assert toa.n_pings == len(xy)
    r = toa.receivers.xy
    distance = np.hypot(xy[:, None, 0] - r[None, :, 0], xy[:, None, 1] - r[None, :, 1])
    expected = (emission - toa.origin)[:, None] / NS + distance / C
    off = np.abs(toa.toa - expected)[toa.heard]
    assert off.max() <= within


def test_01_bom_crlf_ragged(case):
    d = read_detections(case("01") / "vue.csv")
    assert len(d) == 30 and d.tags == (FISH,)
    assert d.receivers == tuple(str(301001 + i) for i in range(6))
    assert d.time[0] == np.datetime64("2021-06-01T10:00:00.217", "ns").astype(np.int64)
    assert "latitude" not in d.extra and "longitude" not in d.extra
    assert set(d.extra["model"]) == {"VR2W"}
    toa = toa_matrix(d, read_receivers(case("01") / "receivers.csv"), FISH, sound_speed=C)
    assert toa.n_heard.tolist() == [6] * 5 and len(toa.set_aside) == 0
    assert_matches_geometry(toa, case("01") / "truth.csv")


def test_02_pasted_exports(case):
    d = read_detections(case("02") / "vue.csv")
    assert len(d) == 30 and d.tags == (FISH,)
    said = [n.text for n in d.report.notes]
    assert "1 repeated header line skipped (line 22)" in said
    assert "6 exact duplicates removed" in said
    toa = toa_matrix(d, read_receivers(case("02") / "receivers.csv"), FISH, sound_speed=C)
    assert_matches_geometry(toa, case("02") / "truth.csv")


def test_03_semicolons_and_decimal_commas(case):
    d = read_detections(case("03") / "vue_eu.csv")
    assert len(d) == 30
    assert d.time[0] == np.datetime64("2021-06-01T10:00:00.217", "ns").astype(np.int64)
    assert set(d.extra["sensor"]) == {12.5}
    assert set(d.extra["latitude"]) == {55.12345} and set(d.extra["longitude"]) == {8.54321}
    assert set(d.extra["station"]) == {f"Sø {i}" for i in range(1, 7)}
    r = read_receivers(case("03") / "receivers_eu.csv")
    assert r.x.tolist() == [0.0, 210.0, 395.0, 380.0, 190.0, -15.0]
    toa = toa_matrix(d, r, FISH, sound_speed=C)
    assert_matches_geometry(toa, case("03") / "truth.csv")


@pytest.mark.parametrize(
    "name",
    ["vue.csv", "thelma_old.csv", "thelma_new.csv", "yaps_ok.csv", "yaps_double.csv", "kaltoa.csv",
     "atlas.sqlite"],
)  # fmt: skip
def test_04_seven_encodings_of_six_instants(case, name):
    d = read_detections(case("04") / name, tz="UTC" if name == "kaltoa.csv" else None)
    micro = [0, 60500000, 120050000, 180005000, 240120000, 300999000]
    assert (d.time - 1622548800 * NS).tolist() == [1000 * m for m in micro]
    if name == "atlas.sqlite":
        assert d.tags == ("972006000345",)
    if name.startswith("thelma"):
        assert d.tags == ("R64K-345",) and "sensor" not in d.extra


def test_04_kaltoa_asks_for_the_zone(case):
    with pytest.raises(InputError, match="tz="):
        read_detections(case("04") / "kaltoa.csv")
    d = read_detections(case("04") / "kaltoa.csv", tz="CET")
    assert d.time[0] == (1622548800 - 7200) * NS


def test_05_local_time(case):
    autumn, spring = (case("05") / f"{s}_local.csv" for s in ("autumn", "spring"))
    for f in (autumn, spring):
        with pytest.raises(InputError, match="local time.*tz="):
            read_detections(f)
    with pytest.raises(InputError, match="ambiguous local time.*lines: 4, 5, 6, 7, 8, 9"):
        read_detections(autumn, tz="Europe/Copenhagen")
    with pytest.raises(InputError, match="line 3.*does not exist"):
        read_detections(spring, tz="Europe/Copenhagen")
    fixed = read_detections(spring, tz="Etc/GMT-1")
    utc = np.datetime64("2021-03-28T00:59:30", "ns").astype(np.int64)
    assert (fixed.time - utc).tolist() == [0, 1830 * NS, 3660 * NS]
    with pytest.raises(InputError, match="unknown time zone"):
        read_detections(spring, tz="Atlantis/Capital")


def test_06_unsynchronised_clocks_are_refused(case):
    d, r = read_detections(case("06") / "vue.csv"), read_receivers(case("06") / "receivers.csv")
    for tag in d.tags:
        with pytest.raises(InputError, match="clocks look unsynchronised.*sync"):
            toa_matrix(d, r, tag, sound_speed=C)


def test_07_code_spaces_stay_apart(case):
    d, r = read_detections(case("07") / "vue.csv"), read_receivers(case("07") / "receivers.csv")
    for tag in ("A69-1601-12345", "A69-9001-12345"):
        toa = toa_matrix(d, r, tag, sound_speed=C)
        assert int(toa.heard.sum()) == 30
        assert_matches_geometry(toa, case("07") / f"truth_{tag}.csv")
    with pytest.raises(InputError, match="ambiguous, 2 transmitters: A69-1601-12345, A69-9001"):
        toa_matrix(d, r, 12345, sound_speed=C)


def test_08_receiver_table_problems(case):
    d = read_detections(case("08") / "vue.csv")
    toa = toa_matrix(d, read_receivers(case("08") / "receivers.csv"), FISH, sound_speed=C)
    assert toa.set_aside.receiver.tolist() == ["309999"] * 5
    warning = next(n for n in toa.report.warnings if "309999" in n.text)
    assert warning.count == 5
    assert toa.receivers.names[-1] == "301007" and not toa.heard[:, -1].any()
    assert any("301007" in n.text for n in toa.report.notes)
    assert_matches_geometry(toa, case("08") / "truth.csv")
    with pytest.raises(InputError, match=r"301004 \(x.*301005 \(y"):
        read_receivers(case("08") / "receivers_nan.csv")


def test_08_columns_are_matched_by_name(case):
    r = read_receivers(case("08") / "receivers_reordered.csv")
    toa = read_toa(case("08") / "toa_wide.csv", r, sound_speed=C)
    assert toa.receivers.names == ("301005", "301001", "301006", "301003", "301002", "301004")
    assert toa.toa[0].tolist() == [0.265, 0.239, 0.279, 0.338, 0.217, 0.341]
    start = np.datetime64("2021-06-01T10:00:00", "ns").astype(np.int64)
    assert toa.origin is None
    assert_matches_geometry(toa.replace(origin=int(start)), case("08") / "truth.csv")


def test_09_moved_receiver_has_two_columns(case):
    d = read_detections(case("09") / "vue.csv")
    toa = toa_matrix(d, read_receivers(case("09") / "deployments.csv"), FISH, sound_speed=C)
    assert int(toa.heard.sum()) == 60 and toa.n_pings == 10
    assert set(toa.set_aside.why) == {"outside any deployment of 301005"}
    assert len(toa.set_aside) == 4
    for rows, name in ((slice(0, 5), "truth_1.csv"), (slice(5, 10), "truth_2.csv")):
        part = toa.replace(toa=toa.toa[rows], sound_speed=C, ping=toa.ping[rows], detection=None)
        assert_matches_geometry(part, case("09") / name)


def test_10_echoes(case):
    d = read_detections(case("10") / "vue.csv")
    toa = toa_matrix(d, read_receivers(case("10") / "receivers.csv"), FISH, sound_speed=C)
    with open(case("10") / "truth_labels.csv") as f:
        label = {(r["time_utc"], r["serial"]): r["path"] for r in csv.DictReader(f)}
    assert toa.detection is not None
    kept = toa.detection[toa.heard]
    assert len(kept) == 30 and toa.n_heard.tolist() == [6] * 5
    key = [
        (str(np.datetime64(int(d.time[i]), "ns").astype("datetime64[ms]")).replace("T", " "),
         str(d.receiver[i]))
        for i in kept
    ]  # fmt: skip
    assert sum(label[k] == "direct" for k in key) == 29
    assert all(w.startswith("echo, ") for w in toa.set_aside.why)


def test_11_long_gaps_stay_gaps(case):
    d = read_detections(case("11") / "vue.csv")
    toa = toa_matrix(d, read_receivers(case("11") / "receivers.csv"), FISH, sound_speed=C)
    assert toa.n_pings == 16 and (toa.n_heard == 6).all()


def test_13_collinear_receivers_are_flagged(case):
    d, r = read_detections(case("13") / "vue.csv"), read_receivers(case("13") / "receivers.csv")
    assert any("collinear" in n.text for n in r.report.warnings)
    toa = toa_matrix(d, r, FISH, sound_speed=C)
    assert any("collinear" in n.text for n in toa.report.warnings)
    assert_matches_geometry(toa, case("13") / "truth.csv")


def test_14_nothing_or_not_what_it_should_be(case):
    f = case("14")
    for name, says in (
        ("empty.csv", "empty file"),
        ("unknown.csv", "def, ghi.*formats known: VUE"),
        ("receiver.vrl", "binary VRL, export to CSV with Fathom/VUE first"),
        ("events.csv", "receiver events"),
        ("absent.csv", "no such file"),
    ):
        with pytest.raises(InputError, match=says):
            read_detections(f / name)
    r = read_receivers(case("01") / "receivers.csv")
    header = read_detections(f / "header_only.csv")
    assert len(header) == 0 and len(header.report.warnings) == 1
    with pytest.raises(InputError, match="no detections"):
        toa_matrix(header, r, FISH)
    one = read_detections(f / "one_row.csv")
    assert len(one) == 1
    with pytest.raises(InputError, match="1 receiver"):
        toa_matrix(one, r, FISH)
    cut = read_detections(f / "truncated.csv")
    assert len(cut) == 1 and cut.report.warnings[0].row == 3


def test_check_takes_a_zone_and_a_clock(case):
    spring = case("05") / "spring_local.csv"
    assert "does not exist in Europe/Copenhagen" in str(check(spring, tz="Europe/Copenhagen"))
    assert check(spring, tz="Etc/GMT-1").ok
    raw = sorted(case("12").glob("uncorrected_*"))
    text = str(check([*raw, case("12") / "receivers.csv"], clock="linear"))
    assert "24 detections corrected along lines" in text and "no problems" in text
    assert not check(raw, clock="corrected").ok
    assert "does not fit format 'otn'" in str(check(case("01") / "vue.csv", format="otn"))


def test_check_says_what_each_case_is(case):
    def said(*files):
        return str(check([case(n) / f for n, f in files]))

    assert "no problems" in said(("01", "vue.csv"), ("01", "receivers.csv"))
    assert "1 repeated header line skipped (line 22)" in said(("02", "vue.csv"))
    text = said(("08", "vue.csv"), ("08", "receivers.csv"))
    assert "309999 (5 detections) is not in the receivers table" in text and "301007" in text
    nan = check(case("08") / "receivers_nan.csv")
    assert not nan.ok and "301004 (x" in nan.errors[0].text and "301005 (y" in nan.errors[0].text
    assert "4 detections of 301005 are outside" in said(
        ("09", "vue.csv"), ("09", "deployments.csv")
    )
    assert "unsynchronised" in said(("06", "vue.csv"), ("06", "receivers.csv"))
    assert "2 transmitters: A69-1601-12345, A69-9001-12345" in said(("07", "vue.csv"))
    assert "17 second detections" in said(("10", "vue.csv"))
    assert "collinear" in said(("13", "receivers.csv"))
    assert "receiver events" in said(("14", "events.csv"))
    assert "1 receiver (301001)" in said(("14", "one_row.csv"))
    assert "(line 3)" in said(("14", "truncated.csv"))
    assert "TOA matrix" in said(("08", "toa_wide.csv"))
    assert "counted once" in said(("04", "yaps_double.csv"))
    assert "column 'timestamp' is local time" in said(("04", "kaltoa.csv"))
    for name in ("autumn_local.csv", "spring_local.csv"):
        assert "is local time; say its zone" in said(("05", name))
    logs = [("12", f"VR2Tx_48010{i}_20210602_1.csv") for i in range(1, 5)]
    raw = [("12", f"uncorrected_VR2Tx_48010{i}.csv") for i in range(1, 5)]
    text = said(*logs, ("12", "receivers.csv"))
    assert "Fathom/VDAT CSV 2.0.0" in text and "no problems" in text
    assert "corrected times, +1.2 to +2.2 s" in text and "CLOCK_REF (2), TEMP (6)" in text
    text = said(*raw, ("12", "receivers.csv"))
    assert text.count("device times, no clock correction was applied") == 4
    assert "clock of 480103 to be corrected by -3 s" in text and "unsynchronised" in text
    assert "corrected times in some files" in said(logs[0], *raw[1:])
    everything = check(sorted(case("14").glob("*.*")))
    assert len(everything.files) == 8 and not everything.ok
