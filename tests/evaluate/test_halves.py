"""Halves of the receivers: who is in which, and differences against what was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from maloc import plots
from maloc.data import ArrivalTimes, Receivers
from maloc.errors import InputError
from maloc.evaluate import every_other, half_of, halves, named_half, random_half, receiver_offsets

NAMES = np.array(list("ABCDEFGHIJ"))


def arrivals(n=40, p=1.0, names=NAMES, seed=0):
    """Any arrival times (n, R), a share p of them heard."""
    rng = np.random.default_rng(seed)
    toa = 30.0 * np.arange(n)[:, None] + rng.uniform(0.1, 0.2, (n, len(names)))
    toa[rng.random(toa.shape) > p] = np.nan
    place = np.arange(len(names), dtype=float)
    return ArrivalTimes(toa, Receivers(names, place, place**2), np.full(n, 1500.0))


class Track:
    """A track with given positions (P, 2) and standard deviations (2,), at heard pings."""

    def __init__(self, toa, place, sd):
        known = toa.n_heard > 0
        self.place, self.covariance = place[known], np.diag(np.square(sd)) + np.zeros((1, 1, 1))

    def positions(self):
        covariance = np.broadcast_to(self.covariance, (len(self.place), 2, 2))
        return self.place, covariance, self.place, self.place


def test_every_other_receiver_and_all_deployments_of_it():
    names = np.array(["A", "B", "B", "C", "D"])
    open_start, cut, open_end = -(2**63), 10**18, 2**63 - 1
    start = np.array([open_start, open_start, cut, open_start, open_start])
    end = np.array([open_end, cut, open_end, open_end, open_end])
    table = Receivers(names, np.arange(5.0), np.zeros(5), start=start, end=end)
    assert every_other(table).tolist() == [True, False, False, True, False]
    assert named_half(table, ["B", "D"]).tolist() == [False, True, True, False, True]
    drawn = [random_half(np.random.default_rng(s), table) for s in range(20)]
    assert {len(table.subset(d).names) for d in drawn} == {2}
    assert len({tuple(d) for d in drawn}) > 3
    with pytest.raises(InputError, match="receiver X is not in the table"):
        named_half(table, ["A", "X"])


def test_a_half_has_the_same_pings_and_its_own_columns():
    toa = arrivals(p=0.4)
    toa = toa.replace(clock_sd=np.arange(10.0) + np.zeros((40, 1)))
    first = every_other(toa.receivers)
    a, b = half_of(toa, first), half_of(toa, ~first)
    np.testing.assert_array_equal(a.toa, toa.toa[:, ::2])
    np.testing.assert_array_equal(b.toa, toa.toa[:, 1::2])
    assert a.receivers.names == tuple("ACEGI") and list(np.asarray(b.clock_sd)[0]) == [
        1,
        3,
        5,
        7,
        9,
    ]
    np.testing.assert_array_equal(a.ping, toa.ping)


@pytest.mark.parametrize("wrong", [1.0, 3.0])
def test_chi_square_is_that_of_what_was_drawn(wrong):
    """Errors drawn with `wrong` times the stated sd give its square, and a normal law's share."""
    from scipy.stats import norm

    toa, rng = arrivals(4000), np.random.default_rng(1)
    sds = iter([np.array([2.0, 0.5]), np.array([1.0, 1.5])])

    def fit(part):
        sd = next(sds)
        truth = np.column_stack([np.arange(4000.0), np.sin(np.arange(4000.0))])
        return Track(part, truth + wrong * sd * rng.standard_normal((4000, 2)), sd)

    found = halves(toa, fit)
    s = found.scores
    # 4000 squares of a normal: standard error of their mean sqrt(2 / 4000) = .022
    assert s["chi2_x"] == pytest.approx(wrong**2, rel=0.1)
    assert s["chi2_y"] == pytest.approx(wrong**2, rel=0.1)
    share = 1 - 2 * norm.sf(1.96 / wrong)
    assert s["within_x"] == pytest.approx(share, abs=0.03)
    assert s["sd"] == pytest.approx(np.sqrt(4 + 1 + 0.25 + 2.25))
    rows = found.rows
    far = np.hypot(rows["x_a"] - rows["x_b"], rows["y_a"] - rows["y_b"])
    assert s["worst"] == pytest.approx(far.max()) and s["median"] == pytest.approx(np.median(far))
    assert found.receivers == (tuple("ACEGI"), tuple("BDFHJ"))


