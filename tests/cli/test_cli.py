"""The command line: what it writes, and how it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from fakes import fake_of, fake_table
from typer.testing import CliRunner

from maloc.cli import app
from maloc.errors import FitError

OUTPUTS = {
    "track.csv",
    "arrivals.csv",
    "parameters.csv",
    "posterior.nc",
    "map.png",
    "diagnostics.png",
    "summary.json",
}
XY = {"a": (0, 0), "b": (200, 10), "c": (190, 220), "d": (-5, 210)}


def run(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


def refused(result, *words, code=2):
    """One line on stderr that says these words, and an exit code."""
    errors = result.stderr.splitlines()
    assert result.exit_code == code, result.output
    assert len(errors) == 1 and errors[0].startswith("maloc: error: "), result.stderr
    assert "Traceback" not in result.output
    for word in words:
        assert word in errors[0]


@pytest.fixture
def engine(monkeypatch):
    """A fake engine in the place of the real one; gives the options it was called with."""
    calls = []

    def laplace(model, toa, **how):
        calls.append(how)
        return fake_of(toa, **how)

    def nuts(key, model, toa, *, method="nuts", **how):
        calls.append({"method": method, **how})
        return fake_of(toa, method)

    from maloc import infer
    from maloc.infer import track

    monkeypatch.setattr(infer, "laplace", laplace, raising=False)
    monkeypatch.setattr(infer, "nuts", nuts, raising=False)
    monkeypatch.setattr(track, "track_table", fake_table)
    return calls


def receivers_csv(folder: Path, xy=None) -> Path:
    path = folder / "receivers.csv"
    rows = [f"{k},{x},{y}" for k, (x, y) in (xy or XY).items()]
    path.write_text("\n".join(["receiver,x,y", *rows]) + "\n")
    return path


def arrivals(n=8, xy=None, where=(80.0, 60.0)):
    """Arrival times (n, R) of a tag that stays, every 30.4 s or so."""
    places = np.array(list((xy or XY).values()), float)
    first = 0.123 + 30.437 * np.arange(n)
    return first[:, None] + np.hypot(*(places - where).T) / 1500.0


def toa_csv(folder: Path, toa=None, xy=None, name="toa.csv") -> Path:
    toa = arrivals(xy=xy) if toa is None else toa
    table = pl.DataFrame(
        {"ping": np.arange(1, len(toa) + 1)} | dict(zip(xy or XY, toa.T, strict=True))
    )
    table.with_columns(pl.lit(1480.0).alias("sound_speed")).fill_nan(None).write_csv(folder / name)
    return folder / name


def detections_csv(folder: Path, tags=("A69-1-11",), toa=None, xy=None) -> Path:
    toa = arrivals(xy=xy) if toa is None else toa
    ns = 1_600_000_000_000_000_000 + np.round(toa * 1e6).astype(np.int64) * 1000
    rows = ["time,receiver,tag"]
    for i, tag in enumerate(tags):
        for t, row in enumerate(ns + i * 7_123_000_000):
            for r, name in enumerate(xy or XY):
                stamp = np.datetime_as_string(np.datetime64(int(row[r]), "ns"), "us")
                rows += [f"{stamp}Z,{name},{tag}"] if np.isfinite(toa[t, r]) else []
    (folder / "detections.csv").write_text("\n".join(rows) + "\n")
    return folder / "detections.csv"


# -- start-up and usage ---------------------------------------------------------------------------


@pytest.mark.parametrize("command", [[], ["track"], ["sync"], ["simulate"], ["check"]])
def test_help_needs_nothing_heavy(command):
    code = (
        "import sys\nfrom maloc.cli import app\n"
        f"app({[*command, '--help']!r}, standalone_mode=False)\n"
        "heavy = 'jax numpyro numpy polars matplotlib xarray scipy arviz'.split()\n"
        "sys.exit(str([m for m in heavy if m in sys.modules] or ''))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.strip() == "" and "Usage" in done.stdout


def test_entry_point_exits_with_the_code(tmp_path):
    code = "from maloc.cli import main; main()"
    args = [sys.executable, "-c", code, "check", str(tmp_path / "none.csv")]
    done = subprocess.run(args, capture_output=True, text=True)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and "none.csv" in done.stderr


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (["track", "--nonsense"], "--nonsense"),
        (["nonsense"], "nonsense"),
        (["track", "x.csv", "--out", "o"], "--receivers"),
        (["track", "x.csv", "--receivers", "r.csv"], "--out"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--model", "yaps"], "yaps"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--method", "svi"], "svi"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--interval", "20"], "--interval"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--interval", "40", "20"], "MAX"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--sound-speed", "fast"], "fast"),
        (["track", "x.csv", "--receivers", "r", "--out", "o", "--sound-speed", "343"], "343"),
        (["track", "--receivers", "r", "--out", "o"], "--toa"),
        (["track", "x.csv", "--toa", "t", "--receivers", "r", "--out", "o"], "--toa"),
        (["simulate", "o", "--missing", "2"], "--missing"),
        (["check"], "files"),
    ],
)
def test_bad_usage_is_one_line(args, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*args)
    refused(result)
    assert word.lower() in result.stderr.lower()
    assert list(tmp_path.iterdir()) == []


# -- track ----------------------------------------------------------------------------------------


def test_track_writes_every_file(tmp_path, engine):
    out = tmp_path / "out"
    toa = arrivals()
    toa[3] = np.nan
    result = run(
        "track",
        "--toa",
        toa_csv(tmp_path, toa),
        "--receivers",
        receivers_csv(tmp_path),
        "--out",
        out,
        "--interval",
        20,
        40,
        "--movement",
        "rw",
        "--error",
        "student",
    )
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.iterdir()} == OUTPUTS
    wanted = {"movement": "rw", "error": "student", "sound_speed": "auto", "positions": None}
    assert engine == [wanted | {"draws": 1000, "seed": 0, "receivers": "auto"}]
    track = pl.read_csv(out / "track.csv")
    assert track["n_receivers"].to_list() == [4, 4, 4, 0, 4, 4, 4, 4]
    assert track["time"].null_count() == 8  # the input had no dates
    summary = json.loads((out / "summary.json").read_text())
    assert summary["seed"] == 0 and summary["options"]["interval"] == [20, 40]
    tag = summary["tags"]["track"]
    assert tag["pings"] == 8 and tag["unheard"] == 1 and tag["arrivals_used"] == 28
    assert tag["sound_speed"] == 1480 and tag["schedule"]["kind"] == "random"
    assert summary["versions"]["maloc"] and summary["mirror"] is None
    assert {"read", "fit", "tables", "figures"} <= set(summary["seconds"])
    assert all({"wall", "cpu"} == set(s) for s in summary["seconds"].values())


def test_existing_folder_is_refused_before_any_work(tmp_path, engine):
    out = tmp_path / "out"
    args = ["track", "--toa", toa_csv(tmp_path), "--receivers", receivers_csv(tmp_path)]
    args += ["--out", out]
    assert run(*args).exit_code == 0
    refused(run(*args), "--force", str(out))
    assert len(engine) == 1
    assert run(*args, "--force").exit_code == 0


def test_quiet_says_nothing(tmp_path, engine):
    args = ["track", "--toa", toa_csv(tmp_path), "--receivers", receivers_csv(tmp_path)]
    result = run(*args, "--out", tmp_path / "out", "--quiet")
    assert result.exit_code == 0 and result.output == ""


def test_a_failed_fit_is_explained_and_leaves_nothing(tmp_path, engine, monkeypatch):
    from maloc import infer

    def laplace(*args, **how):
        raise FitError("the mode was not found")

    monkeypatch.setattr(infer, "laplace", laplace)
    args = ["track", "--toa", toa_csv(tmp_path), "--receivers", receivers_csv(tmp_path)]
    refused(run(*args, "--out", tmp_path / "out"), "the mode was not found", code=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["receivers.csv", "toa.csv"]


def test_samplers_get_their_options(tmp_path, engine):
    args = ["track", "--toa", toa_csv(tmp_path), "--receivers", receivers_csv(tmp_path), "-q"]
    more = ["--method", "hmc", "--draws", 50, "--chains", 3, "--sound-speed", "estimated"]
    more += ["--start", "pmc"]
    assert run(*args, *more, "--out", tmp_path / "out").exit_code == 0
    assert engine[0] == {
        "method": "hmc",
        "draws": 50,
        "chains": 3,
        "movement": "ctcrw",
        "error": "auto",
        "receivers": "auto",
        "sound_speed": "estimated",
        "positions": "pmc",
        "progress": False,
    }
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    health = summary["tags"]["track"]["sampler"]
    assert health["r_hat"] == 1.001 and health["ess_bulk"] == 390


def test_several_tags_share_tables_and_have_their_own_draws(tmp_path, engine):
    found = detections_csv(tmp_path, ("A69-1-11", "A69-1-12", "A69-1-13"))
    args = ["track", found, "--receivers", receivers_csv(tmp_path), "--sound-speed", "1500"]
    result = run(*args, "--out", tmp_path / "out", "--tag", 11, "--tag", "A69-1-13")
    assert result.exit_code == 0, result.output
    track = pl.read_csv(tmp_path / "out" / "track.csv")
    assert track["tag"].to_list() == ["A69-1-11"] * 8 + ["A69-1-13"] * 8
    assert track["time"][0].startswith("2020-09-13T12:26:40.")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"posterior_A69-1-11.nc", "posterior_A69-1-13.nc"} <= names
    assert "posterior.nc" not in names and "map.png" in names
    assert run(*args, "--out", tmp_path / "all").exit_code == 0
    assert pl.read_csv(tmp_path / "all" / "track.csv")["tag"].n_unique() == 3


def test_a_tag_that_cannot_be_tracked_is_skipped_unless_it_was_asked_for(tmp_path, engine):
    found = detections_csv(tmp_path, ("A69-1-11",))
    with found.open("a") as file:
        file.write("2020-09-13T12:30:00.123Z,a,A69-1-99\n")
    args = ["track", found, "--receivers", receivers_csv(tmp_path)]
    assert run(*args, "--out", tmp_path / "all").exit_code == 0
    summary = json.loads((tmp_path / "all" / "summary.json").read_text())
    assert list(summary["skipped_tags"]) == ["A69-1-99"]
    refused(run(*args, "--tag", 99, "--out", tmp_path / "out"), "1 receiver")


def test_unknown_receivers_are_counted_and_take_no_part(tmp_path, engine):
    found = detections_csv(tmp_path)
    some = receivers_csv(tmp_path, {k: XY[k] for k in "abc"})
    result = run("track", found, "--receivers", some, "--out", tmp_path / "out")
    assert result.exit_code == 0
    assert any("8 detections" in r and " d" in r for r in result.stderr.splitlines())
    table = pl.read_csv(tmp_path / "out" / "arrivals.csv")
    aside = table.filter(~pl.col("used"))
    assert aside["receiver"].to_list() == ["d"] * 8
    assert aside["why"].unique().to_list() == ["receiver d is not in the table"]
    assert table["detection"].sort().to_list() == list(range(32))


def test_receivers_on_one_line_make_the_mirror_plain(tmp_path, engine):
    xy = {"a": (0, 0), "b": (100, 0), "c": (200, 0), "d": (300, 0)}
    args = ["track", "--toa", toa_csv(tmp_path, xy=xy), "--receivers", receivers_csv(tmp_path, xy)]
    result = run(*args, "--out", tmp_path / "out")
    assert result.exit_code == 0 and "mirror" in result.stderr
    track = pl.read_csv(tmp_path / "out" / "track.csv")
    np.testing.assert_allclose(track["mirror_x"], track["x"])
    np.testing.assert_allclose(track["mirror_y"], -track["y"])
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert np.abs(summary["mirror"]["lines"]["track"]["direction"]) == pytest.approx([1, 0])


# -- bad input ------------------------------------------------------------------------------------


def _write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def _nan_receiver(folder):
    table = _write(folder, "receivers.csv", "receiver,x,y\na,0,0\nb,,10\nc,1,100\nd,100,9\n")
    return ["--toa", toa_csv(folder), "--receivers", table], ["receivers.csv", "b"]


def _no_column(folder):
    table = _write(folder, "receivers.csv", "receiver,x\na,0\nb,1\n")
    return ["--toa", toa_csv(folder), "--receivers", table], ["receivers.csv", "y"]


def _unknown_column(folder):
    xy = {k: XY[k] for k in "abc"}
    return ["--toa", toa_csv(folder), "--receivers", receivers_csv(folder, xy)], ["toa.csv", " d;"]


def _unrecognised(folder):
    table = _write(folder, "d.csv", "colour,size\nred,3\n")
    return [table, "--receivers", receivers_csv(folder)], ["d.csv", "colour"]


def _missing_file(folder):
    return [folder / "no.csv", "--receivers", receivers_csv(folder)], ["no.csv"]


def _binary(folder):
    (folder / "d.csv").write_bytes(bytes(range(256)) * 4)
    return [folder / "d.csv", "--receivers", receivers_csv(folder)], ["d.csv"]


def _empty(folder):
    table = _write(folder, "d.csv", "time,receiver,tag\n")
    return [table, "--receivers", receivers_csv(folder)], ["no detections"]


def _unsorted(folder):
    toa = arrivals()[[0, 2, 1, 3, 4, 5, 6, 7]]
    return ["--toa", toa_csv(folder, toa), "--receivers", receivers_csv(folder)], ["toa.csv"]


def _duplicated(folder):
    toa = arrivals()[[0, 1, 1, 2, 3, 4]]
    return ["--toa", toa_csv(folder, toa), "--receivers", receivers_csv(folder)], ["toa.csv"]


def _whole_seconds(folder):
    found = detections_csv(folder, toa=np.floor(arrivals()))
    return [found, "--receivers", receivers_csv(folder)], ["whole seconds"]


def _whole_seconds_toa(folder):
    toa = toa_csv(folder, np.floor(arrivals()))
    return ["--toa", toa, "--receivers", receivers_csv(folder)], ["whole seconds"]


def _whole_seconds_of_one(folder):
    toa = arrivals()
    toa[:, 1] = np.round(toa[:, 1])
    found = detections_csv(folder, toa=toa)
    return [found, "--receivers", receivers_csv(folder)], ["whole seconds", "receiver b"]


def _two_pings(folder):
    toa = toa_csv(folder, arrivals(2))
    return ["--toa", toa, "--receivers", receivers_csv(folder)], ["2 usable pings"]


def _one_receiver(folder):
    toa = arrivals()
    toa[:, 1:] = np.nan
    return ["--toa", toa_csv(folder, toa), "--receivers", receivers_csv(folder)], ["1 receiver"]


def _one_in_the_table(folder):
    table = receivers_csv(folder, {"a": (0, 0)})
    return [detections_csv(folder), "--receivers", table], ["1 receiver"]


def _unknown_tag(folder):
    args = [detections_csv(folder), "--receivers", receivers_csv(folder), "--tag", "77"]
    return args, ["77", "A69-1-11"]


def _bad_crs(folder):
    args = [detections_csv(folder), "--receivers", receivers_csv(folder), "--crs", "EPSG:nope"]
    return args, ["EPSG:nope"]


def _bad_sync_file(folder):
    sync = _write(folder, "sync.nc", "no netcdf")
    args = [detections_csv(folder), "--receivers", receivers_csv(folder), "--sync", sync]
    return args, ["sync.nc"]


BAD = [
    _nan_receiver,
    _no_column,
    _unknown_column,
    _unrecognised,
    _missing_file,
    _binary,
    _empty,
    _unsorted,
    _duplicated,
    _whole_seconds,
    _whole_seconds_toa,
    _whole_seconds_of_one,
    _two_pings,
    _one_receiver,
    _one_in_the_table,
    _unknown_tag,
    _bad_crs,
    _bad_sync_file,
]


@pytest.mark.parametrize("make", BAD, ids=lambda f: f.__name__.strip("_"))
def test_bad_input_is_one_line_and_writes_nothing(make, tmp_path, engine):
    args, words = make(tmp_path)
    before = sorted(tmp_path.iterdir())
    refused(run("track", *args, "--out", tmp_path / "out"), *words)
    assert sorted(tmp_path.iterdir()) == before
    assert not engine


# -- the other commands ---------------------------------------------------------------------------


def test_simulate_is_repeatable_and_track_reads_it(tmp_path, engine):
    for name in ("one", "two"):
        result = run("simulate", tmp_path / name, "--scenario", "grid", "--pings", 12, "--seed", 5)
        assert result.exit_code == 0, result.output
    for file in ("detections.csv", "receivers.csv", "truth.csv", "toa.csv"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    refused(run("simulate", tmp_path / "one"), "--force")
    study = tmp_path / "one"
    args = ["track", "--toa", study / "toa.csv", "--receivers", study / "receivers.csv"]
    assert run(*args, "--out", tmp_path / "out").exit_code == 0


def test_sync_and_track_keep_count_of_every_detection(tmp_path, engine):
    study = tmp_path / "study"
    assert run("simulate", study, "--pings", 40).exit_code == 0
    args = [study / "detections.csv", "--receivers", study / "receivers.csv"]
    result = run("sync", *args, "--out", tmp_path / "sync")
    assert result.exit_code == 0, result.output
    names = {p.name for p in (tmp_path / "sync").iterdir()}
    assert {
        "sync.nc",
        "detections_synced.parquet",
        "receivers_fitted.csv",
        "residuals.csv",
        "summary.json",
    } <= names
    result = run("track", *args, "--out", tmp_path / "auto")
    assert result.exit_code == 0, result.output
    arrivals = pl.read_csv(tmp_path / "auto" / "arrivals.csv")
    raw = pl.read_csv(study / "detections.csv").with_row_index("row")
    mine = raw.filter(pl.col("tag") == arrivals["tag"][0])
    assert arrivals["detection"].sort().to_list() == mine["row"].to_list()
    both = arrivals.join(raw, left_on="detection", right_on="row")
    assert (both["receiver"] == both["receiver_right"]).all()
    given = run("track", *args, "--sync", tmp_path / "sync" / "sync.nc", "--out", tmp_path / "nc")
    assert given.exit_code == 0, given.output
    again = pl.read_csv(tmp_path / "nc" / "arrivals.csv")
    np.testing.assert_allclose(again["t"], arrivals["t"], atol=2e-6)
    summary = json.loads((tmp_path / "auto" / "summary.json").read_text())
    assert summary["sync"]["sound_speed"] == pytest.approx(1450, abs=15)


def test_sync_without_sync_tags_is_refused(tmp_path):
    args = [detections_csv(tmp_path), "--receivers", receivers_csv(tmp_path)]
    refused(run("sync", *args, "--out", tmp_path / "out"), "sync tag")
    assert not (tmp_path / "out").exists()


def test_check_prints_what_it_found(tmp_path):
    result = run("check", detections_csv(tmp_path), receivers_csv(tmp_path))
    assert result.exit_code == 0, result.output
    assert "32 detections" in result.stdout and "A69-1-11" in result.stdout
    bad = _write(tmp_path, "bad.csv", "colour,size\nred,3\n")
    result = run("check", detections_csv(tmp_path), bad)
    refused(result, "bad.csv")
    assert "32 detections" in result.stdout


# -- with the real engine -------------------------------------------------------------------------


def test_a_line_of_receivers_end_to_end(tmp_path):
    """Simulated, tracked, compared with the truth: right up to the mirror, which is reported."""
    study, out = tmp_path / "study", tmp_path / "out"
    assert run("simulate", study, "--scenario", "line", "--pings", 40).exit_code == 0
    args = ["--toa", study / "toa.csv", "--receivers", study / "receivers.csv"]
    result = run("track", *args, "--out", out, "--interval", 20.6, 36.6)
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.iterdir()} == OUTPUTS
    truth, track = pl.read_csv(study / "truth.csv"), pl.read_csv(out / "track.csv")
    assert len(track) == len(truth)
    x, y = (track[c].to_numpy() for c in "xy")
    own = np.hypot(x - truth["x"].to_numpy(), y - truth["y"].to_numpy())
    mirror = [track[f"mirror_{c}"].to_numpy() for c in "xy"]
    other = np.hypot(mirror[0] - truth["x"].to_numpy(), mirror[1] - truth["y"].to_numpy())
    assert np.median(np.minimum(own, other)) < 6.0
    arrivals = pl.read_csv(out / "arrivals.csv")
    toa = pl.read_csv(study / "toa.csv").drop("ping", "tag", "sound_speed", strict=False)
    assert arrivals["used"].sum() == toa.count().sum_horizontal().item()
    assert arrivals["p_direct"].is_between(0, 1).all()
    import xarray as xr

    with xr.open_datatree(out / "posterior.nc", engine="h5netcdf") as tree:
        assert {"posterior", "log_likelihood", "observed_data"} <= set(tree.children)
