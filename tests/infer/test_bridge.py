"""Bridge of a Gauss-Markov path against the dense conditional normal; no sampling error.

A draw is linear in the standard normals it is given, so a generator that hands out zeros and ones
shows the mean and the covariance exactly.
"""

import mpmath
import numpy as np
import pytest

from maloc.infer._bridge import bridge
from tests import oracles

SIGMA, T05 = 0.4, 90.0
BETA = -np.log(0.05) / T05
CLOCK = np.array([0.0, 31.0, 74.0])


class OneAtATime:
    """Standard normals of which draw 0 gets zeros, and draw i + 1 a one at the i-th place."""

    def __init__(self):
        self.seen = 0

    def standard_normal(self, shape):
        draws, order, _ = shape
        out = np.zeros(shape)
        for o in range(order):
            out[1 + self.seen + o, o] = 1.0
        self.seen += order
        return out


def moments(track, k, times, scale):
    """Mean (n, A) and covariance (n, n) of one axis, from as many draws as there are normals."""
    order = track.shape[1] if "sigma_vel" in scale else 1
    draws = 1 + order * len(times)

    def repeat(a):
        return np.repeat(np.asarray(a)[None], draws, axis=0)

    out = bridge(
        OneAtATime(),  # pyright: ignore[reportArgumentType]
        repeat(track),
        repeat(CLOCK),
        k,
        repeat(times),
        {name: np.full(draws, value) for name, value in scale.items()},
    )
    assert out.shape == (draws, len(times), 2)
    root = out[1:] - out[0]
    first, second = (np.einsum("di,dj->ij", root[..., a], root[..., a]) for a in (0, 1))
    np.testing.assert_allclose(first, second, atol=1e-12)
    return out[0], first


CASES = {
    "between": (1, [40.0, 55.5, 73.0]),
    "one between": (0, [12.0]),
    "before": (-1, [-50.0, -31.0, -2.0]),
    "after": (2, [75.0, 120.0, 400.0]),
}


@pytest.mark.parametrize("case", CASES)
def test_ctcrw(case):
    k, times = CASES[case]
    rng = np.random.default_rng(0)
    track = np.stack([rng.normal(0, 20, (3, 2)), rng.normal(0, 0.4, (3, 2))], axis=1)  # (T, 2, A)
    mean, covariance = moments(track, k, times, {"sigma_vel": SIGMA, "t05": T05})
    every = np.sort(np.concatenate([CLOCK, times]))
    joint = oracles.ctcrw_covariance(every, SIGMA, mpmath.mpf(BETA), 1e9, digits=60)
    places = np.searchsorted(every, CLOCK)
    at = list(places) + list(len(every) + places)
    wanted = [int(np.searchsorted(every, t)) for t in times]
    rest = [i for i in range(2 * len(every)) if i not in at]
    pick = [rest.index(i) for i in wanted]
    for axis in range(2):
        values = np.concatenate([track[:, 0, axis], track[:, 1, axis]])
        dense_mean, dense = oracles.conditional(joint, at, values, digits=60)
        np.testing.assert_allclose(mean[:, axis], dense_mean[pick], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(covariance, dense[np.ix_(pick, pick)], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_brownian(case):
    k, times = CASES[case]
    track = np.random.default_rng(1).normal(0, 20, (3, 2))
    mean, covariance = moments(track, k, times, {"sigma_step": 0.7})
    every = np.sort(np.concatenate([CLOCK, times]))
    moved = oracles.brownian_covariance(every, 0.7, 0.0)
    with mpmath.workdps(50):
        joint = mpmath.matrix(moved.tolist()) + mpmath.mpf(10) ** 18  # an open start
    at = list(np.searchsorted(every, CLOCK))
    rest = [i for i in range(len(every)) if i not in at]
    pick = [rest.index(int(np.searchsorted(every, t))) for t in times]
    for axis in range(2):
        dense_mean, dense = oracles.conditional(joint, at, track[:, axis])
        np.testing.assert_allclose(mean[:, axis], dense_mean[pick], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(covariance, dense[np.ix_(pick, pick)], rtol=1e-6, atol=1e-9)


def test_each_draw_has_its_own_clock_and_scale():
    """A draw that moves faster, or has another clock, is not bridged with its neighbour's."""
    rng = np.random.default_rng(2)
    track = np.zeros((4000, 2, 2, 2))
    clock = np.tile([0.0, 60.0], (4000, 1))
    sigma = np.where(np.arange(4000) < 2000, 0.1, 0.3)
    scale = {"sigma_vel": sigma, "t05": np.full(4000, T05)}
    out = bridge(rng, track, clock, 0, np.full((4000, 1), 30.0), scale)
    slow, fast = out[:2000].std(), out[2000:].std()
    np.testing.assert_allclose(fast / slow, 3.0, rtol=0.1)  # 4 standard errors of a ratio of sds
