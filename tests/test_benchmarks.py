"""Benchmarks run: once each, small."""

from __future__ import annotations

import sys

import numpy as np
import polars as pl
import pytest

import maloc
from benchmarks import engine, gps, halves, long, svi, tags, tracks, worlds
from benchmarks._worlds import Case


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


def test_a_world_is_fitted_once_and_gone_on_with(tmp_path, capsys, monkeypatch):
    """What was kept is not fitted again, by a build's name; a cut line is; rows are as before."""
    results = tmp_path / "kept" / "worlds.jsonl"
    words = ["none", "--worlds", "robust/right", "--tracks", "1", "--results", str(results)]
    worlds.main(words)
    (first,) = (s for s in capsys.readouterr().out.splitlines() if s.startswith("robust/right"))
    (kept,) = worlds.read_results(results).values()
    scores = kept["robust/right", 0]
    assert float(first.split()[3]) == pytest.approx(scores["mean"], abs=0.006)
    assert 0 < scores["mean"] < 3 * scores["variance"] ** 0.5
    fitted = []

    def fit_case(case, options):
        fitted.append((len(case.toa), options.error))
        return {"failed": "so it goes", "warned": []}

    monkeypatch.setattr(worlds, "fit_case", fit_case)
    worlds.main(words)
    again = [s for s in capsys.readouterr().out.splitlines() if s.startswith("robust/right")]
    assert again == [first] and fitted == []
    (build,) = worlds.read_results(results)
    results.write_text(results.read_text() + '{"build": "x", "wor')
    worlds.main([*words[:4], "2", *words[5:], "--error", "student", "--beside", build])
    said = capsys.readouterr().out
    assert [error for _, error in fitted] == ["student"] * 2
    assert "no (cover, ellipse, mean over" in said and "2 failed" in said and f"  {build}" in said
    with pytest.raises(SystemExit):
        worlds.main([*words, "--beside", "never"])
    assert f"no build never: it has {build}" in capsys.readouterr().err


def test_scores_of_a_world_by_hand():
    receivers = maloc.Receivers(np.array(["a", "b"]), np.array([-1.0, 1.0]), np.zeros(2))
    toa = maloc.ArrivalTimes(np.array([[1.0, 1.0], [31.0, 31.0]]), receivers, np.full(2, 1500.0))
    truth = np.array([[10.0, 0.0], [0.0, 20.0]])
    table = pl.DataFrame(
        {"t": [1.0, 16.0, 31.0], "x": [13.0, 0.0, 0.0], "y": [4.0, 0.0, 20.5], "ping": [1, None, 2]}
        | {"sd_x": [2.0] * 3, "sd_y": [1.0] * 3, "cov_xy": [0.0] * 3, "heard": [True, False, True]}
    ).with_columns(
        (pl.col(a) + s * 1.96 * pl.col(f"sd_{a}")).alias(f"{a}_{e}")
        for a in "xy"
        for s, e in ((-1, "lo"), (1, "hi"))
    )
    fitted = worlds.Fitted(toa, None, table)
    s = worlds.score(fitted, Case(toa, truth))
    assert (s["pings"], s["mean"], s["cover_x"], s["cover_y"]) == (2, 2.75, 1.0, 0.5)
    assert s["ellipse"] == 0.5  # 9 / 4 + 16 is beyond 5.991
    assert s["square"] == pytest.approx((25 + 0.25) / 2) and s["variance"] == pytest.approx(5.0)
    assert s["radial"] == pytest.approx((np.hypot(13, 4) - 10 + 0.5) / 2)
    assert s["radial_sd"] == pytest.approx(1.5)  # 2 eastward, 1 northward
    fixes = np.array([[10.0, 0.0, 0.0], [10.0, 30.0, 30.0]])  # ends before the second ping
    assert worlds.score(fitted, Case(toa, fixes, True))["mean"] == pytest.approx(np.hypot(3, 3))


def test_every_world_s_data_can_be_read(shared_dir):
    """The first case of each; those that need a synchronisation aside."""
    for world in worlds.worlds(1):
        cases = world.cases(shared_dir / "data")
        assert cases, world.name
        if world.name != "ssu1":
            case = cases[0]()
            assert len(case.truth) == len(case.toa) or case.gps, world.name


@pytest.mark.extended
def test_halves_of_scirep(shared_dir, capsys):
    halves.main([str(shared_dir / "data"), "--sets", "scirep", "--pings", "100"])
    row = next(s for s in capsys.readouterr().out.splitlines() if s.startswith("scirep  "))
    assert row.split()[1:4] == ["14", "+", "13"]
    assert all(float(v) > 0 for v in row.split()[5:11])


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
