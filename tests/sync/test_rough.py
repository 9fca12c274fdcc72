"""Clocks brought together by the animals' own tags."""

import numpy as np

from maloc.data import Detections, Receivers
from maloc.sync import rough

START = 1_622_548_800 * 10**9
NAMES = np.array([f"R{i}" for i in range(6)])
RECEIVERS = Receivers(NAMES, np.arange(6) * 200.0, np.zeros(6))


def heard(rng, offset, drift, n=80, p=0.5):
    """Detections of two tags at random, on clocks that are off; and their true times (s)."""
    parts = []
    for k in range(2):
        emission = np.cumsum(rng.uniform(20, 40, n))
        ping, j = np.nonzero(rng.random((n, len(NAMES))) < p)
        parts.append((emission[ping] + rng.uniform(0, 0.3, len(ping)), j, np.full(len(j), k)))
    t, j, k = (np.concatenate(c) for c in zip(*parts, strict=True))
    clock = t + offset[j] + drift[j] * t
    d = Detections(
        START + np.round(clock * 1e9).astype(np.int64), NAMES[j], np.array(["a", "b"])[k]
    )
    return d, t, j


def test_clocks_minutes_apart_come_together_to_under_a_second():
    rng = np.random.default_rng(0)
    offset = np.array([0.0, 100.0, -70.0, 12.0, -3.0, 900.0])
    d, t, _ = heard(rng, offset, rng.uniform(-2e-5, 2e-5, 6))
    found = rough(d, RECEIVERS)
    error = (found.time - START) / 1e9 - t
    assert np.ptp(error) < 1.0
    assert abs(np.median(error) - np.median(offset)) < 3  # the middle clock's time
    assert "6 receivers brought together" in found.report.notes[-1].text
    whole = Detections(d.time // 10**9 * 10**9, d.receiver, d.tag)
    assert np.ptp((rough(whole, RECEIVERS).time - START) / 1e9 - t) < 3.0


def test_a_receiver_that_shares_no_ping_keeps_its_clock():
    rng = np.random.default_rng(1)
    d, t, j = heard(rng, np.zeros(6), np.zeros(6))
    late = np.where(j == 5, d.time + 10**9 * (50_000 + rng.integers(0, 9000, len(t))), d.time)
    found = rough(Detections(late, d.receiver, d.tag), RECEIVERS)
    assert (found.time[j == 5] == late[j == 5]).all()
    assert any("1 receivers share too few pings" in n.text for n in found.report.notes)


def test_few_detections_are_left_alone():
    rng = np.random.default_rng(2)
    d, t, _ = heard(rng, np.zeros(6), np.zeros(6), n=8, p=0.4)
    assert np.ptp((rough(d, RECEIVERS).time - START) / 1e9 - t) < 1.0
