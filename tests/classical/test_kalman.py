"""Kalman filter and smoother against dense Gaussian computations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from maloc.classical import kalman
from maloc.classical._steps import LAWS, steps
from maloc.errors import InputError, MalocWarning
from maloc.points import Points

VALUES = {"rw": (0.7,), "crw": (0.04,), "ctcrw": (0.5, 90.0)}


def points(n=7, seed=0, missing=(3,), d=2) -> Points:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(5, 60, n))
    position = np.cumsum(rng.normal(0, 8, (n, d)), axis=0)
    root = rng.normal(0, 2, (n, d, d))
    covariance = root @ np.swapaxes(root, 1, 2) + np.eye(d)
    position[list(missing)] = np.nan
    return Points(
        position=position,
        covariance=covariance,
        emission=time,
        n_used=np.full(n, 4),
        inlier=np.ones((n, 4), bool),
        ambiguous=np.zeros(n, bool),
        alternative=np.full((n, d), np.nan),
        residual_rms=np.zeros(n),
        method="made up",
        why=np.full(n, ""),
    )


def dense(given: Points, movement, upto=None):
    """Mean and covariance of all states given positions before row `upto`; energy of them all."""
    time, n, d = given.emission, len(given), given.position.shape[1]
    values = VALUES[movement]
    a, q = steps(LAWS[movement], np.diff(time), d, values)
    k = (a.shape[1]) // d
    first = given.covariance[0]
    if k == 2:
        variance = 1.0 if movement == "crw" else values[0] ** 2
        first = block_diag(first, variance * np.eye(d))
    # states as a linear map of independent noises
    size = k * d
    reach: np.ndarray = np.zeros((n * size, n * size))
    for i in range(n):
        at = slice(i * size, (i + 1) * size)
        if i:
            reach[at] = a[i - 1] @ reach[(i - 1) * size : i * size]
        reach[at, at] = np.eye(size)
    noise = np.asarray(block_diag(first, *q))
    covariance = reach @ noise @ reach.T
    start = np.concatenate([given.position[0], np.zeros(size - d)])
    mean = reach[:, :size] @ start
    rows = [i for i in range(1, n if upto is None else upto) if np.isfinite(given.position[i, 0])]
    if not rows:
        return mean.reshape(n, size), covariance, 0.0
    seen = np.concatenate([i * size + np.arange(d) for i in rows])
    spread = covariance[np.ix_(seen, seen)] + block_diag(*given.covariance[rows])
    value = given.position[rows].ravel()
    gain = np.linalg.solve(spread, covariance[seen]).T
    energy = -multivariate_normal(mean[seen], spread).logpdf(value)
    mean = mean + gain @ (value - mean[seen])
    return mean.reshape(n, size), covariance - gain @ covariance[seen], energy


@pytest.mark.parametrize("movement", VALUES)
@pytest.mark.parametrize("d", [2, 3])
def test_states_and_energy_are_the_dense_ones(movement, d):
    given = points(d=d)
    names = LAWS[movement].names
    found = kalman(given, movement, parameters=dict(zip(names, VALUES[movement], strict=True)))
    size = found.smoothed.mean.shape[1]

    def part(of, i):
        return of[i * size : (i + 1) * size, i * size : (i + 1) * size]

    mean, covariance, energy = dense(given, movement)
    assert found.energy == pytest.approx(energy, rel=1e-9)
    assert found.used.tolist() == [True, True, True, False, True, True, True]
    np.testing.assert_allclose(found.smoothed.mean, mean, rtol=1e-9, atol=1e-9)
    for i in range(len(given)):
        np.testing.assert_allclose(found.smoothed.covariance[i], part(covariance, i), atol=1e-8)
        before, after = dense(given, movement, i), dense(given, movement, i + 1)
        np.testing.assert_allclose(found.prior.mean[i], before[0][i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.filtered.mean[i], after[0][i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.prior.covariance[i], part(before[1], i), atol=1e-8)
        np.testing.assert_allclose(found.filtered.covariance[i], part(after[1], i), atol=1e-8)


def test_predicted_times_are_those_of_rows_without_a_position():
    given = points()
    known = {"sigma_vel": 0.5, "t05": 90.0}
    found = kalman(given, parameters=known)
    less = given.replace(emission=np.where(np.arange(7) == 3, np.nan, given.emission))
    there = kalman(less, parameters=known).predict(given.emission[[5, 3]])
    np.testing.assert_allclose(there.mean, found.smoothed.mean[[5, 3]], rtol=1e-10)
    np.testing.assert_allclose(there.covariance, found.smoothed.covariance[[5, 3]], rtol=1e-9)
    late = found.predict([given.emission[-1] + 1e5])
    assert late.covariance[0, 0, 0] > 1e4
    with pytest.raises(InputError, match="nothing is known before it"):
        found.predict([given.emission[0] - 1])


def test_least_energy_finds_what_was_simulated():
    """Brownian steps of sd .7 m/s^.5 and small errors: the estimate has a closed form."""
    rng = np.random.default_rng(1)
    given = points(400, missing=())
    xy = np.cumsum(
        0.7 * rng.normal(size=(400, 2)) * np.sqrt(np.diff(given.emission, prepend=0))[:, None], 0
    )
    given = given.replace(position=xy, covariance=np.tile(1e-8 * np.eye(2), (400, 1, 1)))
    found = kalman(given, "rw")
    steps = np.diff(xy, axis=0) / np.sqrt(np.diff(given.emission))[:, None]
    assert found.parameters["sigma_step"] == pytest.approx(np.sqrt(np.mean(steps**2)), rel=1e-4)


def test_positions_without_a_time_of_their_own_are_counted():
    given = points()
    time = given.emission.copy()
    time[2], time[5] = np.nan, time[4]
    with pytest.warns(MalocWarning, match="2 positions have no emission time, or another's"):
        found = kalman(given.replace(emission=time), parameters={"sigma_vel": 0.5, "t05": 90.0})
    assert len(found.time) == 5


def test_what_cannot_be_used_is_filled_in():
    given = points()
    wide = given.covariance.copy()
    wide[5] = np.inf
    keep = np.arange(7) != 1
    found = kalman(
        given.replace(covariance=wide), parameters={"sigma_vel": 0.5, "t05": 90.0}, keep=keep
    )
    assert found.used.tolist() == [True, False, True, False, True, False, True]
    table = found.to_frame()
    assert table.columns == ["time", "x", "y", "sd_x", "sd_y", "cov_xy", "used"]
    assert table["sd_x"].is_finite().all()
    with pytest.raises(InputError, match="2 positions can be used"):
        kalman(given, keep=np.arange(7) < 2)
    with pytest.raises(InputError, match="none of rw, crw, ctcrw"):
        kalman(given, "walk")
    with pytest.raises(InputError, match="are sigma_vel and t05"):
        kalman(given, parameters={"sigma": 1.0})


def test_a_position_that_says_nothing_costs_the_others_nothing():
    """Three arrivals in a line: an error of 80 km along one direction."""
    given, known = points(n=12, missing=()), {"sigma_vel": 0.3, "t05": 200.0}
    covariance = given.covariance.copy()
    along = np.array([0.8, 0.6])
    covariance[5] = 8e4**2 * np.outer(along, along) + 0.1 * np.eye(2)
    found = kalman(given.replace(covariance=covariance), parameters=known)
    assert np.flatnonzero(~found.used).tolist() == [5]
    want = kalman(given, parameters=known, keep=np.arange(12) != 5)
    for mine, theirs in zip(found.smoothed, want.smoothed, strict=True):
        np.testing.assert_allclose(mine, theirs)
    assert (np.diagonal(found.smoothed.covariance, axis1=1, axis2=2) > 0).all()


def test_the_benchmark_runs(monkeypatch, capsys):
    from benchmarks import kalman as benchmark

    monkeypatch.setattr("sys.argv", ["kalman", "--points", "500", "--tracks", "0"])
    benchmark.main()
    assert "500 positions: " in capsys.readouterr().out
