"""`maloc track --model joint`: arrival times and silence in, one folder out."""

from __future__ import annotations

import json
from pathlib import Path

import arviz as az
import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

import maloc.infer
from maloc.cli import app

XY = np.array([[x, y] for x in (0.0, 60.0, 120.0) for y in (0.0, 60.0)])
SCALE, P0, SPEED = 60.0, 0.95, 1480.0


def track(out: Path, *args):
    return CliRunner().invoke(app, ["track", *map(str, args), "--out", str(out)])


def write(folder: Path, sent: np.ndarray, seed=0) -> dict:
    """A TOA matrix of the pings that somebody heard; truth."""
    rng = np.random.default_rng(seed)
    n = len(sent)
    place = np.column_stack([np.linspace(5, 115, n), 30 + 20 * np.sin(np.arange(n) / 4)])
    away = np.linalg.norm(place[:, None] - XY[None], axis=-1)
    heard = rng.random(away.shape) < P0 * np.exp(-0.5 * (away / SCALE) ** 2)
    heard[[3, 9, 10]] = False
    arrival = sent[:, None] + (away + rng.normal(0, 1.0, away.shape)) / SPEED
    rows = ["ping,sound_speed," + ",".join(f"R{j}" for j in range(len(XY)))]
    for i in np.flatnonzero(heard.any(axis=1)):
        cells = [f"{arrival[i, j]:.6f}" if heard[i, j] else "" for j in range(len(XY))]
        rows.append(f"{len(rows)},{SPEED},{','.join(cells)}")
    (folder / "toa.csv").write_text("\n".join(rows) + "\n")
    places = [f"R{j},{x},{y}" for j, (x, y) in enumerate(XY)]
    (folder / "receivers.csv").write_text("\n".join(["receiver,x,y", *places]) + "\n")
    return {"place": place, "heard": heard, "sent": sent}


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """A tag with a known sequence of intervals, whose pings 3, 9 and 10 nobody heard."""
    folder = tmp_path_factory.mktemp("sequence")
    intervals = np.random.default_rng(1).uniform(20, 40, 8)
    (folder / "intervals.csv").write_text("interval\n" + "\n".join(f"{v:.4f}" for v in intervals))
    steps = np.tile(np.round(intervals, 4), 4)[5:]
    truth = write(folder, 100 + np.concatenate([[0.0], np.cumsum(steps[:23])]))
    files = ["--toa", folder / "toa.csv", "--receivers", folder / "receivers.csv"]
    how = ["--model", "joint", "--schedule", folder / "intervals.csv", "--draws", 100]
    result = track(folder / "out", *files, *how)
    assert result.exit_code == 0, result.output + result.stderr
    return folder / "out", truth


def test_every_file_is_there(sequence):
    names = {p.name for p in sequence[0].iterdir()}
    wanted = {"track.csv", "arrivals.csv", "parameters.csv", "posterior.nc", "summary.json"}
    assert wanted | {"map.png", "diagnostics.png"} <= names


def test_missed_pings_of_a_sequence_are_rows_at_their_own_times(sequence):
    """Phase found, missed pings put where the sequence sends them, and near the true place."""
    table = pl.read_csv(sequence[0] / "track.csv")
    truth = sequence[1]
    first, last = np.flatnonzero(truth["heard"].any(axis=1))[[0, -1]]
    keep = slice(first, last + 1)
    assert len(table) == last + 1 - first
    np.testing.assert_array_equal(table["heard"], truth["heard"].any(axis=1)[keep])
    np.testing.assert_allclose(table["t"], truth["sent"][keep], atol=0.02)
    off = np.hypot(*(table["x", "y"].to_numpy() - truth["place"][keep]).T)
    assert np.median(off) < 4.0
    quiet = ~table["heard"].to_numpy()
    assert quiet.sum() >= 3
    assert (table["sd_x"].to_numpy()[quiet] > np.median(table["sd_x"])).all()


@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning")
def test_leave_one_out_is_by_ping(sequence):
    """Arrivals and who heard them make one number a ping, unheard pings of the sequence too."""
    table = pl.read_csv(sequence[0] / "track.csv")
    data = maloc.infer.read_posterior(sequence[0] / "posterior.nc")
    assert az.loo(data).n_data_points == len(table) == data["posterior"].sizes["ping"]
    np.testing.assert_array_equal(data["posterior"]["heard"], table["heard"])
    assert data["posterior"]["row"].values.tolist() == list(range(len(table)))
    density = data["log_likelihood"]["by_ping"].mean(("chain", "draw")).values
    quiet = ~table["heard"].to_numpy()
    assert (density[quiet] < 0).all() and np.isfinite(density).all()


def test_arrivals_have_residuals(sequence):
    rows = pl.read_csv(sequence[0] / "arrivals.csv")
    assert len(rows) == sequence[1]["heard"].sum()
    assert rows["residual"].null_count() == 0
    assert np.median(np.abs(rows["residual"].to_numpy())) < 2.0 / SPEED
    assert rows["p_direct"].is_between(0, 1).all()


def test_summary_names_the_model(sequence):
    summary = json.loads((sequence[0] / "summary.json").read_text())
    assert summary["model"] == "joint"
    assert summary["options"]["schedule_file"].endswith("intervals.csv")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("20\nthirty\n", "line 2: 'thirty' is no burst interval"),
        ("\n", "holds no burst intervals"),
        ("-3\n", "line 1: '-3' is no burst interval"),
    ],
)
def test_a_bad_sequence_is_one_line(tmp_path, text, word):
    write(tmp_path, 100 + 30.0 * np.arange(12))
    (tmp_path / "intervals.csv").write_text(text)
    files = ["--toa", tmp_path / "toa.csv", "--receivers", tmp_path / "receivers.csv"]
    result = track(tmp_path / "out", *files, "--model", "joint", "--schedule",
                   tmp_path / "intervals.csv")  # fmt: skip
    assert result.exit_code == 2
    assert word in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_sequence_needs_the_joint_model(tmp_path):
    write(tmp_path, 100 + 30.0 * np.arange(12))
    (tmp_path / "intervals.csv").write_text("30\n")
    files = ["--toa", tmp_path / "toa.csv", "--receivers", tmp_path / "receivers.csv"]
    for asked in (["--schedule", tmp_path / "intervals.csv"], ["--sound-speed", "drifting"]):
        result = track(tmp_path / "out", *files, *asked)
        assert result.exit_code == 2
        assert f"{asked[0]}" in result.stderr
        assert "goes with --model joint" in result.stderr
