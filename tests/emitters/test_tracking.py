"""Tracks by Stone Soup: confirmation and deletion counted by hand, and straight lines followed."""

import numpy as np
import pytest

from maloc.emitters import Tracker
from maloc.errors import InputError

pytest.importorskip("stonesoup")
COVARIANCE = 4.0 * np.eye(2)[None]


def _run(tracker, hits):
    """Numbers of confirmed tracks after each step of a target at rest, heard where `hits`."""
    out = []
    for k, hit in enumerate(hits):
        place = np.array([[10.0, 20.0]])[: int(hit)]
        out.append(len(tracker.step(float(k), place, COVARIANCE[: int(hit)]).number))
    return out


@pytest.mark.parametrize("association", ["gnn", "jpda"])
@pytest.mark.parametrize(
    ("hits", "confirmed"),
    [
        ("1111", "0001"),  # the fourth hit confirms
        ("110011", "000001"),  # four of six
        ("111000100000", "000000000000"),  # a fourth too late
        ("100011100", "000000000"),  # the first track died, the second has three
        ("1111000000", "0001111100"),  # five misses delete
        ("11110000100000", "00011111111110"),
    ],
)
def test_confirmation_and_deletion(association, hits, confirmed):
    tracker = Tracker(1.0, 0.1, association=association, p_detect=0.9, false_density=1e-6)
    got = _run(tracker, [h == "1" for h in hits])
    if association == "gnn" or hits != "11110000100000":
        assert got == [int(c) for c in confirmed]
    else:
        assert got[3] == 1


@pytest.mark.parametrize("association", ["gnn", "jpda"])
def test_lines_are_followed_through_false_positions(association):
    rng = np.random.default_rng(4)
    start, velocity = np.array([[0.0, 0.0], [100.0, 0.0]]), np.array([[1.0, 2.0], [-1.0, 2.0]])
    tracker = Tracker(3.0, 0.05, association=association, false_density=1e-5)
    for k in range(25):
        true = start + k * velocity
        seen = np.concatenate([true + rng.standard_normal((2, 2)), rng.uniform(-200, 200, (1, 2))])
        tracks = tracker.step(float(k), seen, np.tile(np.eye(2), (3, 1, 1)))
    order = np.argsort(tracks.velocity[:, 0])[::-1]
    assert len(order) == 2
    np.testing.assert_allclose(tracks.velocity[order], velocity, atol=0.3)
    np.testing.assert_allclose(tracks.position[order], true, atol=2.0)
    ahead = tracker.predict(26.0)
    np.testing.assert_allclose(ahead.position, tracks.position + 2 * tracks.velocity)
    assert (ahead.covariance[:, 0, 0] > tracks.covariance[:, 0, 0]).all()


def test_the_filter_is_the_textbooks():
    """One track, against a Kalman filter written out."""
    rng = np.random.default_rng(8)
    q, r = 0.3, 2.0
    tracker = Tracker(2.0, q)
    seen = np.cumsum(rng.standard_normal((8, 2)), axis=0)
    a = np.array([[1.0, 1.0], [0.0, 1.0]])
    noise = q**2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    mean, cov = np.array([seen[0], [0.0, 0.0]]), np.diag([r**2, 4.0])
    for k, z in enumerate(seen):
        got = tracker.step(float(k), z[None], r**2 * np.eye(2)[None])
        if k:
            mean, cov = a @ mean, a @ cov @ a.T + noise
            gain = cov[:, 0] / (cov[0, 0] + r**2)
            mean, cov = mean + np.outer(gain, z - mean[0]), cov - np.outer(gain, cov[0])
    np.testing.assert_allclose(got.position[0], mean[0], rtol=1e-9)
    np.testing.assert_allclose(got.velocity[0], mean[1], rtol=1e-9)
    np.testing.assert_allclose(got.covariance[0][[0, 0, 2], [0, 2, 2]], cov[[0, 0, 1], [0, 1, 1]])


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="confirm 7 of 6"):
        Tracker(1.0, confirm=(7, 6))
    with pytest.raises(InputError, match="association"):
        Tracker(1.0, association="best")
    tracker = Tracker(1.0)
    with pytest.raises(InputError, match="positions"):
        tracker.step(0.0, np.zeros((2, 2)), COVARIANCE)
    tracker.step(1.0, np.zeros((1, 2)), COVARIANCE)
    with pytest.raises(InputError, match="not later"):
        tracker.step(1.0, np.zeros((1, 2)), COVARIANCE)
