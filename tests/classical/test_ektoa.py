"""EK-TOA: linearised at its own states it is a dense Gaussian posterior; and near the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from maloc.classical import ek_toa
from maloc.classical._steps import LAWS, steps
from maloc.classical.ektoa import linearised
from maloc.errors import InputError, MalocWarning
from maloc.simulate import canal_toa

KNOWN = {"rw": (0.5,), "ctcrw": (0.3, 100.0)}


def canal(pings=12, seed=4):
    toa, truth = canal_toa(np.random.default_rng(seed), p_na=0.1, p_mp=0.0, n_pings=pings)
    return toa, np.column_stack([truth.x, truth.y])[toa.n_heard > 0]


@pytest.mark.parametrize("movement", KNOWN)
def test_filter_and_smoother_are_the_dense_posterior_of_the_linearised_arrivals(movement):
    toa, _ = canal()
    values, sigma = KNOWN[movement], 1.5
    names = LAWS[movement].names
    found = ek_toa(toa, movement, parameters=dict(zip(names, values, strict=True)), sigma=sigma)
    time, n, size = found.time, len(found.time), found.prior.mean.shape[1]
    a, q = steps(LAWS[movement], np.diff(time), 2, values)
    reach: np.ndarray = np.zeros((n * size, n * size))
    for i in range(n):
        at = slice(i * size, (i + 1) * size)
        if i:
            reach[at] = a[i - 1] @ reach[(i - 1) * size : i * size]
        reach[at, at] = np.eye(size)
    noise = np.asarray(block_diag(found.prior.covariance[0], *q))
    prior, mean = reach @ noise @ reach.T, reach[:, :size] @ found.prior.mean[0]
    place = np.asarray(toa.receivers.xy)
    wide = 2 * np.ptp(place, axis=0).max()
    heard_rows, speed = toa.toa[toa.n_heard > 0], toa.sound_speed[toa.n_heard > 0]
    for upto, wanted in ((n, found.smoothed), (7, found.filtered)):
        rows, data, spread = [], [], []
        for i in range(upto):
            heard = np.isfinite(heard_rows[i])
            ranges = (heard_rows[i, heard] - time[i]) * speed[i]
            # where the filter linearised: at what it found
            here = found.filtered.mean[i, :2]
            slope, off = linearised(here, 0.0, ranges, place[heard], size)
            wide_rows = np.zeros((len(ranges), n * size))
            wide_rows[:, i * size : (i + 1) * size] = slope[:, :-1]
            rows.append(wide_rows)
            data.append(off + slope[:, :2] @ here)
            spread.append(sigma**2 * np.eye(len(ranges)) + wide**2)
        h, y, r = np.concatenate(rows), np.concatenate(data), np.asarray(block_diag(*spread))
        gain = np.linalg.solve(h @ prior @ h.T + r, h @ prior).T
        dense = mean + gain @ (y - h @ mean)
        covariance = prior - gain @ h @ prior
        for k in range(upto) if upto == n else (upto - 1,):
            at = slice(k * size, (k + 1) * size)
            np.testing.assert_allclose(wanted.mean[k], dense[at], atol=1e-7)
            np.testing.assert_allclose(wanted.covariance[k], covariance[at, at], atol=1e-7)


def test_it_finds_the_track_where_nothing_is_late():
    toa, truth = canal(60, seed=6)
    found = ek_toa(toa, parameters={"sigma_vel": 0.1, "t05": 300.0})
    error = np.linalg.norm(found.smoothed.mean[:, :2] - truth, axis=1)
    assert error.mean() < 2.5
    sd = np.sqrt(np.einsum("tii->ti", found.smoothed.covariance)[:, :2])
    inside = np.abs(found.smoothed.mean[:, :2] - truth) < 1.96 * sd
    assert 0.85 < inside.mean() <= 1.0
    assert found.parameters["sigma"] == pytest.approx(2.0, abs=0.5)  # signed Poisson(1) ms
    there = found.predict(found.time[[3, 10]])
    np.testing.assert_allclose(there.mean, found.smoothed.mean[[3, 10]], atol=1e-9)


def test_pings_with_one_first_arrival_are_counted():
    toa, _ = canal()
    how: dict = {"parameters": {"sigma_vel": 0.3, "t05": 100.0}, "sigma": 1.5}
    rows = np.sort(np.r_[np.arange(len(toa.toa)), 3])
    twice = toa.replace(
        toa=toa.toa[rows], sound_speed=toa.sound_speed[rows], ping=np.arange(len(rows))
    )
    with pytest.warns(MalocWarning, match="1 pings have another's first arrival time"):
        found = ek_toa(twice, **how)
    np.testing.assert_array_equal(found.smoothed.mean, ek_toa(toa, **how).smoothed.mean)


def test_refusals():
    toa, _ = canal()
    with pytest.raises(InputError, match="none of rw, crw, ctcrw"):
        ek_toa(toa, "walk")
    with pytest.raises(InputError, match="are sigma_vel and t05"):
        ek_toa(toa, parameters={"sigma": 1.0})
    quiet = np.where(np.cumsum(toa.heard, axis=1) <= 2, toa.toa, np.nan)
    with pytest.raises(InputError, match="heard by 3 receivers"):
        ek_toa(toa.replace(toa=quiet))
