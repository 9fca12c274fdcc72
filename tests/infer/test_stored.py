"""A run's folder holds all that a prediction needs: what is read back is what the fit had."""

import json
from types import SimpleNamespace

import numpy as np
import numpyro
import numpyro.distributions as dist
import polars as pl
import pytest
import xarray as xr
from typer.testing import CliRunner

import maloc.infer
from maloc._jax import jnp
from maloc.cli import app
from maloc.errors import InputError
from maloc.infer._export import write_posterior
from maloc.infer._paths import path_draws
from maloc.infer._stored import movement_group
from maloc.movement import OU
from maloc.predict import prediction_table, read_tracks, regular_times
from maloc.runs.predict import run_predict
from maloc.world.statespace import SoftBox
from tests.infer import cases

ORIGIN = 1_700_000_000_250_000_000  # ns: a quarter of a second past a whole one
CRS = "EPSG:32632"


@pytest.fixture(scope="module")
def run(laplace_fit, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_posterior(laplace_fit, folder / "posterior.nc", ["A"], ORIGIN, CRS)
    return folder


def same(read, path):
    assert read.law is path.law
    np.testing.assert_array_equal(read.state, path.state)
    np.testing.assert_allclose(read.clock, path.clock, rtol=1e-14)
    for name, value in path.scale.items():
        np.testing.assert_array_equal(read.scale[name], value)
    assert (read.home is None) == (path.home is None)
    if path.home is not None:
        np.testing.assert_array_equal(read.home, path.home)


def test_what_is_read_is_what_was_fitted(run, laplace_fit):
    (track,) = read_tracks(run)
    assert (track.tag, track.origin, track.crs, track.method) == ("A", ORIGIN, CRS, "laplace")
    same(track.path, path_draws(laplace_fit))
    times = np.linspace(*track.span, 9)
    found, wanted = track.predict(times), laplace_fit.predict(times)
    # the mixture of a thousand draws beside the normal law itself
    error = wanted.sd / np.sqrt(1000)
    assert (np.abs(found.position - wanted.position) < 5 * error).all()
    np.testing.assert_allclose(found.sd, wanted.sd, rtol=0.15)
    tracks = track.sample_tracks(times, 30)
    assert tracks.position.shape == (30, 9, 2) and tracks.origin == ORIGIN


def two_homes(dt, tag, observed):
    """Two tags end to end around homes of their own, the second ranging wider."""
    homes = jnp.asarray(numpyro.sample("homes", dist.Normal(0, 20).expand([2, 2]).to_event(2)))
    sd = numpyro.sample("sd", dist.LogNormal(1.0, 0.5)) * jnp.array([1.0, 2.0])
    track = numpyro.sample("track", OU(dt, sd, 6.0, homes, tag=tag))
    numpyro.sample("fix", dist.Normal(track, 0.7), obs=observed)


def test_several_tags_each_with_parameters_of_its_own(tmp_path):
    dt, observed = cases.fixes_data()
    fit = maloc.infer.laplace(two_homes, dt, jnp.asarray([0] * 6 + [1] * 8), observed, draws=50)
    write_posterior(fit, tmp_path / "posterior.nc", ["A", "B"], None, None)
    tracks = read_tracks(tmp_path)
    assert [t.tag for t in tracks] == ["A", "B"]
    for k, track in enumerate(tracks):
        assert track.origin is None and track.crs is None
        assert track.path.state.shape == (50, (6, 8)[k], 1, 2)
        same(track.path, path_draws(fit, k))
    first, second = (t.path for t in tracks)
    np.testing.assert_allclose(second.scale["sd"], 2 * first.scale["sd"])
    assert first.home is not None and second.home is not None
    assert (np.abs(first.home - second.home).mean(axis=0) > 0.1).all()


def test_without_movement_there_is_nothing_to_predict_by(tmp_path):
    still = SimpleNamespace(cm=SimpleNamespace(chain=[SimpleNamespace(law=SoftBox)]))
    assert movement_group(still, np.ones(1, bool)) is None  # pyright: ignore[reportArgumentType]
    xr.Dataset().to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="no movement to predict by"):
        read_tracks(tmp_path)
    with pytest.raises(InputError, match=r"posterior\.nc"):
        read_tracks(tmp_path / "nothing")


