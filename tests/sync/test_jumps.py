import numpy as np
import pytest

from maloc.sync._jumps import date, steps
from maloc.sync._prepare import _mode


def series(seed, n=300, step=0.0, at=150):
    """Levels that bend slowly, 15 % of the detections late."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.exponential(90.0, n))
    y = 2e-3 * np.sin(t / 9000) + 5e-4 * rng.standard_normal(n)
    late = rng.random(n) < 0.15
    y += np.where(late, rng.uniform(0.015, 0.2, n), 0.0) + step * (np.arange(n) >= at)
    return t, y, late


@pytest.mark.parametrize("step", [0.02, -0.02, 0.5])
def test_step_is_found_where_it_is(step):
    t, y, _ = series(0, step=step)
    [(at, size)] = steps(t, y, 0.008)
    assert abs(at - 150) < 8
    assert size == pytest.approx(step, abs=4e-3)


def test_no_steps_in_series_without():
    assert sum(len(steps(*series(seed)[:2], 0.008)) for seed in range(40)) == 0


def test_date_by_likelihood_and_its_doubt():
    _, y, late = series(1, step=0.05)
    rest = y - 0.05 * (np.arange(300) >= 150)
    off = rest + np.where((np.arange(300) >= 145) & (np.arange(300) < 150), -0.05, 0.0)
    best, low, high = date(np.arange(300), 145, 0.05, off, 7e-4, 0.15)
    before, after = np.flatnonzero(~late[:150])[-1], 150 + np.flatnonzero(~late[150:])[0]
    assert before < best <= after
    assert low <= 150 <= high
    assert high - low <= 3


def test_clocks_that_agree_are_believed():
    assert _mode(np.array([-100.0, -40.0, 0.1, 0.0, 0.2, 7.0, 25.0, 0.15, -9.0])) < 0.2
    assert _mode(np.array([3.0])) == 3.0
