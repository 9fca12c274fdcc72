"""The main job from a raw export to every output, on whatever versions are installed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import xarray as xr

from maloc.evaluate import evaluate
from maloc.export import FORMATS
from tests.smoke.command import INTERVAL, TAGS, maloc


def scores(study: Path, table: Path) -> dict:
    """Positions of the first tag against where the animal was."""
    track = pl.read_csv(table).filter(pl.col("tag") == TAGS[0])
    return evaluate(track, pl.read_csv(study / "truth.csv")).scores


def test_version_and_help():
    from maloc import __version__

    assert maloc("--version").strip() == f"maloc {__version__}"
    assert "track" in maloc("--help")


def test_check(study):
    said = maloc("check", study / "detections.csv", study / "receivers.csv")
    assert "12 receivers" in said and "0 errors" in said


def test_sync(synced):
    assert {p.suffix for p in synced.iterdir()} >= {".nc", ".parquet", ".csv", ".json", ".png"}
    heard = pl.read_parquet(synced / "detections_synced.parquet")
    assert heard["receiver"].n_unique() == 12


def test_track_writes_all(tracked, study):
    assert {p.name for p in tracked.iterdir()} == {
        "track.csv", "arrivals.csv", "parameters.csv", "posterior.nc", "map.png",
        "diagnostics.png", "summary.json",
    }  # fmt: skip
    found = scores(study, tracked / "track.csv")
    assert found["n"] == 60 and found["median"] < 2 and found["coverage"] > 0.8
    assert json.loads((tracked / "summary.json").read_text())["versions"]["jax"] != "unknown"


def test_posterior_opens(tracked):
    with xr.open_datatree(tracked / "posterior.nc", engine="h5netcdf") as tree:
        assert {"posterior", "log_likelihood", "observed_data"} <= set(tree.children)
        position = tree["posterior"]["position"]
        assert np.isfinite(position.to_numpy()).all()


@pytest.mark.parametrize("to", sorted(FORMATS))
def test_export(tracked, predicted, tmp_path, to):
    run = predicted if to == "imputations" else tracked
    out = tmp_path / f"track{FORMATS[to].ending}"
    maloc("export", run, "--to", to, "--out", out)
    assert out.is_dir() or out.stat().st_size > 100


@pytest.fixture(scope="module")
def predicted(tracked) -> Path:
    out = tracked.parent / "predicted"
    maloc("predict", tracked, "--every", 30, "--draws", 10, "--out", out)
    return out


def test_predict(predicted, study):
    found = scores(study, predicted / "predicted.csv")  # where a ping's time is near a prediction's
    assert found["n"] >= 10 and found["median"] < 2 and found["coverage"] > 0.7
    draws = pl.read_parquet(predicted / "draws.parquet")
    assert draws["draw"].n_unique() == 10


def test_points(study, synced):
    out = study.parent / "points"
    files = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    maloc("points", *files, "--tag", "1001", "--sync", synced / "sync.nc", "--out", out)
    found = scores(study, out / "points.csv")
    assert found["n"] >= 50 and found["median"] < 3


def test_who_heard_what(study):
    out = study.parent / "presence"
    files = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    how = ["--tag", "1001", "--interval", *INTERVAL, "--model", "detections", "--movement", "rw"]
    how += ["--draws", "200"]
    maloc("track", *files, *how, "--out", out)
    # these receivers hear alike from everywhere: the position stays open, and the limits say so
    found = scores(study, out / "track.csv")
    assert found["n"] == 60 and found["coverage"] > 0.8


def test_many_tags_by_dask(study, synced):
    out = study.parent / "tags"
    files = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    how = ["--tag", "all", "--interval", *INTERVAL, "--sync", synced / "sync.nc", "--workers", 2]
    maloc("track", *files, *how, "--out", out)
    table = pl.read_csv(out / "tags.csv")
    assert table["tag"].sort().to_list() == list(TAGS)
    assert table["status"].to_list() == ["done", "done"]
    found = scores(study, out / "track.csv")
    assert found["n"] == 60 and found["median"] < 2