def test_regular_times_are_whole_multiples_of_utc():
    np.testing.assert_allclose(regular_times(-25.0, 31.0, 10.0), [-20, -10, 0, 10, 20, 30])
    found = regular_times(3.0, 200.0, 60.0, ORIGIN)
    seconds = ORIGIN / 1e9 + found
    np.testing.assert_allclose(seconds / 60, np.round(seconds / 60), atol=1e-7)
    assert found[0] >= 3.0 > found[0] - 60 and found[-1] <= 200.0 < found[-1] + 60
    for every in (0.0, np.nan):
        with pytest.raises(InputError, match="no number of seconds"):
            regular_times(0.0, 1.0, every)
    with pytest.raises(InputError, match="ten million"):
        regular_times(0.0, 1e9, 1.0)


def test_the_command_writes_a_grid_and_whole_tracks(run, tmp_path):
    out = tmp_path / "out"
    lines = run_predict(run, out, 20.0, around=(50.0, 100.0), draws=7, quiet=True)
    assert len(lines) == 1 and lines[0].startswith("A: ")
    table = pl.read_csv(out / "predicted.csv")
    (track,) = read_tracks(run)
    assert table["t"][0] >= ORIGIN / 1e9 + track.span[0] - 50
    assert table["t"][-1] <= ORIGIN / 1e9 + track.span[1] + 100
    np.testing.assert_allclose(np.diff(table["t"]), 20.0)
    assert table["time"][0].endswith("0.000000Z")
    times = table["t"].to_numpy() - ORIGIN / 1e9
    found = track.predict(times)
    np.testing.assert_allclose(table["x"], found.position[:, 0], atol=2e-3)
    np.testing.assert_allclose(table["sd_y"], found.sd[:, 1], atol=2e-3)
    np.testing.assert_array_equal(table["within"], found.within)
    assert not table["within"][0] and not table["within"][-1] and table["within"].any()
    np.testing.assert_allclose((table["x_hi"] - table["x"]) / table["sd_x"], 1.96, atol=0.01)
    degrees = table.select("longitude", "latitude").to_numpy()
    assert np.isfinite(degrees).all()
    draws = pl.read_parquet(out / "draws.parquet")
    assert len(draws) == 7 * len(table) and draws["draw"].n_unique() == 7
    np.testing.assert_allclose(draws.filter(pl.col("draw") == 3)["t"], table["t"], atol=1e-6)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["crs"] == CRS and summary["options"]["every"] == 20.0
    with pytest.raises(InputError, match="exists already"):
        run_predict(run, out, 20.0, quiet=True)
    with pytest.raises(InputError, match="no multiple of"):
        run_predict(run, tmp_path / "coarse", 1e6, quiet=True)
    assert not (tmp_path / "coarse").exists()


def test_intervals_of_a_sampled_fit_are_its_quantiles(sampled_fit, tmp_path):
    write_posterior(sampled_fit, tmp_path / "posterior.nc", [""], None, None)
    (track,) = read_tracks(tmp_path)
    times = np.linspace(*track.span, 5)
    table = prediction_table(track, times)
    drawn = track.sample_tracks(times, 1000).position
    np.testing.assert_allclose(table["y_lo"], np.quantile(drawn[..., 1], 0.025, axis=0))
    assert table["time"].null_count() == 5 and "longitude" not in table.columns


def test_the_commands_say_what_they_wrote(run, tmp_path):
    """From a run to a grid to GPX by the command line; bad input is one line and exit code 2."""
    cli = CliRunner()
    grid, gpx = str(tmp_path / "grid"), str(tmp_path / "a.gpx")
    done = cli.invoke(app, ["predict", str(run), "--every", "30", "--draws", "0", "--out", grid])
    assert done.exit_code == 0 and "A: " in done.output and "grid" in done.output
    assert not (tmp_path / "grid" / "draws.parquet").exists()
    done = cli.invoke(app, ["export", grid, "--to", "gpx", "--out", gpx])
    assert done.exit_code == 0 and "rows written to a.gpx" in done.output
    for wrong in (
        ["export", grid, "--to", "kml", "--out", gpx],
        ["export", grid, "--to", "imputations", "--out", gpx, "--force"],
        ["predict", grid, "--every", "30", "--out", str(tmp_path / "b")],
        ["predict", str(run), "--every", "30", "--before", "-1", "--out", str(tmp_path / "b")],
    ):
        assert cli.invoke(app, wrong).exit_code == 2, wrong
