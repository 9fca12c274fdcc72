"""Bridge of a Gauss-Markov path against the dense conditional normal; no sampling error.

A draw is linear in the standard normals it is given, so a generator that hands out zeros and ones
shows the mean and the covariance exactly.
"""

import mpmath
import numpy as np
import pytest

from maloc.infer._bridge import PathDraws, between, draw
from maloc.movement import CTCRW, OU, Brownian
from tests import oracles

SIGMA, T05 = 0.4, 90.0
BETA = -np.log(0.05) / T05
CLOCK = np.array([0.0, 31.0, 74.0])


class OneAtATime:
    """Standard normals of which draw 0 gets zeros, and draw i + 1 a one at the i-th place."""

    def standard_normal(self, shape):
        draws, n, order, axes = shape
        out = np.zeros((draws, n * order, axes))
        out[np.arange(1, draws), np.arange(draws - 1)] = 1.0
        return out.reshape(shape)


def paths(draws, law, state, scale, home=None):
    """The same path in every draw."""

    def repeat(a):
        return np.repeat(np.asarray(a, float)[None], draws, axis=0)

    scale = {name: np.full(draws, value) for name, value in scale.items()}
    return PathDraws(
        law, scale, repeat(CLOCK), repeat(state), None if home is None else repeat(home)
    )


def moments(law, state, times, scale, home=None):
    """Mean (n, order, A) and covariance (n order, n order) of one axis, from as many draws."""
    order = state.shape[1]
    draws = 1 + order * len(times)
    path = paths(draws, law, state, scale, home)
    out = draw(OneAtATime(), path, np.repeat(np.asarray(times)[None], draws, 0))  # pyright: ignore
    root = (out[1:] - out[0]).reshape(draws - 1, -1, 2)
    first, second = (np.einsum("di,dj->ij", root[..., a], root[..., a]) for a in (0, 1))
    np.testing.assert_allclose(first, second, atol=1e-12)
    # what is said of each time alone is what the draws' joint law says of it
    found, mean = between(path.take([0]), np.asarray(times)[None])
    np.testing.assert_allclose(mean[0], out[0], rtol=1e-10, atol=1e-10)
    for i in range(len(times)):
        part = first[i * order : (i + 1) * order, i * order : (i + 1) * order]
        np.testing.assert_allclose(found.variance[0, i], part, rtol=1e-9, atol=1e-13)
    return out[0], first


def check(joint, mean, covariance, state, times, order, digits, home=(0.0, 0.0)):
    """Against a dense joint normal of (all positions, all velocities) at states and times."""
    every = np.sort(np.concatenate([CLOCK, times]))
    places = np.searchsorted(every, CLOCK)
    at = [len(every) * o + p for o in range(order) for p in places]
    rest = [i for i in range(order * len(every)) if i not in at]
    pick = [
        rest.index(len(every) * o + int(np.searchsorted(every, t)))
        for t in times
        for o in range(order)
    ]
    for axis in range(2):
        values = (state[:, :, axis] - np.array([home[axis], 0.0])[:order]).T.ravel()
        dense_mean, dense = oracles.conditional(joint(every), at, values, digits=digits)
        shift = np.tile(np.array([home[axis], 0.0])[:order], len(times))
        got = mean[:, :, axis].ravel()
        np.testing.assert_allclose(got, dense_mean[pick] + shift, rtol=1e-9, atol=1e-9)
        sd = np.sqrt(np.diag(dense[np.ix_(pick, pick)]))
        scale = np.outer(sd, sd)
        np.testing.assert_allclose(
            covariance / scale, dense[np.ix_(pick, pick)] / scale, rtol=0, atol=1e-9
        )


CASES = {
    "between": [40.0, 55.5, 73.0],
    "one between": [12.0],
    "before": [-50.0, -31.0, -2.0],
    "after": [75.0, 120.0, 400.0],
}


# between them all at once: draws take each time with those around it
CASES["everywhere"] = [t for times in list(CASES.values()) for t in times]


@pytest.mark.parametrize("case", CASES)
def test_ctcrw(case):
    times = sorted(CASES[case])
    rng = np.random.default_rng(0)
    state = np.stack([rng.normal(0, 20, (3, 2)), rng.normal(0, 0.4, (3, 2))], axis=1)  # (T, 2, A)
    mean, covariance = moments(CTCRW, state, times, {"sigma_vel": SIGMA, "t05": T05})

    def joint(every):  # an open start
        return oracles.ctcrw_covariance(every, SIGMA, mpmath.mpf(BETA), 1e12, digits=60)

    check(joint, mean, covariance, state, times, 2, 60)


@pytest.mark.parametrize("case", CASES)
def test_brownian(case):
    times = sorted(CASES[case])
    state = np.random.default_rng(1).normal(0, 20, (3, 1, 2))
    mean, covariance = moments(Brownian, state, times, {"sigma": 0.7})

    def joint(every):
        moved = oracles.brownian_covariance(every, 0.7, 0.0)
        with mpmath.workdps(60):
            return mpmath.matrix(moved.tolist()) + mpmath.mpf(10) ** 24  # an open start

    check(joint, mean, covariance, state, times, 1, 60)


@pytest.mark.parametrize("case", CASES)
def test_home_range(case):
    times, home = sorted(CASES[case]), (300.0, -40.0)
    state = np.random.default_rng(2).normal(0, 20, (3, 1, 2)) + np.array(home)
    mean, covariance = moments(OU, state, times, {"sd": 25.0, "t05": T05}, home)

    def joint(every):
        away = np.abs(np.subtract.outer(every, every))
        return mpmath.matrix((25.0**2 * 0.05 ** (away / T05)).tolist())

    check(joint, mean, covariance, state, times, 1, 50, home)


def test_at_a_state_it_is_the_state():
    state = np.random.default_rng(3).normal(0, 20, (3, 2, 2))
    path = paths(2, CTCRW, state, {"sigma_vel": SIGMA, "t05": T05})
    times = np.tile(CLOCK, (2, 1))
    out = draw(np.random.default_rng(0), path, times)
    np.testing.assert_allclose(out, path.state, rtol=1e-12)
    np.testing.assert_allclose(between(path, times)[0].variance, 0.0, atol=1e-12)


def test_each_draw_has_its_own_clock_and_scale():
    """A draw that moves faster, or has another clock, is not bridged with its neighbour's."""
    rng = np.random.default_rng(2)
    clock = np.where(np.arange(4000)[:, None] % 2 == 0, [[0.0, 60.0]], [[20.0, 80.0]])
    sigma = np.where(np.arange(4000) < 2000, 0.1, 0.3)
    scale = {"sigma_vel": sigma, "t05": np.full(4000, T05)}
    path = PathDraws(CTCRW, scale, clock, np.zeros((4000, 2, 2, 2)))
    out = draw(rng, path, clock[:, :1] + 30.0)[:, 0, 0]
    slow, fast = out[:2000].std(), out[2000:].std()
    np.testing.assert_allclose(fast / slow, 3.0, rtol=0.1)  # 4 standard errors of a ratio of sds
    # half-way between in either clock
    np.testing.assert_allclose(out[::2].std() / out[1::2].std(), 1.0, rtol=0.1)
