"""Simulation-based calibration: uniform for a right sampler, and it sees a wrong one."""

import numpy as np
import pytest
from numpyro import handlers
from scipy.stats import chi2

from maloc._jax import jax
from maloc.models import toa_track
from simulations import sbc


def conjugate(rng, fits, shift=0.0, stretch=1.0):
    """Truth and posterior draws of a normal mean with a normal prior; spoilt where asked."""
    for _ in range(fits):
        truth = rng.normal()
        seen = truth + rng.normal()
        mean, sd = seen / 2, np.sqrt(0.5)
        draws = mean + shift * sd + stretch * sd * rng.normal(size=sbc.DRAWS)
        yield {"mean": np.asarray(truth)}, {"mean": draws}, False


def test_uniform_p_is_the_chi_square_test():
    ranks = np.repeat(np.arange(0, 100, 10), [12, 8, 10, 10, 10, 10, 10, 10, 10, 10])
    assert sbc.uniform_p(ranks) == pytest.approx(chi2.sf(0.8, 9))
    assert sbc.uniform_p(np.arange(100)) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="10 bins do not divide"):
        sbc.uniform_p(ranks, draws=98)


def test_a_right_sampler_passes():
    """Its p values are themselves uniform: 200 studies of 100 fits, 2 of them below .01."""
    rng = np.random.default_rng(0)
    p = [sbc.calibrate(conjugate(rng, 100)).p_values()["mean"] for _ in range(200)]
    assert np.mean(np.array(p) < 0.01) < 0.05
    assert 0.4 < np.mean(p) < 0.6


@pytest.mark.parametrize("wrong", [{"shift": 0.5}, {"stretch": 0.6}, {"stretch": 1.8}])
def test_a_wrong_sampler_is_caught(wrong):
    result = sbc.calibrate(conjugate(np.random.default_rng(1), 100, **wrong))
    assert result.p_values()["mean"] < 1e-3
    assert result.ranks["mean"].min() >= 0
    assert result.ranks["mean"].max() <= sbc.DRAWS


def test_priors_are_swapped_and_the_rest_is_left():
    model = sbc.with_priors(toa_track, sbc.PRIORS)
    data = sbc.design()

    def compare(data):
        bare = handlers.trace(handlers.seed(toa_track, 0)).get_trace(data)
        swapped = handlers.trace(handlers.seed(model, 0)).get_trace(data)
        assert list(bare) == list(swapped)
        for name in ("sigma", "sigma_vel", "t05"):
            prior = sbc.PRIORS[name]
            assert swapped[name]["fn"] is prior
            assert bare[name]["fn"] is not prior
        assert type(swapped["w"]["fn"]) is type(bare["w"]["fn"])
        return swapped["sigma"]["value"]

    assert jax.eval_shape(compare, data).shape == ()


def test_simulated_arrivals_follow_the_law():
    """Uniform in the law's own distribution function: Kolmogorov-Smirnov at 1e-6."""
    from scipy.stats import kstest

    model, data = sbc.with_priors(toa_track, sbc.PRIORS), sbc.design()
    place = []

    @jax.jit
    def cdf(truth, heard):
        trace = handlers.trace(handlers.substitute(model, data=truth)).get_trace(heard)
        return trace["arrival"]["fn"].base_dist.cdf(heard.range)

    for key in jax.random.split(jax.random.key(0), 20):
        truth, heard = sbc.simulate(key, model, data)
        place.append(np.asarray(cdf(truth, heard)).ravel())
        assert truth["position"].shape == (24, 2)
    assert kstest(np.concatenate(place), "uniform").pvalue > 1e-6


@pytest.mark.extended
@pytest.mark.sbc
def test_toa_track_smoke(capsys):
    """Fourteen fits say little: no p below 1e-4; stretched arrivals bring one."""
    asked = ["--fits", "14", "--seed", "1", "--draws", "150", "--method", "hmc"]
    right = sbc.main(asked)
    table = capsys.readouterr().out
    assert "sigma_vel" in table
    assert "y[23]" in table
    assert "14 fits" in table
    smallest = float(table.split("smallest p ")[1].split()[0])
    assert smallest > 1e-4
    assert right == int(smallest <= 0.01)
    wrong = sbc.main([*asked, "--bias", "1.1"])
    table = capsys.readouterr().out
    assert wrong == 1
    assert float(table.split("smallest p ")[1].split()[0]) < 1e-4
