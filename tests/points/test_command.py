"""`maloc points`: regions, other pings' word on two places, clocks apart, terrain."""

from __future__ import annotations

import json

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from maloc.cli import app
from maloc.errors import InputError
from maloc.points import read_region


def run(*words):
    return CliRunner().invoke(app, [*map(str, words)])


@pytest.fixture
def line(shared_dir):
    """Receivers on a line: every ping has a mirror image."""
    case = shared_dir / "cases" / "13-collinear-receivers"
    return [case / "vue.csv", "--receivers", case / "receivers.csv", "--sound-speed", 1475.0]


def test_region_settles_a_mirror(line, shared_dir, tmp_path):
    corners = tmp_path / "north.csv"
    corners.write_text("x,y\n-100,0\n500,0\n500,400\n-100,400\n-100,0\n")
    done = run("points", *line, "--region", corners, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = pl.read_csv(tmp_path / "out" / "points.csv")
    truth = pl.read_csv(shared_dir / "cases" / "13-collinear-receivers" / "truth.csv")
    assert not found["ambiguous"].any()
    np.testing.assert_allclose(found["y"], truth["y"], atol=5)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["options"]["region"] == str(corners)


def test_resolve_leaves_open_what_no_ping_tells(line, tmp_path):
    done = run("points", *line, "--resolve", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert pl.read_csv(tmp_path / "out" / "points.csv")["ambiguous"].all()


def test_corners_in_degrees_are_projected_and_wrong_ones_named(tmp_path):
    file = tmp_path / "corners.csv"
    file.write_text("lon,lat\n-80.6,25.0\n-80.5,25.0\n-80.5,25.1\n")
    corners = read_region(file, "EPSG:32617")
    east = 0.1 * 111320 * np.cos(np.deg2rad(25))
    np.testing.assert_allclose(np.linalg.norm(corners[1] - corners[0]), east, rtol=5e-3)
    with pytest.raises(InputError, match="frame is not known"):
        read_region(file)
    file.write_text("x,y\n0,0\n1,1\n0,0\n")
    with pytest.raises(InputError, match="2 corners"):
        read_region(file)
    file.write_text("a,b\n0,0\n")
    with pytest.raises(InputError, match="no corners; header: a, b"):
        read_region(file)


def test_clocks_apart_are_compared_with_sync_tags(tmp_path):
    study = tmp_path / "study"
    made = run("simulate", study, "--pings", 60, "--interval", 20, 40, "--late", 0.05)
    assert made.exit_code == 0, made.output
    given = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    words = [*given, "--tag", "1001", "--sync", "beacons", "--sound-speed", 1450]
    done = run("points", *words, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = pl.read_csv(tmp_path / "out" / "points.csv")
    truth = pl.read_csv(study / "truth.csv").join(found, "ping", suffix="_found")
    offset = truth.select("x", "y").to_numpy() - truth.select("x_found", "y_found").to_numpy()
    off = np.linalg.norm(offset, axis=1)
    assert len(off) > 50
    assert np.nanmedian(off) < 5  # clocks are up to .9 s apart, 1300 m
    stated = np.hypot(truth["sd_x"].to_numpy(), truth["sd_y"].to_numpy())
    assert 0.5 < np.median(off / stated) < 1.5
    assert pl.read_csv(tmp_path / "out" / "arrivals.csv")["residual"].is_null().all()
    track = run("track", *words, "--out", tmp_path / "track")
    assert track.exit_code == 2 and "goes with maloc points" in track.stderr
    pmc = run("points", *words, "--method", "pmc", "--out", tmp_path / "pmc")
    assert pmc.exit_code == 2 and "consensus, cluster, closed-form" in pmc.stderr


def test_without_sync_tags_there_are_no_beacons(line, tmp_path):
    done = run("points", *line, "--sync", "beacons", "--out", tmp_path / "out")
    assert done.exit_code == 2 and "needs sync tags" in done.stderr


def test_depth_that_is_no_file_is_said(line, tmp_path):
    done = run("points", *line, "--depth", "deep", "--out", tmp_path / "out")
    assert done.exit_code == 2 and "--depth deep is none of" in done.stderr
    assert len(done.stderr.splitlines()) == 1
