"""Mode, Laplace marginal and its maximum: exact where the model is linear and Gaussian."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import maloc.infer
from maloc._jax import jax, jnp
from maloc.infer._model import chain_model
from maloc.infer.marginal import _Marginal
from maloc.infer.mode import _factor, _row_sums, anneal, find_mode
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests import oracles
from tests.infer import cases

POINTS = [np.array([0.0, 0.0]), np.array([-0.7, 0.4]), np.array([0.9, -0.6])]


@pytest.fixture(scope="module")
def linear():
    args = cases.fixes_data()
    dt, observed = (np.asarray(a) for a in args)
    return chain_model(cases.fixes, {}, args), args, dt, observed


class TestLinearGaussian:
    @pytest.mark.parametrize("u", POINTS)
    def test_mode_is_the_posterior_mean(self, linear, u):
        cm, args, dt, observed = linear
        _, mean, covariance = oracles.fixes_posterior(dt, observed, u, cases.SPREAD)
        for method in ("exact", "gauss-newton", "robust"):
            mode = find_mode(cm, args, np.zeros((14, 2)), u, method=method, tol=1e-12)
            assert mode.converged
            assert mode.steps == 1
            np.testing.assert_allclose(mode.x, mean, atol=1e-9)

    @pytest.mark.parametrize("u", POINTS)
    def test_marginal_is_exact(self, linear, u):
        cm, args, dt, observed = linear
        point = _Marginal(cm, args, np.zeros((14, 2)), u, np.full(2, 0.1))(u)
        dense = oracles.fixes_log_posterior(u, dt, observed, cases.SPREAD)
        constant = 0.5 * observed.size * np.log(2 * np.pi)
        np.testing.assert_allclose(-point.value + constant, dense, rtol=1e-11)

        def function(u):
            return -oracles.fixes_log_posterior(u, dt, observed, cases.SPREAD)

        for i, e in enumerate(np.eye(2)):
            above, below = function(u + 1e-4 * e), function(u - 1e-4 * e)
            np.testing.assert_allclose(
                point.gradient[i], (above - below) / 2e-4, rtol=2e-4, atol=2e-3
            )
            above, below = function(u + 1e-3 * e), function(u - 1e-3 * e)
            curvature = (above + below - 2 * function(u)) / 1e-6
            np.testing.assert_allclose(point.curvature[i], curvature, rtol=2e-3)
            # how the mode moves with the parameters
            above, below = (
                oracles.fixes_posterior(dt, observed, u + s * e, cases.SPREAD)[1]
                for s in (1e-5, -1e-5)
            )
            np.testing.assert_allclose(point.slope[i], (above - below) / 2e-5, atol=1e-6)

    def test_fit(self, linear, fixes_fit):
        """Maximum, covariance of the parameters, and moments given them, all dense."""
        _, _, dt, observed = linear

        def function(u):
            return -oracles.fixes_log_posterior(u, dt, observed, cases.SPREAD)

        best = minimize(function, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-6}).x
        m = fixes_fit.marginal
        assert m.converged
        assert fixes_fit.warnings == ()
        h, hessian = 1e-3, np.zeros((2, 2))
        for i, a in enumerate(h * np.eye(2)):
            for j, b in enumerate(h * np.eye(2)):
                same = function(best + a + b) + function(best - a - b)
                other = function(best + a - b) + function(best - a + b)
                hessian[i, j] = (same - other) / (4 * h * h)
        covariance = np.linalg.inv(hessian)
        sd = np.sqrt(np.diag(covariance))
        assert (np.abs(m.u - best) < 0.05 * sd).all()  # it stops at a twentieth of an sd
        np.testing.assert_allclose(
            m.covariance / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=0.1
        )
        _, mean, given = oracles.fixes_posterior(dt, observed, m.u, cases.SPREAD)
        np.testing.assert_allclose(m.x, mean, atol=1e-5)
        covariances = m.factor.covariances()
        np.testing.assert_allclose(covariances[:, 0, 0], np.diag(given), rtol=1e-9)
        np.testing.assert_allclose(covariances[:, 1, 1], np.diag(given), rtol=1e-9)
        np.testing.assert_allclose(covariances[:, 0, 1], 0.0, atol=1e-12)
        # total: that, and the parameters' share
        x, total = fixes_fit.moments()
        np.testing.assert_allclose(x, m.x)
        share = np.einsum("kti,kl,ltj->tij", m.slope, m.covariance, m.slope)
        np.testing.assert_allclose(total, covariances + share, rtol=1e-12)

    def test_draws_have_the_moments(self, fixes_fit):
        """Means within 5 and variances within 6 standard errors: a false alarm once in 1e5."""
        n = 20_000
        x, u = fixes_fit.flat_draws(n, seed=3)
        assert x.shape == (1, n, 14, 2)
        mean, covariance = fixes_fit.moments()
        variance = np.einsum("tii->ti", covariance)
        error = (x[0].mean(0) - mean) / np.sqrt(variance / n)
        assert np.abs(error).max() < 5
        assert np.abs(x[0].var(0) / variance - 1).max() < 6 * np.sqrt(2 / n)
        np.testing.assert_allclose(np.cov(u[0].T), fixes_fit.marginal.covariance, rtol=0.1)
        again, _ = fixes_fit.flat_draws(n, seed=3)
        np.testing.assert_array_equal(x, again)
        natural = fixes_fit.draws(50, seed=3)
        assert natural["track"].shape == (1, 50, 14, 2)
        assert (natural["noise"] > 0).all()

    def test_quadrature_agrees(self, linear, fixes_fit):
        """The mean and sd over the parameters too, by quadrature: Laplace's error is small here."""
        _, _, dt, observed = linear
        mean_u, var_u, mean_x, var_x = oracles.fixes_moments(
            dt, observed, cases.SPREAD, fixes_fit.marginal.u, (1.6, 1.6)
        )
        x, covariance = fixes_fit.moments()
        sd = np.sqrt(var_x)
        assert (np.abs(x - mean_x) < 0.2 * sd).all()
        np.testing.assert_allclose(np.sqrt(np.einsum("tii->ti", covariance)), sd, rtol=0.15)
        assert (np.abs(fixes_fit.marginal.u - mean_u) < 0.5 * np.sqrt(var_u)).all()


