"""Sampling: the whitening's Jacobian, exact targets, and chains that are looked after.

Monte Carlo tests compare a mean with what it should be in standard errors from the effective
sample size, and allow 5: a right sampler with another seed fails once in 2e6 comparisons.
"""

import importlib

import numpy as np
import pytest
from numpyro.infer import MCMC, NUTS

import maloc.infer
from maloc._jax import jax, jnp
from maloc.errors import FitError
from maloc.infer._diagnostics import ess_bulk
from maloc.infer._hmc import CHUNK, Chunk, Kernel, off_resonance
from maloc.infer._map import from_white, make_map, potential
from maloc.infer.result import SampledFit
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests import oracles
from tests.infer import cases

nuts_module = importlib.import_module("maloc.infer.nuts")
LIMIT = 5.0


def standard_error(draws):
    """Monte Carlo standard error of the mean of draws (chain, draw, ...)."""
    return draws.std(axis=(0, 1)) / np.sqrt(ess_bulk(draws))


class TestMap:
    @pytest.fixture(scope="class", params=[5, 14], ids=["short", "longer"])
    @classmethod
    def problem(cls, request):
        args = cases.fixes_data(length=request.param)
        fit = maloc.infer.laplace(cases.fixes, *args)
        return fit.cm, args, make_map(fit.cm, args, fit.marginal)

    def test_jacobian(self, problem):
        """Log Jacobian against the dense matrix of derivatives, up to the map's constant."""
        cm, _, mapping = problem
        size = cm.k + mapping.x.size

        def flat(white):
            x, u, _ = from_white(mapping, white)
            return jnp.concatenate([x.ravel(), u])

        jacobian = jax.jit(jax.jacrev(flat))
        white = np.random.default_rng(0).normal(size=(4, size))
        ours = np.array([from_white(mapping, w)[2] for w in white])
        dense = np.array([np.linalg.slogdet(np.asarray(jacobian(w)))[1] for w in white])
        np.testing.assert_allclose(ours - ours[0], dense - dense[0], atol=1e-9)
        assert np.ptp(ours) > 0.1

    def test_gradient(self, problem):
        """Backward through the map against differences."""
        cm, args, mapping = problem
        function = jax.jit(lambda white: potential(cm, white, mapping, args))
        white, way = np.random.default_rng(1).normal(size=(2, cm.k + mapping.x.size))
        slope = float(jax.jit(jax.grad(function))(white) @ way)
        differences = (function(white + 1e-5 * way) - function(white - 1e-5 * way)) / 2e-5
        np.testing.assert_allclose(slope, differences, rtol=1e-6)

    def test_whitens(self, problem):
        """At the mode the path's Hessian in the white coordinates is the identity, nearly."""
        cm, args, mapping = problem
        slope = jax.grad(lambda white: potential(cm, white, mapping, args))
        hessian = jax.jit(jax.jacrev(slope))(jnp.zeros(cm.k + mapping.x.size))
        path = np.asarray(hessian)[cm.k :, cm.k :]
        np.testing.assert_allclose(path, np.eye(len(path)), atol=0.03)


