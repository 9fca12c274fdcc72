"""What a fit gives: tables, residuals, InferenceData and files that other tools read."""

import copy
import re

import arviz as az
import numpy as np
import polars as pl
import pytest
import xarray as xr
from numpyro import handlers
from numpyro.infer import Predictive
from scipy import stats

import maloc
from maloc._jax import jax, jnp
from maloc.errors import InputError
from maloc.infer import _arviz
from maloc.infer._paths import path_draws
from maloc.infer.track import track_table
from maloc.models import toa_track
from maloc.predict import read_tracks

PARAMETERS = ["sigma", "sigma_vel", "t05", "w"]


@pytest.fixture(params=["laplace", "nuts"])
def fit(request):
    return request.getfixturevalue({"laplace": "laplace_fit", "nuts": "sampled_fit"}[request.param])


class TestTables:
    def test_parameters(self, fit):
        rows = {row["name"]: row for row in fit.parameters()}
        assert sorted(rows) == PARAMETERS
        for name, row in rows.items():
            assert list(row) == "name mean sd q2.5 q97.5 ess_bulk ess_tail r_hat unit".split()
            draws = fit.draws()[name]
            assert row["mean"] == pytest.approx(draws.mean())
            assert row["q2.5"] == pytest.approx(np.quantile(draws, 0.025))
            assert row["q2.5"] < row["mean"] < row["q97.5"]
            if fit.method == "laplace":
                assert row["ess_bulk"] is row["ess_tail"] is row["r_hat"] is None
            else:
                data = xr.Dataset({name: (("chain", "draw"), draws)})
                wanted = {
                    "ess_bulk": az.ess(data, method="bulk"),
                    "ess_tail": az.ess(data, method="tail", prob=(0.05, 0.95)),
                    "r_hat": az.rhat(data, method="rank"),
                }
                for column, found in wanted.items():
                    assert row[column] == pytest.approx(float(found[name]), rel=1e-6), column
        text = fit.summary()
        assert all(name in text for name in PARAMETERS)

    def test_repr(self, fit):
        assert "toa_track, 12 states, 4 parameters" in repr(fit)
        assert repr(fit).startswith({"laplace": "LaplaceFit"}.get(fit.method, "SampledFit"))
        stages = {"laplace": {"prepare", "initial", "parameters"}}.get(fit.method, {"sampling"})
        assert stages <= set(fit.seconds)
        assert all(s["wall"] >= 0 and s["cpu"] >= 0 for s in fit.seconds.values())


class TestResiduals:
    def test_pointwise(self, toa, fit):
        """Log density of each heard arrival, recomputed from the model one draw at a time."""
        data = fit.args[0]
        values = fit.pointwise()
        assert list(values) == ["arrival"]
        heard = np.asarray(data.heard)
        assert values["arrival"].shape[2] == heard.sum() == toa[0].heard.sum()
        x, u = fit.flat_draws()
        for chain, draw in ((0, 0), (-1, 17)):
            sites, _ = fit.cm.sites(x[chain, draw], u[chain, draw])
            model = handlers.substitute(toa_track, data=sites)
            law = handlers.trace(model).get_trace(data)["arrival"]["fn"].base_dist
            wanted = np.asarray(law.log_prob(data.range))[heard]
            np.testing.assert_allclose(values["arrival"][chain, draw], wanted, rtol=1e-9)

    def test_residuals_and_p_direct(self, toa, fit):
        times, emission, position = toa
        heard = np.delete(times.heard, 4, axis=0)
        residual, direct = fit.residuals(), fit.p_direct()
        np.testing.assert_array_equal(np.isfinite(residual), heard)
        np.testing.assert_array_equal(np.isfinite(direct), heard)
        xy = np.column_stack([times.receivers.x, times.receivers.y])
        travel = np.linalg.norm(position[:, None] - xy, axis=-1) / times.sound_speed[:, None]
        truth = np.delete(times.toa - emission[:, None] - travel, 4, axis=0)
        late = heard & (truth > 5 / 1480)
        direct_heard = heard & (truth < 2 / 1480)
        assert late.any()
        assert (direct[late] < 0.5).all()
        assert (direct[direct_heard] > 0.5).all()
        assert np.abs(residual - truth)[heard].max() < 3 / 1480  # seconds


