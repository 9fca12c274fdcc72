"""A tag whose codes say depth and temperature in turn, from files to a track with depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

from maloc.cli import app
from maloc.data import WaterColumn, toa_matrix
from maloc.errors import InputError
from maloc.readers import read_detections, read_receivers, read_tags
from maloc.runs.depth import with_depth
from maloc.runs.load import Source
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from simulations import depth as study

SLOPE, LOWEST = 0.35, -1.5  # m a count, m
TAGS = (
    "tag,animal,sensor,slope,intercept,min_delay,max_delay\n"
    f"A69-9006-501,pike,depth,{SLOPE},{LOWEST},20.6,36.6\n"
    "A69-9006-502,pike,temperature,0.15,-5,20.6,36.6\n"
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files as a user has them, and the truth; every other ping is a temperature."""
    folder = tmp_path_factory.mktemp("interleaved")
    made = study.simulate(np.random.default_rng(11), 40)
    toa, depth = made.toa, made.place[:, 2]
    ping, column = np.nonzero(toa.heard)
    order = np.argsort(toa.toa[ping, column], kind="stable")
    ping, column = ping[order], column[order]
    deep = ping % 2 == 0
    counts = np.where(deep, np.rint((depth[ping] - LOWEST) / SLOPE), 100 + ping % 3).astype(int)
    start = np.datetime64("2026-06-01", "ns").astype(np.int64)
    time = start + np.round(toa.toa[ping, column] * 1e9).astype(np.int64)
    stamps = np.datetime_as_string(time.astype("datetime64[ns]"), "ns")
    table = pl.DataFrame(
        {
            "time": [f"{s}Z" for s in stamps],
            "receiver": toa.receivers.receiver[column].tolist(),
            "tag": np.where(deep, "A69-9006-501", "A69-9006-502").tolist(),
            "sensor": counts,
            "sensor_unit": ["ADC"] * len(counts),
        }
    )
    table.write_csv(folder / "detections.csv")
    toa.receivers.to_frame().write_csv(folder / "receivers.csv")
    (folder / "tags.csv").write_text(TAGS)
    return folder, made


def test_depths_go_with_their_pings(files):
    folder, made = files
    detections = read_tags(folder / "tags.csv").apply(read_detections(folder / "detections.csv"))
    receivers = read_receivers(folder / "receivers.csv")
    toa = toa_matrix(detections, receivers, "pike", sound_speed=study.SPEED)
    heard = made.toa.n_heard > 0
    deep = np.arange(len(heard))[heard] % 2 == 0
    assert toa.depth is not None and len(toa) == heard.sum()
    np.testing.assert_array_equal(np.isfinite(toa.depth), deep)
    np.testing.assert_allclose(toa.depth[deep], made.place[heard, 2][deep], atol=SLOPE / 2 + 1e-9)


@pytest.mark.extended
def test_track_of_interleaved_codes(files, tmp_path):
    folder, made = files
    command = ["track", folder / "detections.csv", "--receivers", folder / "receivers.csv"]
    command += ["--tag-table", folder / "tags.csv", "--sync", "none", "--depth", "sensor"]
    command += ["--depth-sd", 0.2, "--bottom", made.bottom, "--sound-speed", study.SPEED]
    result = CliRunner().invoke(app, [*map(str, command), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    table = pl.read_csv(tmp_path / "out" / "track.csv").filter(pl.col("heard"))
    truth = made.place[made.toa.n_heard > 0]
    off = table.select("x", "y").to_numpy() - truth[:, :2]
    assert np.linalg.norm(off, axis=1).mean() < 1.5
    z, low, high = table.select("z", "z_lo", "z_hi").to_numpy().T
    deep = np.flatnonzero(made.toa.n_heard > 0) % 2 == 0
    assert np.abs(z - truth[:, 2])[deep].mean() < 0.3  # sd .2 m
    assert ((low <= truth[:, 2]) & (truth[:, 2] <= high)).mean() > 0.8


def asked(folder, **how) -> TrackOptions:
    return TrackOptions(toa=folder / "toa.csv", receivers=folder / "receivers.csv", **how)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"depth": "3d", "model": "detections"}, "goes with --model toa or joint"),
        ({"bottom": "40"}, "says nothing to a flat track"),
        ({"depth": "deep"}, "none of flat, sensor, 3d, nor metres"),
        ({"depth": "3d", "depth_sd": -1.0}, "is negative"),
        ({"depth": "3d", "bottom": "nowhere.tif"}, "neither metres nor a file"),
    ],
)
def test_options_that_cannot_be_meant(tmp_path, how, said):
    with pytest.raises(InputError, match=said):
        asked(tmp_path, **how)


def test_depth_that_was_asked_for(files):
    folder, made = files
    source, log = Source([made.toa], made.toa.receivers, None, None, {}), Log(True)
    assert with_depth(source, asked(folder), log).toas[0].column is None
    assert "are not used: the track is flat" in log.notices[0]
    fixed = with_depth(source, asked(folder, depth="7.5"), log).toas[0]
    assert fixed.column == WaterColumn(None, 0.0) and (np.asarray(fixed.depth) == 7.5).all()
    found = with_depth(source, asked(folder, depth="sensor", bottom="80"), log).toas[0]
    assert found.column == WaterColumn(80.0, 1.0)
    silent = source._replace(toas=[made.toa.replace(depth=None)])
    with pytest.raises(InputError, match="sent no depths"):
        with_depth(silent, asked(folder, depth="sensor"), log)
    bare = replace(made.toa.receivers, depth=np.full(16, np.nan))
    with pytest.raises(InputError, match="receiver R0 has no depth"):
        with_depth(source._replace(receivers=bare), asked(folder, depth="3d"), log)
