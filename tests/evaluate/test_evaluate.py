"""Tracks whose errors are known, scored; scores of laws against SciPy and brute force."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy import integrate, stats

from maloc.errors import InputError
from maloc.evaluate import evaluate, true_positions
from maloc.evaluate.score import crps, energy


def _track(x, y, half, **more):
    x, y = np.asarray(x, float), np.asarray(y, float)
    limits = {"x_lo": x - half, "x_hi": x + half, "y_lo": y - half, "y_hi": y + half}
    return pl.DataFrame({"x": x, "y": y, **limits, **more})


def test_scores_of_known_errors():
    second = [0.0, 30.0, 60.0, 200.0]
    track = _track([3.0, 0.0, 100.0, 9.0], [4.0, 1.0, 0.0, 9.0], 1.0, t=second)
    truth = pl.DataFrame({"t": second[:3], "x": [0.0, 0.0, 100.5], "y": [0.0] * 3})
    found = evaluate(track, truth, centre=[0.0, -10.0], near=50.0)
    s = found.scores
    assert (s["n"], s["lost"], s["median"]) == (3, 1, 1.0)
    assert s["mean"] == pytest.approx((5 + 1 + 0.5) / 3)
    assert s["local"] == pytest.approx(3.0) and s["correct"] == pytest.approx(2 / 3)
    ranges = [np.hypot(3, 14) - 10, 1.0, abs(np.hypot(100, 10) - np.hypot(100.5, 10))]
    assert s["range"] == pytest.approx(np.mean(ranges))
    turned = [np.arctan2(3, 14), 0.0, np.arctan2(10, 100) - np.arctan2(10, 100.5)]
    assert s["bearing"] == pytest.approx(np.degrees(np.mean(turned)))
    assert s["length"] == pytest.approx((np.hypot(3, 3) + np.hypot(100, 1)) / 100.5)
    assert "coverage" not in s and np.isnan(found.deciles).all()
    assert found.rows["error"].to_list() == [5.0, 1.0, 0.5, None]
    wide = track.with_columns(sd_x=pl.lit(2.0), sd_y=pl.lit(2.0))
    coverage = evaluate(wide, truth).scores["coverage"]
    assert coverage == pytest.approx(4 / 6)  # the first ping misses in x and y
    with pytest.raises(InputError, match="no row of the track has truth within 5 s"):
        evaluate(track, truth.with_columns(pl.col("t") + 1e6))
    with pytest.raises(InputError, match="the truth has no column 'y'"):
        evaluate(track, truth.drop("y"))


def test_honest_widths_have_deciles_of_one_and_cover():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.5, 5.0, 20_000)
    off = sd[:, None] * rng.normal(size=(20_000, 2))
    time = np.arange(20_000.0)
    columns = {"t": time, "x": off[:, 0], "y": off[:, 1]}
    truth = pl.DataFrame({"t": time, "x": 0 * time, "y": 0 * time})
    found = evaluate(pl.DataFrame({**columns, "sd_x": sd, "sd_y": sd}), truth)
    np.testing.assert_allclose(found.deciles, 1.0, atol=0.05)
    assert found.scores["coverage"] == pytest.approx(0.95, abs=0.005)
    assert found.scores["rho"] > 0.6
    for wrong in (0.5, 2.0):  # proper scores are worse for any other width
        other = evaluate(pl.DataFrame({**columns, "sd_x": wrong * sd, "sd_y": wrong * sd}), truth)
        for name in ("crps", "energy"):
            assert other.scores[name] > 1.02 * found.scores[name]


def test_crps_is_its_integral():
    for off, sd in ((0.3, 1.0), (-4.0, 0.5), (1.0, 3.0)):
        value, _ = integrate.quad(
            lambda x, off=off, sd=sd: (stats.norm.cdf(x, 0, sd) - (x >= off)) ** 2,
            -30, 30, points=[off], limit=200,
        )  # fmt: skip
        assert crps(np.array([off]), np.array([sd]))[0] == pytest.approx(value, rel=1e-6)


def test_energy_score_by_brute_force():
    covariance, off = np.array([[4.0, 1.5], [1.5, 1.0]]), np.array([1.0, -2.0])
    rng = np.random.default_rng(1)
    a, b = (rng.multivariate_normal([0, 0], covariance, 200_000) for _ in range(2))
    want = np.linalg.norm(a - off, axis=1).mean() - 0.5 * np.linalg.norm(a - b, axis=1).mean()
    sd = np.sqrt(np.diag(covariance))
    ours = [energy(off[None], sd[None], np.array([1.5]), seed)[0] for seed in range(30)]
    assert np.mean(ours) == pytest.approx(want, abs=4 * np.std(ours) / np.sqrt(30) + 0.01)
    assert np.std(ours) < 0.1


def test_truth_is_found_by_date_or_by_seconds():
    truth = pl.DataFrame(
        {
            "time": [f"2026-01-01T00:00:{s:02d}.250000Z" for s in (10, 40)],
            "t": [10.25, 40.25],
            "x": [1.0, 2.0],
            "y": [3.0, 4.0],
        }
    )
    want = np.array([[2.0, 4.0], [1.0, 3.0], [np.nan, np.nan]])
    dated = ["2026-01-01T00:00:41.000Z", "2026-01-01T00:00:09.000Z", "2026-01-01T00:00:25.000Z"]
    by_date = _track([0, 0, 0], [0, 0, 0], 1.0, time=dated, t=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(true_positions(by_date, truth), want)
    no_date = pl.Series([None] * 3, dtype=pl.String)
    by_second = _track([0, 0, 0], [0, 0, 0], 1.0, time=no_date, t=[41.0, 9.0, 25.0])
    np.testing.assert_array_equal(true_positions(by_second, truth), want)


def test_dense_truth_is_interpolated():
    fixes = pl.DataFrame({"t": [0.0, 8.0, 100.0], "x": [0.0, 16.0, 0.0], "y": [1.0, 1.0, 1.0]})
    track = pl.DataFrame({"t": [2.0, 50.0, 96.0, 103.0], "x": [0.0] * 4, "y": [0.0] * 4})
    want = [[4.0, 1.0], [np.nan, np.nan], [0.0, 1.0], [0.0, 1.0]]
    np.testing.assert_allclose(true_positions(track, fixes), want)
