"""Small hard inputs (shared/cases 08, 10, 13): each ping's own position against the truth."""

from __future__ import annotations

import json

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

import maloc
from maloc.cli import app
from maloc.errors import InputError
from maloc.points import locate

METHODS = ["consensus", "cluster", "closed-form"]
SPEED = 1475.0  # m/s, from the true positions and emissions; points cannot estimate it


def read(case, receivers="receivers.csv", speed=SPEED):
    table = maloc.read_receivers(case / receivers)
    detections = maloc.read_detections(case / "vue.csv")
    toa = maloc.toa_matrix(detections, table, "A69-1602-12345", sound_speed=speed)
    return toa, pl.read_csv(case / "truth.csv").select("x", "y").to_numpy()


@pytest.mark.parametrize("method", METHODS)
def test_08_unknown_receivers_take_no_part(shared_dir, method):
    toa, truth = read(shared_dir / "cases" / "08-receiver-table-problems")
    points = locate(toa, method)
    assert (toa.set_aside.why == "receiver 309999 is not in the table").sum() == 5
    np.testing.assert_allclose(points.position, truth, atol=3)
    assert not points.inlier[:, toa.receivers.receiver == "301007"].any()
    assert not points.ambiguous.any()


def test_08_receivers_without_a_place_are_named(shared_dir):
    with pytest.raises(InputError, match="301004.*301005"):
        maloc.read_receivers(
            shared_dir / "cases" / "08-receiver-table-problems" / "receivers_nan.csv"
        )


def test_08_columns_are_matched_by_serial(shared_dir):
    case = shared_dir / "cases" / "08-receiver-table-problems"
    table = maloc.read_receivers(case / "receivers_reordered.csv")
    toa = maloc.read_toa(case / "toa_wide.csv", table, sound_speed=SPEED)
    truth = pl.read_csv(case / "truth.csv").select("x", "y").to_numpy()
    np.testing.assert_allclose(locate(toa).position, truth, atol=3)


def test_10_the_lone_echo_is_outvoted(shared_dir):
    toa, truth = read(shared_dir / "cases" / "10-multipath-doubles")
    assert toa.heard.sum() == 30  # 29 direct, and the echo without a direct partner
    points = locate(toa)
    np.testing.assert_allclose(points.position, truth, atol=3)
    late = ~points.inlier & toa.heard
    assert late.sum() == 1 and late[1, list(toa.receivers.receiver).index("301005")]
    plain = locate(toa, "least-squares")
    assert np.abs(plain.position[1] - truth[1]).max() > 3  # what it would have done


@pytest.mark.parametrize("method", ["consensus", "cluster"])
def test_13_both_branches_of_receivers_on_a_line(shared_dir, method):
    toa, truth = read(shared_dir / "cases" / "13-collinear-receivers")
    points = locate(toa, method)
    assert points.ambiguous.all()
    for branch in (points.position, points.alternative):
        np.testing.assert_allclose(branch[:, 0], truth[:, 0], atol=3)
        np.testing.assert_allclose(np.abs(branch[:, 1]), truth[:, 1], atol=5)
    np.testing.assert_allclose(points.position[:, 1], -points.alternative[:, 1], atol=1e-3)
    north = np.array([[-100.0, 0], [500, 0], [500, 400], [-100, 400]])
    told = locate(toa, method, region=north)
    assert not told.ambiguous.any()
    np.testing.assert_allclose(told.position[:, 1], truth[:, 1], atol=5)


def test_13_closed_forms_say_why_they_give_none(shared_dir):
    toa, _ = read(shared_dir / "cases" / "13-collinear-receivers")
    points = locate(toa, "closed-form")
    assert not points.located.any()
    assert set(points.why) == {"no place fits the arrivals"}


def command(case, out, *args, receivers="receivers.csv"):
    given = [case / "vue.csv", "--receivers", case / receivers, "--out", out]
    words = [*given, "--sound-speed", SPEED, *args]
    return CliRunner().invoke(app, ["points", *map(str, words)])


def test_08_command(shared_dir, tmp_path):
    case = shared_dir / "cases" / "08-receiver-table-problems"
    done = command(case, tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "309999" in done.stderr and "301007" in done.stderr
    truth = pl.read_csv(case / "truth.csv").select("x", "y").to_numpy()
    found = pl.read_csv(tmp_path / "out" / "points.csv")
    np.testing.assert_allclose(found.select("x", "y").to_numpy(), truth, atol=3)
    bad = command(case, tmp_path / "none", receivers="receivers_nan.csv")
    assert bad.exit_code == 2 and len(bad.stderr.splitlines()) == 1
    assert "301004 (x" in bad.stderr and "301005 (y" in bad.stderr
    assert not (tmp_path / "none").exists()


def test_10_command(shared_dir, tmp_path):
    case = shared_dir / "cases" / "10-multipath-doubles"
    done = command(case, tmp_path / "out")
    assert done.exit_code == 0, done.output
    truth = pl.read_csv(case / "truth.csv").select("x", "y").to_numpy()
    found = pl.read_csv(tmp_path / "out" / "points.csv")
    np.testing.assert_allclose(found.select("x", "y").to_numpy(), truth, atol=3)
    assert found["n_used"].to_list() == [6, 5, 6, 6, 6]  # the lone echo is out


def test_13_command(shared_dir, tmp_path):
    case = shared_dir / "cases" / "13-collinear-receivers"
    done = command(case, tmp_path / "out")
    assert done.exit_code == 0 and "mirror image" in done.stderr
    truth = pl.read_csv(case / "truth.csv").select("x", "y").to_numpy()
    found = pl.read_csv(tmp_path / "out" / "points.csv")
    assert found["ambiguous"].all()
    np.testing.assert_allclose(found["x"], truth[:, 0], atol=3)
    np.testing.assert_allclose(found["y"].abs(), truth[:, 1], atol=5)
    np.testing.assert_allclose(found["alternative_y"], -found["y"], atol=1e-3)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["tags"]["A69-1602-12345"]["ambiguous"] == 5