def test_mode_from_a_bad_start_climbs():
    """Every step raises the density, and the end is a maximum: gradient 0, precision positive."""
    args = cases.ranges_data()
    cm = chain_model(cases.ranges_only, {}, args)
    u = np.zeros(cm.k)
    far = np.random.default_rng(0).normal(0, 30, (11, 3))
    mode = find_mode(cm, args, far, u, max_steps=200)
    assert mode.converged
    assert mode.value < float(cm.exact(far, u, args, 0.0)[0])
    _, gradient, band = cm.exact(mode.x, u, args, 0.0)
    assert np.linalg.eigvalsh(oracles.from_band(band)).min() > 0
    assert np.abs(gradient).max() < 1e-2
    few = find_mode(cm, args, far, u, max_steps=2)
    assert not few.converged
    assert few.steps == 2


def test_factor_of_an_indefinite_band():
    """The diagonal is raised until a factor exists; a definite band is left alone."""
    rng = np.random.default_rng(0)
    for definite in (True, False):
        band = rng.normal(size=(4, 12))
        band[0] = 9.0 if definite else rng.normal(size=12)
        for offset in range(1, 4):
            band[offset, 12 - offset :] = 0.0
        dense = oracles.from_band(band)
        np.testing.assert_allclose(_row_sums(band), np.abs(dense).sum(axis=1))
        assert (np.linalg.eigvalsh(dense).min() > 0) == definite
        log_det = _factor(band, 2).log_det
        if definite:
            np.testing.assert_allclose(log_det, np.linalg.slogdet(dense)[1])
        assert np.isfinite(log_det)
    band[0, 3] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        _factor(band, 2)


def test_annealing_finds_the_track(toa):
    """From the middle of the array to within metres of the truth, wild arrivals or not."""
    times, _, position = toa
    args = (to_model_data(times),)
    options = {"movement": "ctcrw", "error": "ddetect", "sound_speed": "given"}
    cm = chain_model(toa_track, options, args)
    u = cm.flat_globals({"sigma": 2.0, "sigma_vel": 0.3, "t05": 260.0, "w": 0.1})
    x = np.zeros((16, 5))
    x[:, :2] = np.asarray(args[0].centre)
    x = anneal(cm, args, x, u, (100.0, 50.0, 25.0, 12.0, 6.0, 3.0))
    error = np.linalg.norm(x[:12, :2] - np.delete(position, 4, axis=0), axis=1)
    assert error.max() < 3


