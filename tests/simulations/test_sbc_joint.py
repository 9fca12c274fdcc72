"""SBC of the joint model: what it simulates, and once in small."""

import numpy as np
import pytest

from maloc._jax import jax
from maloc.models import joint
from simulations import sbc, sbc_joint


@pytest.mark.parametrize("silence", ["given", "unknown"])
def test_hearing_follows_the_parameters(silence):
    """Detections a ping against the half-normal curve at the true positions, over 60 data sets."""
    model, data = sbc.with_priors(joint, sbc_joint.PRIORS), sbc_joint.design(silence)
    assert data.silence == silence
    xy, off = np.asarray(data.receiver_xy), []
    for key in jax.random.split(jax.random.key(0), 60):
        truth, seen = sbc_joint.simulate(key, model, data)
        scale = truth["scale"] * np.exp(truth["range_sd"] * truth["range_drift"])
        away = np.linalg.norm(truth["position"][:, None] - xy, axis=2) / scale[:, None]
        p = truth["p0"] * np.exp(-0.5 * away**2)
        if silence == "unknown":
            assert np.asarray(seen.heard).any(axis=1).all()
            p = p / (1 - np.prod(1 - p, axis=1, keepdims=True))
        off.append(np.asarray(seen.heard).sum(axis=1) - p.sum(axis=1))
    means = np.mean(off, axis=1)
    assert abs(np.mean(means)) < 4 * np.std(means) / np.sqrt(len(means))
    assert np.std(means) < 0.5


@pytest.mark.extended
@pytest.mark.sbc
def test_the_command_in_small(capsys):
    sbc_joint.main(["--fits", "2", "--method", "hmc", "--draws", "50", "--silence", "unknown"])
    table = capsys.readouterr().out
    assert "2 fits" in table
    assert all(name in table for name in (*sbc_joint.PARAMETERS, "range[16]", "emission[7]"))
