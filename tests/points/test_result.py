"""The container, and that a ping's position depends on nothing but that ping."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maloc import Receivers
from maloc.errors import InputError
from maloc.points import Points, locate
from maloc.points._problem import problem_of, ranges_of, spread_columns
from tests.points.arrays import arrivals, ring


def fields(n=3, r=4, d=2) -> dict[str, Any]:
    return {
        "position": np.zeros((n, d)),
        "covariance": np.zeros((n, d, d)),
        "emission": np.zeros(n),
        "n_used": np.full(n, r),
        "inlier": np.ones((n, r), bool),
        "ambiguous": np.zeros(n, bool),
        "alternative": np.full((n, d), np.nan),
        "residual_rms": np.zeros(n),
        "method": "consensus",
        "why": np.full(n, ""),
    }


def test_shapes_are_checked():
    assert len(Points(**fields())) == 3
    for name, value, words in (
        ("position", np.zeros((3, 4)), "position must be"),
        ("covariance", np.zeros((3, 2)), "covariance must be"),
        ("inlier", np.ones((2, 4), bool), "inlier must be"),
        ("ambiguous", np.zeros(2, bool), "ambiguous must be"),
        ("emission", np.zeros(4), "emission must have shape"),
        ("extra", {"ess": np.zeros(2)}, "extra 'ess' must have 3 rows"),
    ):
        wrong: dict[str, Any] = fields() | {name: value}
        with pytest.raises(InputError, match=words):
            Points(**wrong)


def test_table_has_a_row_a_ping_with_depth_where_found():
    frame = Points(**fields(d=3), extra={"ess": np.arange(3.0)}).to_frame()
    assert frame.columns[:8] == ["ping", "time", "x", "y", "depth", "sd_x", "sd_y", "sd_depth"]
    assert frame["ess"].to_list() == [0, 1, 2]
    assert "3 of 3 pings" in repr(Points(**fields()))


@pytest.mark.extended
def test_a_position_is_the_same_alone_and_among_others():
    """Widths, batches and padding must not matter: each ping alone, and with silent receivers."""
    rng = np.random.default_rng(1)
    receivers, xy = ring(11), rng.uniform(-300, 300, (9, 2))
    count = np.array([3, 4, 5, 7, 8, 9, 11, 2, 6])
    heard = np.argsort(rng.random((9, 11)), axis=1) < count[:, None]
    late = np.where(rng.random((9, 11)) < 0.1, rng.uniform(60, 200, (9, 11)), 0)
    toa = arrivals(receivers, xy, noise=rng.normal(0, 0.5, (9, 11)), late=late, heard=heard)
    for method in ("consensus", "closed-form"):
        together = locate(toa, method, sigma=0.5, reach=2000.0)
        for i in np.flatnonzero(count > 2):
            one = toa.replace(toa=toa.toa[i : i + 1], sound_speed=toa.sound_speed[:1], ping=[i])
            alone = locate(one, method, sigma=0.5, reach=2000.0)
            np.testing.assert_allclose(alone.position[0], together.position[i], atol=1e-6)
            np.testing.assert_array_equal(alone.inlier[0], together.inlier[i])
    more = Receivers(
        np.append(receivers.receiver, "Z"), np.append(receivers.x, 9e3), np.append(receivers.y, 0)
    )
    wide = toa.replace(toa=np.column_stack([toa.toa, np.full(9, np.nan)]), receivers=more)
    np.testing.assert_allclose(
        locate(wide, sigma=0.5, reach=2000.0).position,
        locate(toa, sigma=0.5, reach=2000.0).position,
        atol=1e-6,
    )


def test_arrivals_stand_best_first_and_go_back_to_their_columns():
    rng = np.random.default_rng(2)
    toa = arrivals(ring(6), rng.uniform(-200, 200, (5, 2)), heard=rng.random((5, 6)) < 0.7)
    ranges = ranges_of(toa)
    sigma = np.where(np.arange(6) == 2, 0.1, 1.0) * np.ones((5, 6))
    problem, column = problem_of(ranges, toa.receivers.xy, np.zeros((5, 6)), sigma)
    for i in range(5):
        mine = problem.heard[i]
        assert (np.diff(problem.sigma[i, mine]) >= 0).all()
        same = np.diff(problem.sigma[i, mine]) == 0
        assert (np.diff(problem.range[i, mine])[same] >= 0).all()
    back = spread_columns(np.where(problem.heard, problem.range, np.nan), column, 6, np.nan)
    np.testing.assert_array_equal(back, ranges)
    np.testing.assert_array_equal(
        spread_columns(problem.sigma, column, 6, np.nan)[toa.heard], sigma[toa.heard]
    )
