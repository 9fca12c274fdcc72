"""Benchmarks run: once each, small."""

from __future__ import annotations

import sys

import numpy as np
import polars as pl
import pytest

from benchmarks import engine, gps, long, svi, tags, tracks


def test_simulated_tracks_are_fitted_and_scored(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tracks", "--simulate", "2"])
    tracks.main()
    said = capsys.readouterr().out
    assert "2 files, 0 failed, 0 lost" in said
    assert "sim001_na00_mp06" in said


def test_a_folder_beside_a_peer(shared_dir, tmp_path, capsys, monkeypatch):
    data = shared_dir / "data" / "sim_canal"
    for name in ("receivers.csv", "track03_na00_mp06.csv"):
        (tmp_path / name).write_bytes((data / name).read_bytes())
    peer = str(data / "yaps_results.csv")
    monkeypatch.setattr(sys, "argv", ["tracks", str(tmp_path), "--peer", peer])
    tracks.main()
    row = next(s for s in capsys.readouterr().out.splitlines() if s.startswith("track03"))
    assert float(row.split()[-1]) < 0.92  # mean error / YAPS's


def test_gps_scores_by_interpolation():
    fixes = np.array([[0.0, 0.0, 10.0], [10.0, 0.0, 20.0]])
    track = pl.DataFrame(
        {
            "t": [5.0, 15.0, 18.0],
            "x": [0.0, 5.0, 8.0],
            "y": [0.0, 3.0, 0.0],
            "sd_x": [1.0] * 3,
            "sd_y": [1.0] * 3,
            "x_lo": [-2.0, 3.0, 6.0],
            "x_hi": [2.0, 7.0, 10.0],
            "y_lo": [-2.0, 1.0, -2.0],
            "y_hi": [2.0, 5.0, 2.0],
            "heard": [True, True, False],
        }
    )
    scores = gps.errors(track, fixes, gps_sd=3.0)
    assert scores["error"] == pytest.approx([3.0, 0.0])
    assert list(scores["inside"]) == [0.5, 1.0]  # y misses by 3 m, beyond its 2 m limits
    assert list(scores["inside_with_gps_sd"]) == [1.0, 1.0]
    assert list(scores["heard"]) == [True, False]


@pytest.mark.extended
def test_engine_against_plain_nuts(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["engine", "--pings", "12", "--draws", "20"])
    engine.main()
    rows = [s for s in capsys.readouterr().out.splitlines() if s.startswith("maloc ")]
    assert len(rows) == 2 and all(s.endswith("x") for s in rows)


@pytest.mark.extended
def test_svi_beside_nuts(monkeypatch, capsys):
    """Positions of a short track against a sampler of enough draws: SVI nearer than Laplace."""
    short = ["--size", "12", "--draws", "2000", "--steps", "200"]
    monkeypatch.setattr(sys, "argv", ["svi", *short])
    svi.main()
    said = capsys.readouterr().out
    off = {}
    for name in ("Laplace", "SVI"):
        part = said[said.index(f"{name}, evidence bound") :].splitlines()
        off[name] = float(next(s for s in part if "states" in s).split()[5].rstrip(","))
    assert off["Laplace"] < 0.2
    assert off["SVI"] < 0.1
    assert said.count("ratio of sd: median") == 2


@pytest.mark.extended
def test_long_tracks_and_their_seams(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["long", "--pings", "40", "--seams", "2100"])
    long.main()
    said = capsys.readouterr().out
    assert "  yes" in said and "0 states beyond .05 sd" in said


@pytest.mark.extended
def test_many_tags_killed_and_gone_on_with(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tags", "--workers", "2", "--kill", "4"])
    tags.main()
    said = capsys.readouterr().out
    assert "recomputed 0 of them" in said
    assert "tables the same: track.csv, arrivals.csv, parameters.csv" in said