class TestToaTrack:
    def test_near_the_truth(self, toa, laplace_fit):
        _, emission, position = toa
        assert laplace_fit.warnings == ()
        assert laplace_fit.n_states == 12
        mean, covariance = laplace_fit.moments()
        off = mean[:, :2] - np.delete(position, 4, axis=0)
        chi2 = np.einsum("ti,tij,tj->t", off, np.linalg.inv(covariance[:, :2, :2]), off)
        assert np.median(chi2) < 4.6  # the 90 % point of two degrees
        assert np.linalg.norm(off, axis=1).max() < 2.0
        times = laplace_fit.draws(500)["emission_time"]
        assert times.shape == (1, 500, 12)
        off = np.abs(times.mean((0, 1)) - np.delete(emission, 4))
        assert off.max() < 2.0 / cases.SPEED

    def test_padding_changes_nothing(self, toa, laplace_fit):
        plain = maloc.infer.laplace(toa_track, to_model_data(toa[0], pad=False))
        assert plain.args[0].valid.all()
        assert not laplace_fit.args[0].valid.all()
        np.testing.assert_allclose(laplace_fit.marginal.u, plain.marginal.u, atol=1e-4)
        mean, covariance = laplace_fit.moments()
        wanted, wanted_covariance = plain.moments()
        np.testing.assert_allclose(mean, wanted, atol=1e-4)
        np.testing.assert_allclose(covariance, wanted_covariance, rtol=1e-3, atol=1e-5)
        # the draws differ: their noise has another shape
        np.testing.assert_allclose(laplace_fit.p_direct(), plain.p_direct(), atol=0.05)

    def test_sites_are_cut_to_the_heard_pings(self, toa, laplace_fit):
        draws = laplace_fit.draws(7)
        shapes = {name: value.shape[2:] for name, value in draws.items()}
        assert shapes == {
            "track": (12, 2, 2),
            "emission": (12,),
            "sigma": (),
            "sigma_vel": (),
            "t05": (),
            "w": (),
            "position": (12, 2),
            "emission_time": (12,),
        }
        np.testing.assert_array_equal(draws["track"][:, :, :, 0], draws["position"])

    @settings(max_examples=4)
    @given(
        order=st.permutations(range(6)),
        angle=st.floats(-np.pi, np.pi),
        shift=st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
        clock=st.floats(-1e6, 1e6),
    )
    def test_frame_order_and_clock_do_not_matter(
        self, toa, laplace_fit, order, angle, shift, clock
    ):
        times, _, _ = toa
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        order = list(order)
        xy = np.column_stack([times.receivers.x, times.receivers.y]) @ turn.T + np.array(shift)
        moved = times.replace(toa=times.toa[:, order] + clock, receivers=cases.receivers(xy[order]))
        fit = maloc.infer.laplace(toa_track, moved)
        u = laplace_fit.marginal.u
        position, covariance = (part[:, :2] for part in laplace_fit.moments())
        mean, spread = fit.moments()
        sd = np.sqrt(np.diag(fit.marginal.covariance))
        np.testing.assert_allclose(fit.marginal.u / sd, u / sd, atol=0.03)
        np.testing.assert_allclose(mean[:, :2], position @ turn.T + np.array(shift), atol=0.02)
        np.testing.assert_allclose(
            spread[:, :2, :2], turn @ covariance[:, :, :2] @ turn.T, rtol=0.03, atol=0.003
        )


def test_models_of_a_user_s_own():
    """The whole engine on models that the library does not ship."""
    fit = maloc.infer.laplace(cases.ranges_only, *cases.ranges_data())
    assert {row["name"] for row in fit.parameters()} == {
        "sigma_step", "scale", "weights[0]", "weights[1]", "weights[2]"
    }  # fmt: skip
    counts = jnp.asarray([3.0, 0, 1, 4, 7, 5, 2, 0, 1])
    fit = maloc.infer.laplace(cases.counts, counts, path=("level",))
    assert fit.draws(10)["level"].shape == (1, 10, 9)
    assert fit.pointwise()["count"].shape == (1, 1000, 9)


def test_no_parameters():
    """A chain with nothing to estimate beside it."""
    dt, observed = cases.fixes_data()
    fit = maloc.infer.laplace(cases.known_fixes, dt, observed)
    _, mean, covariance = oracles.fixes_posterior(
        np.asarray(dt), np.asarray(observed), np.log([1.2, 0.7]), cases.SPREAD
    )
    x, spread = fit.moments()
    np.testing.assert_allclose(x, mean, atol=1e-8)
    np.testing.assert_allclose(spread[:, 0, 0], np.diag(covariance), rtol=1e-9)
    sampled = maloc.infer.nuts(jax.random.key(0), fit, draws=50, warmup=50, progress=False)
    assert sampled.x.shape == (2, 50, 14, 2)
    assert sampled.parameters() == []
