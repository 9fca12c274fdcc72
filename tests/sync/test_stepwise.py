import dataclasses

import numpy as np
import pytest

from maloc import sync
from maloc.errors import InputError
from maloc.sync import stepwise
from tests.sync.simulated import simulate

TRUTH = simulate(4, n_receivers=8, hours=6.0)


def lengths(xy):
    i, j = np.triu_indices(len(xy), 1)
    return np.hypot(*(xy[i] - xy[j]).T)


def test_one_part_at_a_time_comes_to_what_the_joint_fit_says():
    noise = np.random.default_rng(0).normal(0, 1.0, (8, 2))
    xy = TRUTH.receivers.xy + noise
    table = dataclasses.replace(TRUTH.receivers, x=xy[:, 0], y=xy[:, 1])
    joint = sync.fit(TRUTH.detections, table, reference="R001")
    drift = stepwise.fit_clock_drift(TRUTH.detections, table, sound_speed=1480, reference="R001")
    assert (drift.shift == 0).all()
    offsets = stepwise.fit_clock_offsets(drift, TRUTH.detections)
    np.testing.assert_allclose(offsets.slopes, drift.slopes, atol=1e-12)
    np.testing.assert_allclose(np.diff(offsets.values - drift.values, axis=1), 0, atol=1e-9)
    placed = stepwise.fit_receiver_positions(offsets, TRUTH.detections, ref_receivers=["R000"])
    assert (placed.shift[0] == 0).all()
    assert drift.sigma > 1.5 * joint.sigma
    assert placed.sigma < 1.2 * joint.sigma
    right = lengths(TRUTH.receivers.xy)
    off = np.sqrt(np.mean((lengths(placed.receivers.xy) - right) ** 2))
    assert off < 0.6 * np.sqrt(np.mean((lengths(xy) - right) ** 2))
    with pytest.raises(InputError, match="'X'"):
        stepwise.fit_receiver_positions(offsets, TRUTH.detections, ref_receivers=["X"])