@pytest.mark.parametrize(
    "method, chains, together", [("nuts", 2, None), ("hmc", 2, None), ("hmc", 5, True)]
)
def test_linear_gaussian_posterior(fixes_fit, method, chains, together):
    """Mean and variance of the track and of the log parameters against quadrature."""
    how = {"method": method, "chains": chains, "side_by_side": together, "progress": False}
    draws = 3000 // chains
    fit = maloc.infer.nuts(jax.random.key(2), fixes_fit, draws=draws, warmup=250, **how)
    assert fit.method == method
    assert fit.warnings == ()
    assert fit.x.shape == (chains, draws, 14, 2)
    assert len(np.unique(fit.x[:, 0, 0, 0])) == chains
    dt, observed = (np.asarray(a) for a in fit.args)
    mean_u, var_u, mean_x, var_x = oracles.fixes_moments(
        dt, observed, cases.SPREAD, fixes_fit.marginal.u, (2.0, 2.0), n=61
    )
    for draws, mean, variance in ((fit.u, mean_u, var_u), (fit.x, mean_x, var_x)):
        assert (ess_bulk(draws) > 400).all()
        assert np.abs((draws.mean((0, 1)) - mean) / standard_error(draws)).max() < LIMIT
        squares = (draws - mean) ** 2
        assert np.abs((squares.mean((0, 1)) - variance) / standard_error(squares)).max() < LIMIT
    # and what the fit says of itself
    mean, covariance = fit.moments()
    flat = fit.x.reshape(-1, 14, 2)
    np.testing.assert_allclose(mean, flat.mean(0))
    np.testing.assert_allclose(covariance[3], np.cov(flat[:, 3].T))
    rows = {row["name"]: row for row in fit.parameters()}
    np.testing.assert_allclose(rows["noise"]["mean"], np.exp(fit.u[..., 1]).mean())
    np.testing.assert_allclose(rows["noise"]["ess_bulk"], ess_bulk(fit.u)[1])


@pytest.mark.parametrize("method", ["nuts", "hmc"])
def test_a_kernel_is_compiled_once(fixes_fit, method, caplog):
    """Step sizes before, during and after warm-up are of one type."""
    short = {"draws": 100, "warmup": 150, "method": method, "progress": False}
    with jax.log_compiles(), caplog.at_level("WARNING"):
        maloc.infer.nuts(jax.random.key(4), fixes_fit, **short)
    said = [record.getMessage() for record in caplog.records]
    assert sum(text.startswith("Compiling jit(run)") for text in said) == 1


@pytest.mark.extended
def test_three_samplers_agree():
    """NUTS and HMC of the engine, and NumPyro's NUTS on the bare model, on arrival times."""
    times, _, _ = cases.toa(seed=5, pings=7, n_receivers=6, p_heard=0.9, unheard=())
    start = maloc.infer.laplace(toa_track, to_model_data(times, pad=False), movement="rw")
    draws = {}
    for method in ("nuts", "hmc"):
        fit = maloc.infer.nuts(jax.random.key(3), start, draws=800, method=method, progress=False)
        assert fit.warnings == ()
        draws[method] = fit.draws()
    plain = MCMC(
        NUTS(toa_track, dense_mass=True),
        num_warmup=400,
        num_samples=600,
        num_chains=2,
        chain_method="sequential",
        progress_bar=False,
    )
    plain.run(jax.random.key(4), times, movement="rw")
    draws["plain"] = plain.get_samples(group_by_chain=True)
    assert int(plain.get_extra_fields(group_by_chain=True)["diverging"].sum()) < 10

    def seen(values):
        scalars = [np.log(values[n])[..., None] for n in ("sigma", "sigma_step", "w")]
        track = np.asarray(values["track"])
        return np.concatenate(
            [*scalars, track.reshape(*track.shape[:2], -1), values["emission"]], axis=-1
        )

    three = {name: seen(values) for name, values in draws.items()}
    for name in ("nuts", "hmc"):
        for power in (1, 2):  # means, and spreads about the pooled mean
            a, b = three[name], three["plain"]
            if power == 2:
                middle = b.mean((0, 1))
                a, b = (a - middle) ** 2, (b - middle) ** 2
            error = np.hypot(standard_error(a), standard_error(b))
            assert np.abs((a.mean((0, 1)) - b.mean((0, 1))) / error).max() < LIMIT, (name, power)


