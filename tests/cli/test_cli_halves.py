"""`maloc halves`: what it writes, how it splits, and how it refuses."""

from __future__ import annotations

import json

import numpy as np
import polars as pl
import pytest
import typer.main
from fakes import fake_of, fake_table
from test_cli import arrivals, refused, run, toa_csv

from maloc.cli import app

XY = {f"R{i}": (100.0 * (i % 3), 90.0 * (i // 3) + 20.0 * (i % 2)) for i in range(9)}


@pytest.fixture
def engine(monkeypatch):
    """A fake engine whose tracks are off by what their number of receivers says."""
    calls = []

    def laplace(model, toa, **how):
        calls.append((toa, how))
        fit = fake_of(toa, **how)
        place = np.full((int((toa.n_heard > 0).sum()), 2), float(toa.n_receivers))
        covariance = np.broadcast_to(np.eye(2) / 2, (len(place), 2, 2))
        vars(fit)["positions"] = lambda: (place, covariance, place, place)
        return fit

    from maloc import infer
    from maloc.infer import track

    monkeypatch.setattr(infer, "laplace", laplace, raising=False)
    monkeypatch.setattr(track, "track_table", fake_table)
    return calls


@pytest.fixture
def files(tmp_path):
    """Arrival times at nine receivers, and their table with a column of two halves."""
    table = pl.DataFrame(
        [(k, x, y, "north" if y > 150 else "south") for k, (x, y) in XY.items()],
        schema=["receiver", "x", "y", "side"],
        orient="row",
    )
    table.write_csv(tmp_path / "receivers.csv")
    toa = toa_csv(tmp_path, arrivals(20, XY), XY)
    return ["--toa", toa, "--receivers", tmp_path / "receivers.csv", "--out", tmp_path / "out"]


def test_a_run_by_every_other_receiver(engine, files, tmp_path):
    result = run("halves", *files, "--error", "student", "--movement", "rw")
    assert result.exit_code == 0, result.output
    whole, a, b = (toa for toa, _ in engine)
    assert whole.receivers.names == tuple(XY)
    assert a.receivers.names == tuple(XY)[::2] and b.receivers.names == tuple(XY)[1::2]
    assert {(h["error"], h["movement"]) for _, h in engine} == {("student", "rw")}
    rows = pl.read_csv(tmp_path / "out" / "halves.csv")
    assert len(rows) == 20 and rows["n_a"].unique().item() == 5 and rows["n_b"][0] == 4
    assert rows["dx"].unique().item() == 1.0 and rows["z_y"].unique().item() == 1.0
    found = json.loads((tmp_path / "out" / "halves.json").read_text())["tags"]["track"]
    assert found["chi2_x"] == 1.0 and found["within_y"] == 1.0 and found["n"] == 20
    assert len(found["receivers"]) == 9
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["command"] == "halves" and summary["options"]["split"] == "alternate"
    assert (tmp_path / "out" / "halves.png").stat().st_size > 1000
    assert "track      5 + 4     20    1.00    1.00     1.00     1.00" in result.output


@pytest.mark.parametrize(
    ("split", "first"),
    [("R0, R1,R5,R8", {"R0", "R1", "R5", "R8"}), ("side", {f"R{i}" for i in range(6)})],
)
def test_named_splits(engine, files, split, first):
    # three receivers are north
    result = run("halves", *files, "--split", split, "--least", 3, "--quiet")
    assert result.exit_code == 0 and result.output == ""
    assert set(engine[1][0].receivers.names) == first


def test_random_splits_follow_the_seed(engine, files):
    for seed in (1, 1, 2):
        assert run("halves", *files, "--split", "random", "--seed", seed, "--force").exit_code == 0
    a, again, other = (engine[i][0].receivers.names for i in (1, 4, 7))
    assert a == again != other


def test_refusals_are_one_line(engine, files):
    refused(run("halves", *files, "--split", "depth"), "--split depth is no column", "alternate")
    refused(run("halves", *files, "--split", "x"), "column 'x'", "3 values, not two halves")
    refused(run("halves", *files, "--split", "R1,X"), "receiver X is not in the table")
    refused(run("halves", *files, "--split", "side"), "3 receivers of one half", "need 4 in each")
    refused(run("halves", *files, "--least", 2), "--least must be 3 or more")
    refused(run("halves", *files, "--model", "joint"), "--model toa")
    assert engine == []


def test_it_takes_the_options_of_track(monkeypatch, tmp_path):
    """The same words give both commands the same options, whatever they are."""
    from maloc.runs import halves, track

    asked = []

    def remember(options, *args, **how):
        asked.append(getattr(options, "source", options))
        return []

    monkeypatch.setattr(track, "run_track", remember)
    monkeypatch.setattr(halves, "run_halves", remember)
    words = ["a.csv", "b.csv", "--receivers", "r.csv", "--out", tmp_path / "out", "--tag", "7"]
    words += ["--interval", 20, 40, "--sync", "none", "--tz", "Etc/GMT-1", "--depth", "sensor"]
    words += ["--depth-sd", 0.5, "--sound-speed", "estimated", "--start", "pmc", "--seed", 4]
    for command in ("track", "halves"):
        assert run(command, *words).exit_code == 0
    assert asked[0] == asked[1] and asked[0].reading.tz == "Etc/GMT-1"
    options = {
        c: {p.name for p in vars(typer.main.get_command(app))["commands"][c].params}
        for c in ("track", "halves")
    }
    assert options["track"] - options["halves"] == {"workers", "scheduler"}
    assert options["halves"] - options["track"] == {"split", "least"}
