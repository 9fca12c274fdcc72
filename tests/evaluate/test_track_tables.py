"""Tables of YAPS, a VPS, kaltoa and a GPS scored as they come, beside the same in our words."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

import maloc
from maloc.errors import InputError
from maloc.evaluate import evaluate
from maloc.evaluate.tables import as_track

START = 1_622_541_600  # 2021-06-01 10:00:00 UTC
SECOND = np.array([0.0, 30.25, 61.5, 90.0])
X, Y = np.array([3.0, 5.0, 8.0, 9.0]), np.array([1.0, 0.0, -2.0, 4.0])
SD = np.array([0.5, 0.7, 1.0, 2.0])
OFF = np.array([1.0, 1.5, 2.0, 0.5])  # m east, and twice as much south
TRUTH = pl.DataFrame({"t": SECOND, "x": X + OFF, "y": Y - 2 * OFF})
OURS = pl.DataFrame({"t": SECOND, "x": X, "y": Y, "sd_x": SD, "sd_y": 2 * SD, "cov_xy": 0 * SD})
VPS = """TRANSMITTER,DETECTEDID,DATETIME,X,Y,D,LAT,LON,n,HPE,HPEm,TEMP,DEPTH,ACCEL,DRX,URX
103,A69-1105-103,2021-06-01 10:00:00,3.0,1.0,1.364,51.1,5.11,3,6.5,,,1.36,,S12 S14,S12 S14
103,A69-1105-103,2021-06-01 10:00:31,5.0,0.0,2.122,51.1,5.11,4,4.5,2.1,,2.12,,S12 S13,S12 S13
"""


def dated(table):
    whole = ((START + table["t"].to_numpy()) * 1e9).astype(np.int64)
    return table.drop("t").with_columns(pl.Series("time", whole.astype("datetime64[ns]")))


@pytest.mark.parametrize("origin", [0.0, float(START)])
def test_yaps_in_local_seconds_and_since_1970(origin):
    yaps = pl.DataFrame(
        {"top": SECOND + origin, "x": X, "y": Y, "x_sd": SD, "y_sd": 2 * SD, "nobs": [3] * 4}
    )
    truth = TRUTH if origin == 0 else dated(TRUTH)
    found, want = evaluate(yaps, truth), evaluate(OURS, TRUTH)
    assert found.scores == pytest.approx(want.scores)
    assert found.scores["n"] == 4 and found.scores["mean"] == pytest.approx(1.25 * np.sqrt(5))
    gps = pl.DataFrame({"utm_x": X + OFF, "utm_y": Y - 2 * OFF, "epo": SECOND + origin})
    assert evaluate(yaps.rename({"top": "epo"}), gps).scores == pytest.approx(want.scores)


def test_a_vps_file_and_positions(tmp_path):
    file = tmp_path / "TRANSMITTER-103-CALC-POSITIONS.csv"
    file.write_text(VPS)
    found = evaluate(file, dated(TRUTH)).scores
    assert found["n"] == 2 and "coverage" not in found
    assert found["mean"] == pytest.approx(1.25 * np.sqrt(5))  # of the rows at 0 and 30.25 s
    assert evaluate(maloc.read_positions(file), dated(TRUTH)).scores == pytest.approx(
        found, nan_ok=True
    )
    file.write_text(VPS + VPS.splitlines()[1].replace("-103,", "-104,") + "\n")
    for source in (file, maloc.read_positions(file)):
        with pytest.raises(InputError, match="the track is of 2 tags"):
            evaluate(source, dated(TRUTH))


def test_kaltoa_by_words_for_the_same():
    variance = {"var_x": SD**2, "var_y": 4 * SD**2, "cov_xy": 0 * SD}
    ms = np.array([0, 250, 500, 0])
    apart = pl.DataFrame(
        {"second": (START + SECOND).astype(int), "millisecond": ms, "x": X, "y": Y, **variance}
    )
    text = pl.DataFrame(
        {"timestamp": [f"2021-06-01T10:{m}Z" for m in ("00:00", "00:30.25", "01:01.5", "01:30")],
         "X": X, "Y": Y, "x_var": SD**2, "y_var": 4 * SD**2}
    )  # fmt: skip
    relative = pl.DataFrame({"time": SECOND, "x": X, "y": Y, **variance})
    want = evaluate(OURS, TRUTH).scores
    assert evaluate(apart, dated(TRUTH)).scores == pytest.approx(want)
    assert evaluate(text, dated(TRUTH)).scores == pytest.approx(want)
    assert evaluate(relative, TRUTH).scores == pytest.approx(want)


def test_nothing_is_lost_of_our_own_and_twice_is_once():
    own = OURS.with_columns(x_lo=pl.lit(0.0), time=pl.Series([None] * 4, dtype=pl.String))
    found = as_track(own, "track")
    assert set(found.columns) == {"t", "x", "y", "sd_x", "sd_y", "cov_xy", "x_lo"}
    assert as_track(found, "track").equals(found)


def test_what_cannot_be_compared(tmp_path):
    with pytest.raises(InputError, match="the truth has dates, the other table seconds"):
        evaluate(OURS, dated(TRUTH))
    with pytest.raises(InputError, match="has no column 'time' or 't'"):
        evaluate(OURS.drop("t"), TRUTH)
    degrees = pl.DataFrame({"t": SECOND, "lon": X, "lat": Y})
    with pytest.raises(InputError, match="no column 'x'") as said:
        evaluate(degrees, TRUTH)
    assert "read_positions" in str(said.value)
    with pytest.raises(InputError, match="'Date/Time' holds 'yesterday'"):
        evaluate(pl.DataFrame({"Date/Time": ["yesterday"], "x": [1.0], "y": [1.0]}), TRUTH)
    with pytest.raises(InputError, match="does not exist"):
        evaluate(tmp_path / "nowhere.csv", TRUTH)


def test_yaps_on_the_real_track(shared_dir):
    """The numbers that the data's README gives, by its own interpolation between GPS fixes."""
    folder = shared_dir / "data" / "ssu1"
    track, gps = pl.read_csv(folder / "peer_yaps_track.csv"), pl.read_csv(folder / "gps.csv")
    inside = track.filter(pl.col("epo").is_between(gps["epo"].min(), gps["epo"].max()))
    for rows, n, mean, median, p95 in (
        (inside, 142, 3.70, 3.51, 7.14),
        (inside.filter(pl.col("nobs") > 0), 119, 3.67, 3.51, 6.67),
        (inside.filter(pl.col("nobs") == 0), 23, 3.84, 3.51, 9.47),
    ):
        found = evaluate(rows, folder / "gps.csv", within=60.0).scores
        assert found["n"] == n
        assert found["mean"] == pytest.approx(mean, abs=0.006)
        assert found["median"] == pytest.approx(median, abs=0.006)
        assert found["p95"] == pytest.approx(p95, abs=0.06)