def test_only_pings_that_enough_receivers_of_both_halves_heard():
    toa = arrivals(200, p=0.7, seed=3)
    place = np.random.default_rng(0).normal(size=(200, 2))
    found = halves(toa, lambda part: Track(part, place, [1.0, 1.0]), least=4)
    heard = np.isfinite(toa.toa)
    both = (heard[:, ::2].sum(1) >= 4) & (heard[:, 1::2].sum(1) >= 4)
    assert 0 < both.sum() < 200
    assert found.rows["ping"].to_list() == toa.ping[both].tolist()
    assert found.rows["n_a"].to_list() == heard[both][:, ::2].sum(1).tolist()
    assert found.scores["worst"] == 0.0  # both tracks are the same, rows are not mixed up


def test_too_few_receivers_are_refused_before_anything_is_fitted():
    def never(part):
        raise AssertionError("fitted")

    with pytest.raises(InputError, match="3 receivers of one half .B, D, F. heard it.*need 4 in"):
        halves(arrivals(names=NAMES[:7]), never)
    with pytest.raises(InputError, match="no ping was heard by 4 receivers of both halves"):
        halves(arrivals(4, p=0.5), never)
    with pytest.raises(InputError, match="2 receivers tell no position"):
        halves(arrivals(), never, least=2)


def residuals(rng, n, r, memory):
    """AR(1) residuals (n, r) of sd 1 with memory of so many pings, 0 for none."""
    z = rng.standard_normal((n, r))
    rho = np.exp(-1 / memory) if memory else 0.0
    for i in range(1, n):
        z[i] = rho * z[i - 1] + np.sqrt(1 - rho**2) * z[i]
    return z


@pytest.mark.parametrize(("memory", "most"), [(0, 0.035), (5, 0.07)])
def test_right_receivers_are_seldom_named(memory, most):
    """A hundredth of arrays, stated; short series with memory somewhat more often."""
    rng = np.random.default_rng(5)
    named = 0
    for _ in range(300):
        late = residuals(rng, 400, 6, memory)
        named += receiver_offsets(late, np.ones_like(late), list("ABCDEF"))["far"].any()
    assert named / 300 < most


def test_a_receiver_that_is_late_for_good_is_named_with_its_metres():
    rng = np.random.default_rng(6)
    late = residuals(rng, 400, 6, 5)
    late[:, 3] += 1.5
    p = np.ones_like(late)
    late[::7, 0], p[::7, 0] = 80.0, 0.01  # reflections that the fit knew
    late[8:, 5] = np.nan
    found = receiver_offsets(late / 1500.0, p, list("ABCDEF"), 1500.0)
    assert found.filter("far")["receiver"].to_list() == ["D"]
    first = found.row(0, named=True)
    assert first["receiver"] == "D" and first["median"] == pytest.approx(1.5, abs=3 * first["se"])
    assert found.row(-1, named=True) == {
        "receiver": "F", "n": 8, "median": None, "se": None, "z": None, "far": False
    }  # fmt: skip


def test_the_standard_error_of_a_median_is_what_medians_vary_by():
    rng = np.random.default_rng(7)
    late = residuals(rng, 500, 400, 4)
    found = receiver_offsets(late, np.ones_like(late), [str(j) for j in range(400)])
    assert np.median(found["se"]) == pytest.approx(np.median(late, axis=0).std(), rel=0.15)


def test_the_figure_shows_both_axes_of_every_ping():
    toa, rng = arrivals(60), np.random.default_rng(2)
    found = halves(toa, lambda part: Track(part, 30 * rng.standard_normal((60, 2)), [1.0, 1.0]))
    ax = plots.halves(found, ax=Figure().add_subplot())
    drawn = [c.get_offsets() for c in ax.collections]
    for points, name in zip(drawn, ("z_x", "z_y"), strict=True):
        np.testing.assert_allclose(np.asarray(points)[:, 1], found.rows[name])
    assert ax.get_yscale() == "symlog"
