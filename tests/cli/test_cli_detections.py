"""`maloc track --model detections`: presence-only files in, tracks and missed pings out."""

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
from maloc.predict import read_tracks

START = 1_622_548_800 * 10**9
XY = np.array([[x, y] for x in (0.0, 200.0, 400.0, 600.0) for y in (0.0, 200.0)])
SCALE, P0 = 110.0, 0.9


def track(out: Path, *args):
    return CliRunner().invoke(app, ["track", *map(str, args), "--out", str(out)])


def study(folder: Path, *, n=24, whole=True, clock=3.0, seed=0) -> dict:
    """Files of two tags, one swimming through the array, and the truth."""
    rng = np.random.default_rng(seed)
    rows, truth = ["time,receiver,tag"], {}
    off = rng.uniform(-clock, clock, len(XY))
    for k, tag in enumerate(("A69-1-11", "A69-1-12")):
        time = 30 + np.cumsum(rng.uniform(20, 40, n))
        place = np.column_stack([np.linspace(0, 600, n), 100 + 60 * np.sin(np.arange(n) / 4 + k)])
        away = np.linalg.norm(place[:, None] - XY[None], axis=-1)
        heard = rng.random(away.shape) < P0 * np.exp(-0.5 * (away / SCALE) ** 2)
        if k == 0:
            heard[[3, 7, 8]] = False  # collisions
        truth[tag] = {"time": time, "place": place, "heard": heard}
        for i, j in np.argwhere(heard):
            ns = START + int(1e9 * (time[i] + off[j]))
            ns = ns // 10**9 * 10**9 if whole else ns
            stamp = np.datetime_as_string(np.datetime64(ns, "ns"), "s" if whole else "ms")
            rows.append(f"{stamp}Z,R{j},{tag}")
    (folder / "detections.csv").write_text("\n".join(rows) + "\n")
    places = [f"R{j},{x},{y}" for j, (x, y) in enumerate(XY)]
    (folder / "receivers.csv").write_text("\n".join(["receiver,x,y", *places]) + "\n")
    return truth


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One run with the interval given: folder, truth, what was said."""
    folder = tmp_path_factory.mktemp("study")
    truth = study(folder)
    files = [folder / "detections.csv", "--receivers", folder / "receivers.csv"]
    how = ["--model", "detections", "--interval", 20, 40, "--movement", "rw", "--draws", 200]
    result = track(folder / "out", *files, *how)
    assert result.exit_code == 0, result.output + result.stderr
    return folder / "out", truth, result


def test_every_promised_file_is_there(run):
    out, _, result = run
    assert {p.name for p in out.iterdir()} == {
        "track.csv", "arrivals.csv", "parameters.csv", "missed.csv", "posterior.nc", "map.png",
        "diagnostics.png", "summary.json",
    }  # fmt: skip
    assert "A69-1-11: " in result.stdout and "A69-1-12: " in result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert summary["model"] == "unknown_interval"
    assert any("whole seconds: enough" in text for text in summary["notices"])
    assert set(summary["tags"]) == {"A69-1-11", "A69-1-12"}


@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning")
def test_the_posterior_holds_pings_and_their_rows(run):
    """States inside gaps stand apart; each ping's mean is its row's, and LOO is by ping."""
    out, truth, _ = run
    table = pl.read_csv(out / "track.csv")
    data = maloc.infer.read_posterior(out / "posterior.nc")
    tree = data.to_datatree() if hasattr(data, "to_datatree") else data
    posterior, unheard = tree["posterior"].to_dataset(), tree["unheard"].to_dataset()
    heard = {tag: int(known["heard"].any(axis=1).sum()) for tag, known in truth.items()}
    assert posterior.sizes["ping"] == sum(heard.values()) == table["heard"].sum()
    assert tree["between"].sizes["state"] > 0
    assert sorted([*posterior["row"].values, *unheard["unheard"].values]) == [*range(len(table))]
    rows = table[posterior["row"].values.tolist()]
    mean = posterior["position"].mean(("chain", "draw")).sel(axis="x").values
    sd = rows["sd_x"].to_numpy()
    assert (np.abs(mean - rows["x"].to_numpy()) < 5 * sd / np.sqrt(posterior.sizes["draw"])).all()
    assert rows["tag"].to_list() == posterior["ping_tag"].values.tolist()
    assert rows["ping"].to_list() == posterior["number"].values.tolist()
    seconds = posterior["time"].values.astype("datetime64[ns]").astype(np.int64) / 1e9
    np.testing.assert_allclose(seconds, rows["t"], atol=1e-5)
    missed = table[unheard["unheard"].values.tolist()]
    assert not missed["heard"].any() and missed["ping"].null_count() == len(missed)
    np.testing.assert_allclose(unheard["position"].sel(axis="y"), missed["y"], atol=1e-3)
    assert az.loo(data).n_data_points == len(rows)
    for track_of_tag in read_tracks(out):
        mine = posterior["ping_tag"].values == track_of_tag.tag
        wanted, path = posterior["track"].values[0][:, mine], track_of_tag.path.state[:, :, 0]
        assert path.shape[1] > mine.sum()  # with the states between
        assert all(
            (path == at[:, None]).all(axis=2).any(axis=1).all() for at in wanted.swapaxes(0, 1)
        )


def test_heard_pings_are_placed_within_their_uncertainty(run):
    out, truth, _ = run
    table = pl.read_csv(out / "track.csv")
    inside = []
    for tag, known in truth.items():
        rows = known["heard"].any(axis=1)
        found = table.filter((pl.col("tag") == tag) & pl.col("heard"))
        assert len(found) == rows.sum()
        np.testing.assert_allclose(
            found["t"].to_numpy() - START / 1e9, known["time"][rows], atol=6.5
        )
        assert found["n_receivers"].to_list() == known["heard"][rows].sum(axis=1).tolist()
        for axis, true in zip("xy", known["place"][rows].T, strict=True):
            low, high = (found[f"{axis}_{end}"].to_numpy() for end in ("lo", "hi"))
            inside.append((low <= true) & (true <= high))
            assert np.abs(found[axis].to_numpy() - true).mean() < 60
    assert np.mean(np.concatenate(inside)) > 0.85


def test_missed_pings_are_counted_and_placed(run):
    out, truth, _ = run
    gaps, table = pl.read_csv(out / "missed.csv"), pl.read_csv(out / "track.csv")
    for tag, known in truth.items():
        rows = np.flatnonzero(known["heard"].any(axis=1))
        mine = gaps.filter(pl.col("tag") == tag)
        missed = np.diff(rows) - 1
        assert len(mine) == len(missed) and not mine["outside"].any()
        assert ((mine["least"].to_numpy() <= missed) & (missed <= mine["most"].to_numpy())).all()
        for text, n in zip(mine["pmf"], missed, strict=True):
            pmf = {int(k): float(p) for k, p in (part.split(":") for part in text.split())}
            assert pmf.get(int(n), 0.0) > 0.01
            assert abs(sum(pmf.values()) - 1) < 0.01
        assert abs(mine["mean"].sum() - missed.sum()) < 2
        unheard = table.filter((pl.col("tag") == tag) & ~pl.col("heard"))
        assert len(unheard) == mine["n"].sum()
        assert (table.filter(pl.col("tag") == tag)["t"].diff().drop_nulls() > 0).all()


def test_every_detection_is_accounted_for(run):
    out, truth, _ = run
    arrivals = pl.read_csv(out / "arrivals.csv")
    heard = sum(int(known["heard"].sum()) for known in truth.values())
    assert len(arrivals) == heard == arrivals["detection"].n_unique()
    assert arrivals["used"].sum() + len(arrivals.filter(pl.col("why").is_not_null())) == heard


def test_heard_pings_alone_where_no_interval_is_given(tmp_path):
    truth = study(tmp_path, n=12, whole=False, clock=0.0, seed=3)
    files = [tmp_path / "detections.csv", "--receivers", tmp_path / "receivers.csv"]
    how = ["--model", "detections", "--tag", "11", "--movement", "rw", "--no-loss", "--draws", 100]
    result = track(tmp_path / "out", *files, *how)
    assert result.exit_code == 0, result.output + result.stderr
    table = pl.read_csv(tmp_path / "out" / "track.csv")
    known = truth["A69-1-11"]
    rows = known["heard"].any(axis=1)
    assert table["heard"].all() and len(table) == rows.sum()
    assert not (tmp_path / "out" / "missed.csv").exists()
    error = table.select("x", "y").to_numpy() - known["place"][rows]
    assert np.linalg.norm(error, axis=1).mean() < 90
    names = pl.read_csv(tmp_path / "out" / "parameters.csv")["name"].to_list()
    assert "p0" in names and "scale" in names and "p_lost" not in names


@pytest.mark.extended
def test_case_of_missed_pings_at_whole_seconds(shared_dir, tmp_path):
    case = shared_dir / "cases" / "11-burst-240-360-missed"
    text = (case / "vue.csv").read_text().splitlines()
    whole = [text[0], *(f"{row[:19]}{row[23:]}" for row in text[1:])]
    (tmp_path / "whole.csv").write_text("\n".join(whole) + "\n")
    args = [tmp_path / "whole.csv", "--receivers", case / "receivers.csv", "--interval", 240, 360]
    how = ["--model", "detections", "--movement", "rw", "--draws", 100]
    result = track(tmp_path / "out", *args, *how)
    assert result.exit_code == 0, result.output + result.stderr
    gaps, truth = pl.read_csv(tmp_path / "out" / "missed.csv"), pl.read_csv(case / "truth.csv")
    assert gaps["least"].to_list() == truth["min_missed"].to_list()
    assert gaps["most"].to_list() == truth["max_missed"].to_list()
    assert not gaps["outside"].any()
    for text, n, sure in zip(gaps["pmf"], truth["true_missed"], truth["determined"], strict=True):
        pmf = {int(k): float(p) for k, p in (part.split(":") for part in text.split())}
        assert pmf[n] > (0.99 if sure else 0.02)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--sound-speed", 1480], ["--sound-speed", "--model detections"]),
        (["--tag", "99"], ["no tag '99'"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(args, words, tmp_path):
    study(tmp_path, clock=60.0)
    files = [tmp_path / "detections.csv", "--receivers", tmp_path / "receivers.csv"]
    result = track(tmp_path / "out", *files, "--model", "detections", *args)
    assert result.exit_code == 2 and not (tmp_path / "out").exists()
    errors = result.stderr.splitlines()
    assert len(errors) == 1 and all(word in errors[0] for word in words), errors


def test_whole_seconds_name_the_way_out(tmp_path):
    study(tmp_path)
    files = [tmp_path / "detections.csv", "--receivers", tmp_path / "receivers.csv"]
    result = track(tmp_path / "out", *files)
    assert result.exit_code == 2 and "--model detections" in result.stderr
    checked = CliRunner().invoke(app, ["check", str(files[0])])
    assert "--model detections" in checked.output
