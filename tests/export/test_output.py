"""Folders appear whole or not at all; tables have the promised columns, order and digits."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from fakes import FakeFit, fake_of, fake_table

from maloc.data import ArrivalTimes, Receivers, SetAside
from maloc.data._mirror import mirror_line, reflect
from maloc.errors import InputError
from maloc.export import output
from maloc.export.folder import output_folder

ORIGIN = 1_600_000_000_000_000_000


def _square(crs=None):
    return Receivers(
        np.array(["a", "b", "c", "d"]),
        np.array([0.0, 100, 100, 0]) + 526000,
        np.array([0.0, 0, 100, 100]) + 2771000,
        crs=crs,
    )


def _toa(receivers, **more):
    first = np.array([0.25, 30.5, 61.123456789, 95.0, 130.0])
    toa = first[:, None] + np.array([0.01, 0.02, 0.03, 0.04])
    toa[1] = np.nan
    toa[3, 2] = np.nan
    row = np.where(np.isfinite(toa), np.arange(20).reshape(5, 4), -1)
    return ArrivalTimes(toa, receivers, np.full(5, 1500.0), "T-1", ORIGIN, detection=row, **more)


# -- folders ---------------------------------------------------------------------------------------


def test_folder_appears_whole_with_its_parents(tmp_path: Path):
    out = tmp_path / "runs" / "today" / "one"
    with output_folder(out) as work:
        assert not out.exists() and work.parent == out.parent
        (work / "summary.json").write_text("{}")
    assert [p.name for p in out.iterdir()] == ["summary.json"]
    assert [p.name for p in out.parent.iterdir()] == ["one"]
    assert out.stat().st_mode & 0o055  # not the private mode of temporary folders


def test_a_failure_leaves_nothing_behind(tmp_path: Path):
    with pytest.raises(RuntimeError), output_folder(tmp_path / "runs" / "one") as work:
        (work / "track.csv").write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said_in_one_line(tmp_path: Path):
    with pytest.raises(InputError, match="No space left"), output_folder(tmp_path / "one"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_taken_places_are_refused_or_replaced_by_force(tmp_path: Path):
    out = tmp_path / "one"
    for text in ("first", "second"):
        with output_folder(out, force=text == "second") as work:
            (work / "summary.json").write_text(text)
            (work / f"{text}.txt").write_text("")
    assert sorted(p.name for p in out.iterdir()) == ["second.txt", "summary.json"]
    with pytest.raises(InputError, match="--force"), output_folder(out):
        pass
    with pytest.raises(KeyError), output_folder(out, force=True):
        raise KeyError
    assert (out / "summary.json").read_text() == "second"
    assert [p.name for p in tmp_path.iterdir()] == ["one"]


def test_force_spares_what_maloc_did_not_write(tmp_path: Path):
    home, file, link = tmp_path / "home", tmp_path / "file", tmp_path / "link"
    home.mkdir()
    (home / "thesis.tex").write_text("years of work")
    file.write_text("")
    link.symlink_to(home)
    for taken in (home, file, link):
        with pytest.raises(InputError), output_folder(taken, force=True):
            pass
    assert (home / "thesis.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="file"), output_folder(file / "below"):
        pass


# -- tables ----------------------------------------------------------------------------------------


def test_track_csv_header_and_digits(tmp_path: Path):
    receivers = _square("EPSG:32617")
    toa = _toa(receivers)
    table = output.finish_track(fake_table(None, toa), receivers, None)
    output.write_table(table, tmp_path / "track.csv")
    head, first, *rest = (tmp_path / "track.csv").read_text().splitlines()
    assert head == (
        "tag,time,t,x,y,sd_x,sd_y,cov_xy,x_lo,x_hi,y_lo,y_hi,n_receivers,heard,longitude,latitude"
    )
    cells = first.split(",")
    assert cells[:5] == ["T-1", "2020-09-13T12:26:40.260000Z", "0.26", "40.333", "0.0"]
    assert cells[12:14] == ["4", "true"]
    assert len(rest) == 4 and rest[0].split(",")[13] == "false"


def test_times_are_written_as_iso_to_the_microsecond(tmp_path: Path):
    when = pl.Series([1_600_000_000_123_456_789]).cast(pl.Datetime("ns", "UTC"))
    output.write_table(pl.DataFrame({"time": when, "t": [np.nan]}), tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "time,t\n2020-09-13T12:26:40.123456Z,\n"


def test_longitude_and_latitude_come_from_the_frame():
    receivers = _square("EPSG:32617")
    table = fake_table(None, _toa(receivers)).with_columns(
        pl.lit(500000.0).alias("x"), pl.lit(0.0).alias("y")
    )
    out = output.finish_track(table, receivers, None)
    # 500 km east on the equator is the central meridian of zone 17
    np.testing.assert_allclose(out["longitude"], -81.0, atol=1e-9)
    np.testing.assert_allclose(out["latitude"], 0.0, atol=1e-9)


def test_arrivals_have_every_detection_once():
    aside = SetAside(
        np.array(["b", "zz"]), np.array([3.0, 9.0]), np.array([40, 41]), np.array(["echo", "lost"])
    )
    toa = _toa(_square(), set_aside=aside)
    fit = fake_of(toa)
    fit._residual = np.where(np.isfinite(fit._residual), np.arange(16.0).reshape(4, 4), np.nan)
    table = output.arrivals_table(fit, toa)
    assert tuple(table.columns[:6]) == ("ping", "receiver", "residual", "p_direct", "used", "why")
    assert sorted(table["detection"]) == [*range(4), *range(8, 14), *range(15, 20), 40, 41]
    # ping 2 was heard by nobody: row 3 of the matrix is row 2 of the fit's arrays
    row = table.filter((pl.col("ping") == 3) & (pl.col("receiver") == "b"))
    assert row["residual"].item() == 5.0 and row["detection"].item() == 9
    assert row["t"].item() == pytest.approx(1_600_000_061.143456789, abs=1e-6)
    assert table["used"].sum() == toa.heard.sum()
    assert table.filter(~pl.col("used"))["why"].to_list() == ["echo", "lost"]
    assert table.filter(~pl.col("used"))["ping"].null_count() == 2
    assert table["why"][0].startswith("late")


def test_parameters_of_laplace_have_blank_sampler_columns(tmp_path: Path):
    output.write_table(output.parameters_table(FakeFit(), "T-1"), tmp_path / "p.csv")
    head, row, _ = (tmp_path / "p.csv").read_text().splitlines()
    assert head == "name,mean,sd,2.5 %,97.5 %,ess_bulk,ess_tail,r_hat,unit,tag"
    assert row.startswith("sigma,") and row.endswith(",,,,m,T-1")
    sampled = output.parameters_table(FakeFit(method="nuts"), "")
    assert sampled["r_hat"].to_list() == [1.001, 1.001]


def test_json_is_plain(tmp_path: Path):
    content = {"a": np.float64(np.nan), "b": np.arange(3), "c": Path("x"), "d": (True, None, 1.5)}
    output.write_json(content, tmp_path / "s.json")
    read = json.loads((tmp_path / "s.json").read_text())
    assert read == {"a": None, "b": [0, 1, 2], "c": "x", "d": [True, None, 1.5]}


# -- mirror ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2, 2.5])
def test_mirror_images_have_the_same_distances(angle):
    along = np.array([0.0, 80, 190, 300])
    direction = np.array([np.cos(angle), np.sin(angle)])
    xy = np.array([500.0, -300.0]) + along[:, None] * direction
    receivers = Receivers(np.array(list("abcd")), *xy.T)
    line = mirror_line(receivers)
    assert line is not None
    points = np.array([[520.0, -250.0], [430.0, -310.0]])
    image = reflect(points, line)
    distance = np.linalg.norm(points[:, None] - xy, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(image[:, None] - xy, axis=-1), distance, rtol=1e-12)
    assert np.linalg.norm(image - points, axis=1).min() > 10


def test_only_receivers_that_heard_the_tag_make_a_mirror():
    receivers = _square()
    assert mirror_line(receivers) is None
    assert mirror_line(receivers, np.array([True, True, False, False])) is not None
    assert mirror_line(receivers, np.array([True, False, False, False])) is None
