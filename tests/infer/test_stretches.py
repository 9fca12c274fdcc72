"""Stretches at a wrong place are found by their leaps and laid straight where that is likelier."""

import numpy as np

import maloc
from maloc.infer._stretches import leaps, straighten
from maloc.model_data import to_model_data
from maloc.simulate.canal import simulate_canal


def a_track(track, p_na, p_mp):
    toa, truth = simulate_canal(np.random.default_rng([0, track]), p_na, p_mp)
    return toa, np.column_stack([truth.x, truth.y])


def test_leaps_by_hand():
    toa, xy = a_track(0, 0.0, 0.0)
    data = to_model_data(toa)
    still = np.zeros((len(data.time), 2))
    values = {"sigma_vel": 0.1, "t05": 300.0}
    assert leaps(data, still, values) == []
    far = 20.0  # 4 sds of a step over 36.6 s are 14.6 m
    moved = still.copy()
    moved[10:13] = far
    moved[40] = far
    moved[44:46] = [0.0, far]
    moved[300:] = far  # padding
    assert leaps(data, moved, values) == [(9, 13), (39, 46)]
    slow = still + 0.39 * np.concatenate([[0], np.cumsum(data.dt)])[:, None] * [0.1, 0.0] * 10
    assert leaps(data, slow, {"sigma_vel": 0.1}) == []
    assert leaps(data, moved, {"sigma_step": 10.0}) == []
    assert leaps(data, moved, {}) == []


def test_a_displaced_stretch_comes_back():
    toa, xy = a_track(0, 0.3, 0.06)
    fit = maloc.infer.laplace(maloc.models.toa_track, toa)
    cm, args, best = fit.cm, fit.args, fit.marginal
    assert straighten(cm, args, best.x, best.u) is best.x
    wrong = best.x.copy()
    wrong[100:105, :2] += [60.0, -50.0]
    found = straighten(cm, args, wrong, best.u)
    assert np.abs(found[: len(xy), :2] - best.x[: len(xy), :2]).max() < 0.05


def test_late_arrivals_that_agree_by_chance():
    """A track of which two stretches of five and seven pings were lost, by up to 72 m."""
    toa, xy = a_track(17, 0.5, 0.15)
    fit = maloc.infer.laplace(maloc.models.toa_track, toa)
    mean, covariance = fit.moments()
    error = np.linalg.norm(mean[:, :2] - xy[toa.n_heard > 0], axis=1)
    assert error.max() < 12 and error.mean() < 1.5
    expected = np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1])
    assert (error / expected).max() < 5