@pytest.mark.extended
def test_a_model_of_a_user_s_own():
    """Poisson counts of a random walk, nothing of maloc in it: the same answer as plain NumPyro."""
    seen = jnp.asarray([3.0, 0, 1, 4, 7, 5, 2, 0, 1])
    fit = maloc.infer.nuts(
        jax.random.key(5), cases.counts, seen, path=("level",), draws=2000, progress=False
    )
    plain = MCMC(
        NUTS(cases.counts, dense_mass=True, target_accept_prob=0.9),
        num_warmup=800,
        num_samples=2000,
        num_chains=2,
        chain_method="sequential",
        progress_bar=False,
    )
    plain.run(jax.random.key(6), seen)
    both = []
    for draws in (fit.draws(), plain.get_samples(group_by_chain=True)):
        rate = np.asarray(draws["start"])[..., None] + np.asarray(draws["level"])
        both.append(np.concatenate([rate, np.log(draws["scale"])[..., None]], axis=-1))
    error = np.hypot(*(standard_error(b) for b in both))
    assert np.abs((both[0].mean((0, 1)) - both[1].mean((0, 1))) / error).max() < LIMIT


# -- chains that are looked after: samplers whose draws are made up -------------------------------


def made_chunk(rng, x, *, shift=0.0, potential=None, accept=0.85, diverging=0):
    """A chunk of independent draws around x (T, d), or one that is ill in some way."""
    energy = rng.normal(size=CHUNK) if potential is None else np.full(CHUNK, potential)
    parts = (
        x + shift + rng.normal(size=(CHUNK, *x.shape)),
        shift + rng.normal(size=(CHUNK, 2)),
        energy,
        np.full(CHUNK, 7),
        np.full(CHUNK, accept),
        np.arange(CHUNK) < diverging,
    )
    return Chunk(*(jnp.asarray(part) for part in parts))


ILL = {
    "density is not finite": {"potential": np.nan},
    "3 divergent transitions": {"diverging": 3},
    "acceptance 0.10": {"accept": 0.1},
    "hangs at one place": {"potential": 1.5},
}


@pytest.mark.parametrize("why", ILL)
def test_ill_chains_are_known(why):
    rng = np.random.default_rng(0)
    well, ill = made_chunk(rng, np.zeros((4, 2))), made_chunk(rng, np.zeros((4, 2)), **ILL[why])
    assert nuts_module._unhealthy([well, well]) == ""
    part = "density" in why or "divergent" in why  # enough that a part of the chain is ill
    assert why in nuts_module._unhealthy([well, ill] if part else [ill])


@pytest.fixture
def play(monkeypatch, fixes_fit):
    """Run `nuts` with the chains that a list of keyword arguments for `made_chunk` describes."""

    def run(chains, stop_at=None, n_chains=2, **settings):
        rng, started, advanced = np.random.default_rng(1), [], []

        def start(key, m, args):
            started.extend(key if key.ndim else [key])
            first = len(started) - key.size
            return chains[first : len(started)] if key.ndim else chains[first]

        def advance(state, m, args, warming):
            advanced.append(state)
            if stop_at is not None and len(advanced) == stop_at:
                raise KeyboardInterrupt
            own = [made_chunk(rng, fixes_fit.marginal.x, **c) for c in np.atleast_1d(state)]
            return state, jax.tree.map(lambda *c: jnp.stack(c), *own) if own[1:] else own[0]

        fake = Kernel(start, advance, lambda state, factor: (state, 0.25 * factor))
        monkeypatch.setattr(nuts_module, "kernels", lambda *args: fake)
        settings = {"draws": 200, "warmup": 50, "progress": False, "chains": n_chains} | settings
        fit = maloc.infer.nuts(jax.random.key(0), fixes_fit, **settings)
        assert len({str(jax.random.key_data(key)) for key in started}) == len(started)
        return fit, len(started)

    return run