class TestExport:
    def test_inference_data(self, fit):
        """What the installed ArviZ works on: an InferenceData of 0.x, a DataTree of 1.x."""
        data = fit.to_inference_data()
        assert isinstance(data, az.InferenceData if _arviz.has_inference_data() else xr.DataTree)
        posterior = data["posterior"]
        assert posterior["track"].dims == ("chain", "draw", "ping", "part", "axis")
        assert posterior["position"].dims == ("chain", "draw", "ping", "axis")
        assert posterior["sigma"].dims == ("chain", "draw")
        for name, value in fit.draws().items():
            np.testing.assert_array_equal(posterior[name], value)
        assert list(posterior.data_vars)[:4] == fit.parameter_names
        assert sorted(fit.parameter_names) == posterior.attrs["parameters"] == PARAMETERS
        summary = az.summary(data, var_names=fit.parameter_names)
        assert sorted(summary.index) == PARAMETERS
        assert np.isfinite(summary["mean"].astype(float)).all()

    def test_a_row_of_the_posterior_is_a_row_of_the_track(self, toa, fit):
        """Found by the input's ping: x, its time, its row in track.csv; the unheard one apart."""
        tree, table = fit.to_datatree(), track_table(fit, toa[0])
        posterior = tree["posterior"].to_dataset()
        at = posterior.sel(ping=7, axis="x")
        row = table.row(by_predicate=pl.col("ping") == 7, named=True)
        mean, n = float(at["position"].mean()), at["position"].size
        assert abs(mean - row["x"]) < 5 * row["sd_x"] / np.sqrt(n) + 1e-9
        np.testing.assert_array_equal(at["track"].sel(part="position"), at["position"])
        assert at["row"] == table["ping"].to_list().index(7)
        assert float(at["time"]) == pytest.approx(row["t"], abs=0.01)
        assert posterior["ping"].values.tolist() == [1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13]
        unheard = tree["unheard"].to_dataset()
        rows = np.concatenate([posterior["row"], unheard["unheard"]])
        assert sorted(rows) == list(range(len(table)))
        (missed,) = unheard["unheard"].values
        assert unheard["ping"].values.tolist() == [5] == [table["ping"][int(missed)]]
        assert unheard["position"].sel(axis="y").item() == table["y"][int(missed)]
        assert posterior["position"].attrs["units"] == "m" == posterior["sigma"].attrs["units"]
        assert posterior["track"].attrs == {"units": "m", "units_of_velocity": "m/s"}
        assert posterior["emission_time"].attrs["units"] == "s" == posterior["time"].attrs["units"]
        assert tree["constant_data"]["receiver"].values.tolist() == list(toa[0].receivers.labels)

    def test_dates(self, laplace_fit, toa):
        """With an origin, times are UTC."""
        fit = copy.copy(laplace_fit)
        fit.source, fit._known = toa[0].replace(origin=1_700_000_000_250_000_000), {}
        time = fit.to_datatree()["posterior"]["time"]
        assert time.dtype == "datetime64[ns]"
        seconds = (time.values - np.datetime64("2023-11-14T22:13:20.25")) / np.timedelta64(1, "s")
        wanted = fit.draws()["emission_time"].mean(axis=(0, 1))
        np.testing.assert_allclose(seconds, wanted, atol=1e-9)

    def test_every_dimension_has_a_name(self, fit):
        for group in fit.to_datatree().children.values():
            for variable in group.data_vars.values():
                assert not any(re.search(r"dim_\d", str(d)) for d in variable.dims), variable.name

    def test_sample_stats(self, sampled_fit):
        stats = sampled_fit.to_inference_data()["sample_stats"]
        assert stats["diverging"].dims == ("chain", "draw")
        assert stats["n_steps"].min() >= 1
        assert 0.5 < stats["acceptance_rate"].mean() <= 1
        np.testing.assert_array_equal(stats["energy"], sampled_fit.stats["potential"])

    @pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning")
    def test_loo(self, fit):
        """An entry a ping, the sum over its arrivals."""
        data = fit.to_inference_data()
        heard = np.asarray(fit.args[0].heard)[:12]
        row = np.nonzero(heard)[0]
        value = data["log_likelihood"]["by_ping"].values
        for ping in (0, 4, 11):
            wanted = fit.pointwise()["arrival"][..., row == ping].sum(axis=-1)
            np.testing.assert_allclose(value[..., ping], wanted, rtol=1e-12)
        loo = az.loo(data, pointwise=True)
        assert loo.n_data_points == 12
        assert np.isfinite(loo.elpd_loo if hasattr(loo, "elpd_loo") else loo.elpd)
        by_value = fit.to_datatree(log_likelihood="value")["log_likelihood"]
        np.testing.assert_array_equal(by_value["arrival"], fit.pointwise()["arrival"])
        with pytest.raises(InputError, match="'ping' or 'value'"):
            fit.to_datatree(log_likelihood="arrival")

    def test_replicated_data_and_the_prior(self, toa, laplace_fit):
        """Replicates scatter about the model's arrivals as its law says; the prior is its own."""
        fit = laplace_fit
        tree = fit.to_datatree(predictive=True, log_prior=True)
        drawn = tree["posterior_predictive"]["arrival"]
        assert drawn.dims == ("chain", "draw", "detection")
        assert drawn.shape[2] == toa[0].heard.sum() == tree["observed_data"]["arrival"].size
        seen = tree["observed_data"]["arrival"].values
        sigma, w = (float(np.median(fit.draws()[k])) for k in ("sigma", "w"))
        spread = np.median(np.abs(drawn.values[0] - np.median(drawn.values[0], axis=0)))
        assert 0.3 * sigma < spread < 4 * sigma and w < 0.5
        inside = (np.quantile(drawn.values[0], 0.005, axis=0) < seen) & (
            seen < np.quantile(drawn.values[0], 0.995, axis=0)
        )
        assert inside.mean() > 0.9
        again = fit.to_datatree(predictive=True)["posterior_predictive"]["arrival"]
        np.testing.assert_array_equal(again, drawn)
        prior = tree["log_prior"]
        sigma = fit.draws()["sigma"]
        wanted = stats.lognorm.logpdf(sigma, 1.5, scale=2.0)
        np.testing.assert_allclose(prior["sigma"], wanted, rtol=1e-10)
        assert set(prior.data_vars) == {"sigma", "sigma_vel", "t05", "w", "track", "emission"}

    def test_numpyro_draws_data_of_a_model_that_is_told_so(self, laplace_fit):
        """Predictive returns what is observed as it is, and draws it of an unobserved model."""
        fit, data = laplace_fit, laplace_fit.args[0]
        draws = {k: jnp.asarray(fit.draws(40)[k][0]) for k in ("sigma", "sigma_vel", "t05", "w")}
        as_is = Predictive(toa_track, draws)(jax.random.key(0), data)["arrival"]
        assert (np.asarray(as_is) == np.asarray(data.range)).all()
        drawn = Predictive(maloc.infer.unobserved(toa_track), draws)(jax.random.key(0), data)
        assert drawn["arrival"].shape == as_is.shape and np.isfinite(drawn["arrival"]).all()
        assert len(np.unique(drawn["arrival"][:, 0, 0])) == 40

    def test_constant_data_says_where_each_detection_is(self, toa, laplace_fit):
        data = laplace_fit.to_inference_data()
        constant, observed = data["constant_data"], data["observed_data"]
        heard = np.delete(toa[0].toa, 4, axis=0)
        first = np.nanmin(heard, axis=1)
        rows, columns = constant["detection_ping"].values, constant["detection_receiver"].values
        wanted = (heard[rows, columns] - first[rows]) * 1480
        np.testing.assert_allclose(observed["arrival"], wanted, atol=1e-6)
        np.testing.assert_allclose(constant["first_arrival"], first)
        np.testing.assert_allclose(constant["receiver_xy"][:, 0], toa[0].receivers.x)

    @pytest.mark.parametrize("form", ["netcdf", "zarr 2", "zarr 3"])
    def test_round_trip(self, fit, tmp_path, form):
        """What is written is read by xarray and as ArviZ has it: values, names, groups."""
        path, tree = tmp_path / "posterior", fit.to_datatree()
        if form == "netcdf":
            tree.to_netcdf(path, engine="h5netcdf")
        else:
            tree.to_zarr(path, zarr_format=int(form[-1]), consolidated=form[-1] == "2")
        read = maloc.infer.read_posterior(path)
        back = read.to_datatree() if _arviz.has_inference_data() else read
        assert set(back.children) == set(tree.children)
        posterior = back["posterior"]
        assert posterior.attrs["inference_library"] == "maloc"
        assert posterior.attrs["method"] == fit.method
        assert posterior.attrs["inference_library_version"] == maloc.__version__
        for name, value in fit.draws().items():
            np.testing.assert_array_equal(posterior[name], value)
        for name in ("ping", "time", "heard", "row", "axis"):
            np.testing.assert_array_equal(posterior[name], tree["posterior"][name])
        assert len(az.summary(read, var_names=PARAMETERS)) == 4

    def test_what_arviz_writes_is_read(self, fit, tmp_path):
        path = tmp_path / "posterior.nc"
        data = fit.to_inference_data()
        data.to_netcdf(str(path), **({} if _arviz.has_inference_data() else {"engine": "h5netcdf"}))
        (track,) = read_tracks(tmp_path)
        np.testing.assert_array_equal(track.path.state, path_draws(fit).state)
        read = az.from_netcdf(path)
        np.testing.assert_array_equal(read["posterior"]["w"], fit.draws()["w"])
        with pytest.raises(InputError, match="cannot be read as a posterior"):
            maloc.infer.read_posterior(tmp_path / "nothing.nc")

    def test_models_without_arrivals(self, fixes_fit, tmp_path):
        data = fixes_fit.to_datatree()
        assert data["posterior"]["track"].dims == ("chain", "draw", "ping", "axis")
        assert data["posterior"]["track"].shape == (1, 1000, 14, 2)
        assert data["log_likelihood"]["by_ping"].shape == (1, 1000, 14)
        assert not {"constant_data", "unheard"} & set(data.children)


def test_arguments_in_the_wrong_order(toa, laplace_fit):
    with pytest.raises(TypeError, match="the model first, got a ArrivalTimes"):
        maloc.infer.laplace(toa[0], toa_track)
    for sampler in (maloc.infer.nuts, maloc.infer.svi):
        with pytest.raises(TypeError, match="the random key first"):
            sampler(toa_track, toa[0])
        with pytest.raises(TypeError, match="the random key first"):
            sampler(laplace_fit, toa_track)
