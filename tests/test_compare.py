"""The comparison with the truth that `make demo` prints, on tracks whose errors are known."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from benchmarks.compare import score, true_positions


def _track(x, y, half, **more):
    x, y = np.asarray(x, float), np.asarray(y, float)
    limits = {"x_lo": x - half, "x_hi": x + half, "y_lo": y - half, "y_hi": y + half}
    return pl.DataFrame({"x": x, "y": y, **limits, **more})


def test_score_of_known_errors():
    track = _track([3.0, 0.0, 0.0, 9.0], [4.0, 1.0, 0.0, 9.0], 1.0)
    truth = np.array([[0.0, 0.0], [0.0, 0.0], [0.5, 0.0], [np.nan, np.nan]])
    s = score(track, truth)
    assert s.n == 3 and s.median == 1.0
    assert s.mean == pytest.approx((5 + 1 + 0.5) / 3)
    assert s.coverage == pytest.approx(4 / 6)  # the first ping misses in x and y


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
