"""LS-TDOA by differential evolution: a global minimum of the stated cost."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brute

from maloc.points import locate
from maloc.points._differential_evolution import cost
from tests.points.arrays import arrivals, error, ring


def test_it_is_the_grids_minimum_with_a_late_arrival_in():
    rng = np.random.default_rng(1)
    receivers, xy = ring(5), rng.uniform(-200, 200, (4, 2))
    late = np.zeros((4, 5))
    late[:, 1] = 120
    toa = arrivals(receivers, xy, noise=rng.normal(0, 1, (4, 5)), late=late)
    points = locate(toa, "differential-evolution", sigma=1.0)
    for i in range(4):
        order = np.argsort(toa.toa[i])
        place = np.column_stack([receivers.xy, np.zeros(5)])[order]
        later = (toa.toa[i, order[1:]] - toa.toa[i, order[0]]) * 1500

        def value(p, place=place, later=later):
            return float(cost(np.reshape(p, (2, 1)), place, later)[0])

        best = brute(value, [(-700, 700), (-700, 700)], Ns=71)
        assert value(points.position[i]) <= value(best) + 1e-3
    assert error(points, xy).max() > 10  # it believes the late arrival


def test_same_seed_same_positions_and_clean_pings_are_exact():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-200, 200, (5, 2))
    toa = arrivals(ring(6), xy)
    one = locate(toa, "differential-evolution", sigma=1.0, seed=3)
    two = locate(toa, "differential-evolution", sigma=1.0, seed=3)
    np.testing.assert_array_equal(one.position, two.position)
    assert error(one, xy).max() < 1e-3
    np.testing.assert_allclose(one.emission, 60.0 * np.arange(5), atol=1e-5)
