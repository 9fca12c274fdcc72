"""Interval laws: densities, survivals and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.schedule.intervals import Poisson, Stable, Table, interval_law, uniform_law
from maloc.schedule.signal import soft_limits

LAWS = [
    uniform_law(1.0, 2.0),
    uniform_law(0.0, 3.0),
    uniform_law(5.0, 5.0),
    uniform_law(1.0, 2.0, expiry=0.1),
    Table((0.0, 1.0, 4.0), (0.0, 3.0, 0.0)),
    Stable(3.0, 0.2),
    Stable(3.0, 0.2, 0.1),
    Poisson(2.0),
    Poisson(2.0, 0.1),
]


@pytest.mark.parametrize("law", LAWS)
def test_survival_is_one_minus_the_integral(law):
    for x in (0.4, 1.3, 2.9, 5.001, 7.0):
        breaks = [b for b in law.breaks if 0 < b < x] or None
        area, _ = quad(lambda v: float(law.density(v)), 0, x, points=breaks, limit=200)
        assert float(law.survival(x)) == pytest.approx(1 - area, abs=1e-7)


def test_moments_and_edges_of_a_uniform_law():
    law = interval_law(Schedule("random", 60.0, 90.0))
    low, high = soft_limits(Schedule("random", 60.0, 90.0))
    assert law.lo <= low and law.hi >= high
    assert (law.lo, law.hi) == pytest.approx((60.0, 90.0), abs=0.015)
    assert law.mean == pytest.approx(75.0, abs=0.01)
    assert isinstance(law, Table)
    assert law.sd == pytest.approx(30 / np.sqrt(12), rel=1e-3)
    assert float(law.density(75.0)) == pytest.approx(1 / 30, rel=1e-3)


def test_first_density_integrates_to_one():
    for law in (uniform_law(1.0, 2.0), Stable(3.0, 0.2), Poisson(2.0)):
        for at_start in (True, False):
            top = 60.0 if isinstance(law, Poisson) else law.hi
            x = np.linspace(0, top, 200_001)
            area = np.trapezoid(law.first_density(x, at_start), x)
            assert area == pytest.approx(1.0, abs=1e-4)


def test_poisson_schedule_and_slack():
    assert interval_law(Schedule("poisson", 30.0)) == Poisson(30.0)
    wide = interval_law(Schedule("random", 60.0, 90.0), slack=1.0)
    assert wide.lo < 59.0 and wide.hi > 91.0


def test_refuses_what_is_no_law():
    with pytest.raises(InputError, match="ascend"):
        Table((1.0, 1.0), (1.0, 1.0))
    with pytest.raises(InputError, match="zero or more, and not all zero"):
        Table((1.0, 2.0), (0.0, 0.0))
    with pytest.raises(InputError, match="quarter"):
        Stable(1.0, 0.5)
    with pytest.raises(InputError, match="not positive"):
        Poisson(0.0)
    with pytest.raises(InputError, match="expiry"):
        uniform_law(1.0, 2.0, expiry=-1.0)
