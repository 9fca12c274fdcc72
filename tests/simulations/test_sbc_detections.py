"""Calibration of the detection models: what is simulated, and that a wrong model is seen."""

import numpy as np
import pytest

import maloc.models
from maloc._jax import jax
from simulations import sbc
from simulations import sbc_detections as study


@pytest.mark.parametrize("name", ["independent", "detection_only", "known_interval"])
def test_hearing_follows_the_parameters(name):
    """Numbers heard against their expectation at the true places, within five standard errors."""
    model = sbc.with_priors(getattr(maloc.models, name), study.priors(name))
    expected = variance = heard = unheard = 0.0
    for key in jax.random.split(jax.random.key(0), 30):
        truth, history, none = study.draw_given(key, name, model)
        apart = ((truth["position"][:, None] - history.receivers.xy) ** 2).sum(axis=2)
        p = truth["p0"] * np.exp(-apart / (2 * truth["scale"] ** 2))
        expected, variance = expected + p.sum(), variance + (p * (1 - p)).sum()
        heard, unheard = heard + history.heard.sum(), unheard + none
        assert none == (~history.heard.any(axis=1)).sum()
    assert abs(heard - expected) < 5 * np.sqrt(variance)
    if name != "known_interval":
        assert unheard < 0.02 * 30 * 24  # practically every ping is heard: see the module


def test_unknown_intervals_keep_heard_pings():
    for seed in range(5):
        truth, history, vain = study.draw_unknown(np.random.default_rng(seed))
        assert (history.n_heard > 0).all() and vain == 0
        sent = len(history) + truth["missed"]
        assert 2 * 10 <= sent <= 2 * 20  # 20 s at 1 to 2 s
        assert len(truth["position"]) == len(history)
        again = study.draw_unknown(np.random.default_rng(seed))[1]
        assert np.array_equal(again.time, history.time)


def test_positions_and_parameters_are_named():
    values = {"p0": np.array(0.5), "scale": np.array(1.0), "position": np.arange(8.0).reshape(4, 2)}
    found = study.quantities(values, (0, 1, 3))
    assert list(found)[:2] == ["p0", "scale"]
    assert [found[k] for k in ("x first", "y middle", "x last")] == [0.0, 3.0, 6.0]


@pytest.mark.sbc
def test_the_command_in_small(capsys):
    study.main(["known_interval", "--fits", "2", "--draws", "50", "--method", "hmc"])
    assert "pings were heard by nobody" in capsys.readouterr().out


@pytest.mark.extended
@pytest.mark.sbc
def test_known_interval_smoke(capsys):
    """Few fits say little: no p below 1e-4; silence left out is seen at p0."""
    asked = ["known_interval", "--fits", "40", "--seed", "1", "--draws", "250"]
    study.main(asked)
    table = capsys.readouterr().out
    assert "pings were heard by nobody" in table
    assert float(table.split("smallest p ")[1].split()[0]) > 1e-4
    assert study.main([*asked, "--fit", "detection_only"]) == 1
    line = next(s for s in capsys.readouterr().out.splitlines() if s.startswith("p0 "))
    assert float(line.split()[1]) < 0.01
