"""The interface of the README, its engines, and their way to ArviZ, on the versions installed."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import maloc
from maloc.model_data import to_model_data


@pytest.fixture(scope="module")
def nuts(laplace):
    from maloc._jax import jax

    how = {"chains": 2, "draws": 100, "warmup": 100, "progress": False}
    return maloc.infer.nuts(jax.random.key(0), laplace, **how)


@pytest.fixture(scope="module")
def svi(laplace):
    from maloc._jax import jax

    return maloc.infer.svi(jax.random.key(0), laplace, progress=False)


@pytest.fixture(scope="module", params=["laplace", "nuts", "svi"])
def fit(request):
    return request.getfixturevalue(request.param)


def test_engines_agree(laplace, fit):
    """To a third of a standard deviation, of the median ping."""
    mean, covariance = laplace.moments()
    other, _ = fit.moments()
    sd = np.sqrt(np.einsum("tii->ti", covariance))[:, :2]
    assert np.median(np.abs(other - mean)[:, :2] / sd) < 1 / 3


def test_k_hat_is_a_number(svi):
    assert -1.0 < svi.k_hat < 3.0


def test_summary_of_the_fit(fit):
    assert "sigma" in fit.summary()
    assert {row["name"] for row in fit.parameters()} >= {"sigma"}


def test_datatree(fit, tmp_path):
    tree = fit.to_datatree()
    assert isinstance(tree, xr.DataTree)
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "posterior.nc", engine="h5netcdf") as again:
        xr.testing.assert_equal(again["posterior"].to_dataset(), tree["posterior"].to_dataset())


def test_arviz_summary(fit):
    import arviz as az

    table = az.summary(fit.to_inference_data(), var_names=["sigma"])
    drawn = fit.draws()["sigma"]
    assert float(table["mean"].iloc[0]) == pytest.approx(drawn.mean(), rel=0.05)


# what ArviZ says of a few pings that each have a position of their own
@pytest.mark.filterwarnings("ignore:Estimated shape parameter:UserWarning")
def test_arviz_loo(fit):
    import arviz as az

    assert az.loo(fit.to_inference_data()).n_data_points == fit.n_states


@pytest.mark.filterwarnings("ignore:Estimated shape parameter:UserWarning")
def test_loo_by_ping(laplace):
    assert maloc.infer.loo_by_ping(laplace).n_data_points == laplace.n_states


def test_plots_take_a_fit_and_its_groups(laplace, study):
    from matplotlib import pyplot as plt
    from matplotlib.axes import Axes

    receivers = maloc.read_receivers(study / "receivers.csv")
    assert isinstance(maloc.plots.track(laplace, receivers), Axes)
    assert isinstance(maloc.plots.track(laplace.to_inference_data(), receivers), Axes)
    plt.close("all")


def test_numpyros_own_sampler_takes_a_model(toa):
    """Prior draws by NumPyro alone: the model is an ordinary one."""
    from numpyro.infer import Predictive

    from maloc._jax import jax

    drawn = Predictive(maloc.models.toa_track, num_samples=3)(jax.random.key(0), to_model_data(toa))
    assert np.isfinite(np.asarray(drawn["sigma"])).all() and len(drawn["sigma"]) == 3