class TestCare:
    def test_well(self, play):
        fit, started = play([{}, {}])
        assert started == 2
        assert fit.warnings == ()
        assert fit.x.shape == (2, 200, 14, 2)
        assert fit.stats["step_size"].tolist() == [0.25, 0.25]

    @pytest.mark.parametrize("why", ILL)
    def test_an_ill_chain_is_run_again(self, play, why):
        fit, started = play([{}, ILL[why], {}])
        assert started == 3
        assert len(fit.warnings) == 1
        assert "run again" in fit.warnings[0]
        assert fit.stats["step_size"] == pytest.approx([0.25, 0.15])  # shorter steps at a retry
        assert not fit.stats["diverging"].any()
        assert np.isfinite(fit.stats["potential"]).all()

    def test_ill_chains_among_others_side_by_side(self, play):
        many = [{"shift": 0.1}, ILL["hangs at one place"], {}, {}, {}, {}]
        fit, started = play(many, n_chains=3, method="hmc", side_by_side=True)
        assert started == 6  # once more a batch of three, of which one is needed
        assert fit.x.shape == (3, 200, 14, 2)
        assert len(fit.warnings) == 1 and "hangs" in fit.warnings[0]
        assert fit.stats["step_size"] == pytest.approx([0.25, 0.25, 0.15])
        assert fit.u[0].mean() == pytest.approx(0.1, abs=0.2)

    def test_chains_that_stay_ill_are_said(self, play):
        fit, started = play([{"diverging": 3}] * 6)
        assert started == 4  # two chains, two more starts
        assert sum("not to be trusted" in text for text in fit.warnings) == 2
        assert fit.stats["diverging"].sum() == 2 * 4 * 3

    def test_a_coordinate_that_stands_still_has_not_converged(self, fixes_fit):
        rng = np.random.default_rng(0)
        u, x = rng.normal(size=(2, 400, 2)), rng.normal(size=(2, 400, 14, 2))
        u[..., 1] = 0.5
        fit = SampledFit(fixes_fit.cm, fixes_fit.args, {}, fixes_fit.seconds, (), "nuts", x, u, {})
        assert "parameters have not converged" in nuts_module._convergence(fit)[0]

    def test_chains_at_different_places(self, play):
        fit, _ = play([{}, {"shift": 6.0}])
        text = " ".join(fit.warnings)
        assert "parameters have not converged" in text
        assert "14 of 14 states have R-hat above 1.05" in text

    def test_few_effective_draws(self, fixes_fit):
        rng = np.random.default_rng(0)
        u = np.repeat(rng.normal(size=(2, 30, 2)), 40, axis=1)
        x = rng.normal(size=(2, 1200, 14, 2))
        fit = SampledFit(fixes_fit.cm, fixes_fit.args, {}, fixes_fit.seconds, (), "nuts", x, u, {})
        said = " ".join(nuts_module._convergence(fit))
        assert "effective draws; draw more" in said
        assert "states" not in said

    def test_interrupted_keeps_the_draws(self, play):
        # 1 chunk of warm-up, 4 of draws: stopped in the third chunk of the second chain
        fit, _ = play([{}, {}], stop_at=9)
        assert fit.x.shape == (2, 100, 14, 2)
        assert "interrupted: the draws so far are kept" in fit.warnings

    def test_interrupted_in_the_first_chain(self, play):
        fit, _ = play([{}, {}], stop_at=4)
        assert fit.x.shape[:2] == (1, 100)
        assert any("interrupted" in text for text in fit.warnings)

    def test_interrupted_before_any_draw(self, play):
        with pytest.raises(KeyboardInterrupt):
            play([{}, {}], stop_at=1)

    def test_misuse(self, fixes_fit):
        with pytest.raises(ValueError, match="chains must be 2 or more"):
            maloc.infer.nuts(jax.random.key(0), fixes_fit, chains=1)
        with pytest.raises(ValueError, match="method must be"):
            maloc.infer.nuts(jax.random.key(0), fixes_fit, method="gibbs")
        with pytest.raises(FitError):
            nuts_module._stack([[], []])

    def test_progress_goes_to_stderr(self, play, capsys):
        play([{}, {}], progress=True)
        seen = capsys.readouterr()
        assert "nuts" in seen.err
        assert seen.out == ""


def test_steps_are_kept_off_resonance():
    """No trajectory of 2^j - 1 steps covers from .85 to 1.1 of half a turn."""
    for step in np.geomspace(0.03, 1.5, 400):
        held = off_resonance(step)
        assert step <= held < 1.31 * step
        turns = (2.0 ** np.arange(1, 8) - 1) * held / np.pi
        assert not ((turns > 0.85) & (turns < 1.0999)).any()
