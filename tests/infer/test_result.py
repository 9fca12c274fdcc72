"""What a fit gives: tables, residuals, InferenceData and files that other tools read."""

import arviz as az
import numpy as np
import pytest
import xarray as xr
from numpyro import handlers

import maloc
from maloc.infer import _export
from maloc.models import toa_track

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
                summary = az.summary({name: draws}, round_to="none").iloc[0]
                assert row["ess_bulk"] == pytest.approx(summary["ess_bulk"], rel=1e-6)
                assert row["ess_tail"] == pytest.approx(summary["ess_tail"], rel=1e-6)
                assert row["r_hat"] == pytest.approx(summary["r_hat"], rel=1e-6)
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
        data = fit.to_inference_data()
        assert isinstance(data, az.InferenceData)
        assert {"posterior", "log_likelihood", "observed_data", "constant_data"} <= set(
            data.groups()
        )
        assert data["posterior"]["track"].dims[:3] == ("chain", "draw", "ping")
        assert data["posterior"]["position"].dims == ("chain", "draw", "ping", "axis")
        assert data["posterior"]["sigma"].dims == ("chain", "draw")
        for name, value in fit.draws().items():
            np.testing.assert_array_equal(data["posterior"][name], value)
        summary = az.summary(data, var_names=PARAMETERS)
        assert sorted(summary.index) == PARAMETERS
        assert np.isfinite(summary["mean"]).all()

    def test_sample_stats(self, sampled_fit):
        stats = sampled_fit.to_inference_data()["sample_stats"]
        assert stats["diverging"].dims == ("chain", "draw")
        assert stats["n_steps"].min() >= 1
        assert 0.5 < stats["acceptance_rate"].mean() <= 1
        np.testing.assert_array_equal(stats["energy"], sampled_fit.stats["potential"])

    @pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto:UserWarning")
    def test_loo(self, fit):
        loo = az.loo(fit.to_inference_data(), pointwise=True)
        assert loo.n_data_points == np.asarray(fit.args[0].heard).sum()
        assert np.isfinite(loo.elpd_loo)
        assert 2 < loo.p_loo < 60  # five numbers a ping, most of them held by the data

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

    def test_netcdf_round_trip(self, fit, tmp_path):
        """What ``posterior.nc`` holds is read by xarray and by ArviZ, values and groups."""
        path = tmp_path / "posterior.nc"
        tree = fit.to_datatree()
        tree.to_netcdf(path, engine="h5netcdf")
        with xr.open_datatree(path, engine="h5netcdf") as back:
            assert set(back.children) == set(tree.children)
            assert back["posterior"].attrs["inference_library"] == "maloc"
            assert back["posterior"].attrs["method"] == fit.method
            assert back["posterior"].attrs["inference_library_version"] == maloc.__version__
            for name, value in fit.draws().items():
                np.testing.assert_array_equal(back["posterior"][name], value)
        read = az.from_netcdf(path)
        np.testing.assert_array_equal(read["posterior"]["w"], fit.draws()["w"])
        np.testing.assert_array_equal(read["log_likelihood"]["arrival"], fit.pointwise()["arrival"])
        assert len(az.summary(read, var_names=PARAMETERS)) == 4

    def test_models_without_arrivals(self, fixes_fit, tmp_path):
        data = fixes_fit.to_inference_data()
        assert data["posterior"]["track"].shape == (1, 1000, 14, 2)
        assert data["log_likelihood"]["fix"].shape == (1, 1000, 28)
        assert "constant_data" not in data.groups()
        assert set(_export.to_datatree(fixes_fit).children) >= {"posterior", "log_likelihood"}
