"""A law that tags share against brute force, and fits of several tags under it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import maloc
from maloc.errors import FitError, InputError
from maloc.infer import _population as law
from maloc.infer import trust
from maloc.model_data import to_model_data
from tests.infer import cases

HOW = {"movement": "rw", "error": "gaussian", "progress": False}


def test_the_law_by_brute_force():
    rng = np.random.default_rng(0)
    z, sd = rng.normal(0.4, 0.5, 12), rng.uniform(0.1, 0.6, 12)
    prior = law.Law(np.array([0.0]), np.array([1.5]))
    sites = [law.Site(np.array([m]), np.array([[s**-2]])) for m, s in zip(z, sd, strict=True)]
    mean, covariance = law.learn_population(sites, prior)
    mu, log_tau = np.meshgrid(np.linspace(-1, 2, 301), np.linspace(-4, 2, 301), indexing="ij")
    total = np.sqrt(sd**2 + np.exp(2 * log_tau)[..., None])
    density = stats.norm.logpdf(z, mu[..., None], total).sum(axis=-1)
    density += stats.norm.logpdf(mu, 0.0, 1.5) + stats.norm.logpdf(log_tau, *law.TAU)
    best = np.unravel_index(density.argmax(), density.shape)
    assert abs(mean[0] - mu[best]) < 0.01 and abs(mean[1] - log_tau[best]) < 0.02
    weight = np.exp(density - density.max())
    middle = (weight * mu).sum() / weight.sum()
    spread = np.sqrt((weight * (mu - middle) ** 2).sum() / weight.sum())
    assert abs(np.sqrt(covariance[0, 0]) / spread - 1) < 0.15


def test_the_expected_law_is_the_expected_log_density():
    rng = np.random.default_rng(1)
    mean = np.array([0.2, -0.9])
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    mu, log_tau = rng.multivariate_normal(mean, covariance, 400_000).T
    one = law.expected_law(mean, covariance)
    wanted = [stats.norm.logpdf(v, mu, np.exp(log_tau)).mean() for v in (-1.0, 0.3, 1.4)]
    found = stats.norm.logpdf([-1.0, 0.3, 1.4], one.loc, one.scale)
    np.testing.assert_allclose(np.diff(found), np.diff(wanted), rtol=0.02)


def test_sites_and_reweighting_are_exact_for_normals():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    data, at = root @ root.T + np.eye(3), rng.normal(size=3)  # precision of the likelihood, mode
    old = law.Law(np.array([0.5, -0.2]), np.array([1.0, 2.0]))
    new = law.Law(np.array([1.5, 0.3]), np.array([0.3, 0.5]))
    rows = np.array([2, 0])

    def posterior(under):
        weight, middle = np.zeros(3), np.zeros(3)
        weight[rows], middle[rows] = under.scale**-2, under.loc
        covariance = np.linalg.inv(data + np.diag(weight))
        return covariance @ (data @ at + weight * middle), covariance

    u, covariance = posterior(old)
    moved = law.reweighted(u, covariance, rows, old, new)
    for a, b in zip(moved, posterior(new), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    site = law.site_of(u[rows], covariance[np.ix_(rows, rows)], old)
    margin = np.linalg.inv(np.linalg.inv(data)[np.ix_(rows, rows)])
    np.testing.assert_allclose(site.precision, margin, rtol=1e-9)
    np.testing.assert_allclose(site.mean, at[rows], rtol=1e-9)


def test_k_hat_of_a_narrow_and_of_a_right_approximation():
    rng = np.random.default_rng(3)
    x = rng.normal(size=2000)
    assert trust.k_hat(stats.norm.logpdf(x, 0.05, 1.0) - stats.norm.logpdf(x)) < 0.5
    assert trust.k_hat(stats.cauchy.logpdf(x, 0, 3.0) - stats.norm.logpdf(x)) > trust.K_BAD


@pytest.fixture(scope="module")
def toas():
    found = [cases.toa(seed=i, pings=13)[0].replace(tag=f"T{i}") for i in range(4)]
    return found


def test_several_tags_under_a_law(toas, monkeypatch):
    found = toas
    from maloc.infer import _tags

    usual = _tags.laplace

    def laplace(model, data, *args, **how):
        if np.asarray(data.time)[0] == np.asarray(to_model_data(found[1]).time)[0]:
            raise FitError("no")
        return usual(model, data, *args, **how)

    alone = maloc.tags.fit(found[:1], hierarchical=("sigma_step",), **HOW)
    monkeypatch.setattr(_tags, "laplace", laplace)
    fits = maloc.tags.fit(found, hierarchical=("sigma_step",), method="svi", steps=50, **HOW)
    assert fits.failed == {"T1": "no"} and set(fits.fits) == {"T0", "T2", "T3"}
    assert fits.trace.shape == (50,) and np.isfinite(fits.trace).all()
    row = fits.population()[0]
    assert row["name"] == "sigma_step" and row["median_low"] < row["median"] < row["median_high"]
    cm = fits.fits["T0"].cm
    k = next(s.place.start for s in cm.globals if s.name == "sigma_step")
    values = [f.flat_draws()[1][0, :, k] for f in fits.fits.values()]
    raw = [alone.fits["T0"].flat_draws()[1][0, :, k]]
    assert values[0].std() < raw[0].std()  # it borrows
    checks = fits.checks(draws=100)
    assert all(0.02 < row["p"] < 0.98 and np.isfinite(row["k_hat"]) for row in checks)


def test_what_cannot_be(toas):
    found = toas
    with pytest.raises(InputError, match="all different"):
        maloc.tags.fit([found[0], found[0]], **HOW)
    with pytest.raises(InputError, match="'w' is no parameter"):
        maloc.tags.fit(found, hierarchical=("w",), **HOW)
    with pytest.raises(InputError, match="neither"):
        maloc.tags.fit(found, method="mcmc", **HOW)
