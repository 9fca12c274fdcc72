"""ArviZ of either generation takes what a fit gives: numbers and figures."""

from typing import Any

import arviz
import matplotlib.pyplot as plt
import numpy as np
import pytest

import maloc.infer
from maloc.infer import _arviz

az: Any = arviz  # two generations, of which type checkers see one
pytestmark = pytest.mark.filterwarnings(
    "ignore:Estimated shape parameter of Pareto:UserWarning",
    "ignore:The figure layout has changed to tight:UserWarning",
    "ignore:The inplace keyword in DataFrame",  # ArviZ 0.23's own, on pandas 3.1
    "ignore:Passing a dict or None as alias_mapping",  # and on Matplotlib 3.11
)
OLD = _arviz.has_inference_data()


@pytest.fixture(scope="module", params=["laplace", "nuts"])
def fit(request):
    return request.getfixturevalue({"laplace": "laplace_fit", "nuts": "sampled_fit"}[request.param])


@pytest.fixture(scope="module")
def data(fit):
    return fit.to_inference_data(predictive=True)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_intervals(fit, data):
    """HDI of a parameter: the narrowest interval that holds nine draws in ten, by sorting."""
    how = {"hdi_prob": 0.9} if OLD else {"prob": 0.9}
    found = az.hdi(data, var_names=["sigma"], **how)["sigma"].values
    draws = np.sort(fit.draws()["sigma"].ravel())
    n = int(np.floor(0.9 * len(draws)))
    k = np.argmin(draws[n:] - draws[: len(draws) - n])
    np.testing.assert_allclose(found, [draws[k], draws[k + n]], rtol=0.02)


def test_extract_finds_a_ping_by_its_names(fit, data):
    position = az.extract(data, var_names=["position"])
    found = position.sel(ping=7, axis="y")
    wanted = fit.draws()["position"][:, :, 5, 1]  # the fifth ping was heard by nobody
    assert sorted(found.values) == sorted(wanted.ravel())


def test_loo_and_compare(fit, data):
    if OLD:
        one, other = az.loo(data, pointwise=True), maloc.infer.loo_by_ping(fit, 30)
    else:
        one, other = az.loo(data), maloc.infer.loo_by_ping(fit, 30)
    assert one.n_data_points == other.n_data_points == 12
    table = az.compare({"conditional": one, "by ping": other})
    assert set(table.index) == {"conditional", "by ping"}


def test_figures(fit, data):
    names = fit.parameter_names
    az.plot_trace(data, var_names=names)
    az.plot_pair(data, var_names=names[:2])
    az.plot_forest(data, var_names=names)
    if OLD:
        az.plot_ppc(data, num_pp_samples=20)
    else:
        az.plot_ppc_dist(data, num_samples=20)
    if fit.method == "nuts":
        az.plot_energy(data)
    assert len(plt.get_fignums()) == 4 + (fit.method == "nuts")
