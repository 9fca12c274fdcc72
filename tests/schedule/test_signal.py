"""Missed pings between heard ones: against fractions, brute force, rejection and case 11."""

import csv
from fractions import Fraction

import numpy as np
import pytest
from scipy import integrate, stats

from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.schedule.signal import (
    draw_missed_times,
    estimate_p_missed,
    interval_sum_density,
    missed_counts,
    soft_limits,
)
from maloc.schedule.sums import log_uniform_sum
from tests import oracles

RANDOM = Schedule("random", 60.0, 180.0)
STABLE = Schedule("stable", 30.0, 0.4)
FALSE_ALARM = 1e-6  # of each random check; every seed is fixed, so it fails for good or never

# -- sums of intervals -------------------------------------------------------------------------


@pytest.mark.parametrize("m", [1, 2, 3, 7, 20, 51, 120])
def test_uniform_sums_are_irwin_halls(m):
    x = np.unique(np.r_[m * np.array([0.001, 0.02, 0.11, 0.3, 0.5, 0.77, 0.98]), 0.5, m - 0.25])
    want = [oracles.uniform_sum_density(m, Fraction(float(v))) for v in x]
    got = np.exp(log_uniform_sum(m, x, 0.0))
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_uniform_sums_far_out_do_not_underflow():
    # x^(m - 1) / (m - 1)! below 1
    got = log_uniform_sum(120, np.array([1e-4]), 0.0)[0]
    want = 119 * np.log(1e-4) - np.sum(np.log(np.arange(1, 120)))
    assert got == pytest.approx(want, rel=1e-12)
    assert log_uniform_sum(5, np.array([-0.1, 5.1]), 0.0).tolist() == [-np.inf, -np.inf]


@pytest.mark.parametrize("m", [1, 2, 6, 30])
@pytest.mark.parametrize("slack", [1e-3, 0.2, 1.7])
def test_slack_is_one_more_uniform(m, slack):
    for x in (-0.1, 0.1, m / 3, m / 2, m - 0.3, m + 0.1):
        low, high = x - slack, x + slack
        knots = [k for k in range(m + 1) if low < k < high]
        area, _ = integrate.quad(
            lambda v: oracles.uniform_sum_density(m, Fraction(v)) if 0 <= v < m else 0.0,
            low,
            high,
            points=knots or None,
            epsrel=1e-10,
        )
        got = np.exp(log_uniform_sum(m, np.array([x]), slack))[0]
        assert got == pytest.approx(area / (2 * slack), rel=1e-7, abs=1e-12)


def test_normal_beyond_the_exact_range_joins_on():
    sd = np.sqrt(300 / 12)
    x = 150 + sd * np.linspace(-3, 3, 13)
    exact = log_uniform_sum(300, x, 0.0)
    normal = stats.norm.logpdf(x, 150, sd)
    np.testing.assert_allclose(exact, normal, atol=0.015)
    beyond = log_uniform_sum(301, x + 0.5, 0.0)
    np.testing.assert_allclose(beyond, exact, atol=0.02)


@pytest.mark.parametrize("schedule", [RANDOM, STABLE])
@pytest.mark.parametrize("n", [0, 1, 4])
def test_density_of_a_gap_integrates_to_one_with_the_right_moments(schedule, n):
    gap = np.linspace(0, 1200, 240_001)
    density = interval_sum_density(n, gap, schedule)
    step = gap[1]
    assert np.sum(density) * step == pytest.approx(1, abs=1e-4)
    first, second = soft_limits(schedule)
    mean = first if schedule is STABLE else (first + second) / 2
    variance = second**2 if schedule is STABLE else (second - first) ** 2 / 12
    assert np.sum(density * gap) * step == pytest.approx((n + 1) * mean, rel=1e-4)
    got = np.sum(density * (gap - (n + 1) * mean) ** 2) * step
    assert got == pytest.approx((n + 1) * variance, rel=1e-3)


def test_density_broadcasts():
    table = interval_sum_density([[0], [1], [2]], [100.0, 200.0], RANDOM)
    assert table.shape == (3, 2)
    assert table[1, 1] == interval_sum_density(1, 200.0, RANDOM)
    assert table[0, 1] == 0


def test_soft_limits_are_as_stated():
    np.testing.assert_allclose(soft_limits(RANDOM), (60 - 0.005 - 0.006, 180 + 0.005 + 0.018))
    mean, sd = soft_limits(STABLE)
    assert mean == 30 and sd == pytest.approx(np.hypot(0.4, 0.008))


# -- counts ------------------------------------------------------------------------------------


@pytest.mark.parametrize("lo, hi, gap", [(1.0, 2.0, 7.3), (1.0, 2.0, 12.05), (0.5, 3.0, 6.0)])
def test_counts_equal_brute_force(lo, hi, gap):
    rng = np.random.default_rng(1)
    gaps, missed = oracles.simulate_gaps(rng, lo, hi, 0.6, 3_000_000)
    near = missed[np.abs(gaps - gap) < 0.02]
    counts = missed_counts([gap], Schedule("random", lo, hi), 0.6)
    seen = np.bincount(near, minlength=41)[counts.least[0] : counts.most[0] + 1]
    assert seen.sum() == len(near) > 500
    # 5 ms of soft edge move the densities by < 1 %
    expected = counts.pmf[0] * len(near)
    keep = expected > 5
    expected = expected[keep] * seen[keep].sum() / expected[keep].sum()
    assert stats.chisquare(seen[keep], expected).pvalue > FALSE_ALARM
    sd_of_mean = near.std() / len(near) ** 0.5
    assert counts.mean[0] == pytest.approx(near.mean(), abs=5 * sd_of_mean + 0.01)
    assert counts.most_probable[0] == np.bincount(near).argmax()
    assert counts.pmf[0].sum() == pytest.approx(1)


def test_counts_of_a_stable_schedule():
    gaps = np.array([30.2, 59.5, 300.0, 45.0, 900.0])
    counts = missed_counts(gaps, STABLE, 0.3)
    assert counts.most_probable.tolist()[:3] == [0, 1, 9]
    assert counts.outside.tolist() == [False, False, False, True, False]
    assert counts.determined.tolist() == [True, True, True, False, True]
    # an sd as wide as this leaves several counts, weighed by density and chance
    wide = Schedule("stable", 30.0, 4.0)
    got = missed_counts([300.0], wide, 0.4)
    n = np.arange(got.least[0], got.most[0] + 1)
    sd = soft_limits(wide)[1]
    weight = stats.norm.pdf(300, 30 * (n + 1), sd * np.sqrt(n + 1)) * 0.4**n
    np.testing.assert_allclose(got.pmf[0], weight / weight.sum(), rtol=1e-9)
    assert got.least[0] < 8 and got.most[0] > 10


def test_limits_are_sharp_and_their_breach_is_flagged():
    counts = missed_counts([59.0, 59.99, 60.0, 180.02, 190.0, 119.98, 360.0], RANDOM, 0.2)
    assert counts.outside.tolist() == [True, False, False, False, False, False, False]
    assert counts.least.tolist() == [0, 0, 0, 0, 1, 0, 1]
    assert counts.most.tolist() == [0, 0, 0, 2, 2, 1, 5]
    tight = Schedule("random", 100.0, 110.0)
    counts = missed_counts([50.0, 112.0, 190.0, 199.0], tight, 0.2)
    assert counts.outside.all()
    assert counts.least.tolist() == counts.most.tolist() == [0, 0, 1, 1]
    assert [part.tolist() for part in counts.pmf] == [[1.0]] * 4
    assert not counts.determined.any()
    # the same gaps, told that they may be off
    counts = missed_counts([112.0, 199.0], tight, 0.2, slack=3.0)
    assert not counts.outside.any() and counts.most.tolist() == [0, 1]


def test_chances_by_gap_and_at_the_ends():
    gaps = [400.0, 400.0, 400.0]
    counts = missed_counts(gaps, RANDOM, [0.0, 0.5, 1.0])
    assert counts.mean[0] < counts.mean[1] < counts.mean[2]
    assert counts.most_probable.tolist()[0] == counts.least[0] == 2
    assert counts.mean[0] == pytest.approx(2, abs=1e-6)
    assert len(counts) == 3


def test_no_gaps():
    counts = missed_counts([], RANDOM, 0.1)
    assert len(counts) == 0 and counts.pmf == ()
    assert estimate_p_missed([], RANDOM) == 0.5


@pytest.mark.parametrize("schedule", [RANDOM, STABLE], ids=["random", "stable"])
@pytest.mark.parametrize("p", [0.02, 0.3, 0.8])
def test_chance_of_a_miss_is_recovered(schedule, p):
    rng = np.random.default_rng(5)
    missed = rng.geometric(1 - p, 2000) - 1
    if schedule is RANDOM:
        gaps = np.array([rng.uniform(60, 180, n + 1).sum() for n in missed])
    else:
        gaps = np.array([rng.normal(30, 0.4, n + 1).sum() for n in missed])
    exact = missed.sum() / (missed.sum() + 2000)  # with all counts known
    sd = np.sqrt(p * (1 - p) / (2000 / (1 - p)))
    got = estimate_p_missed(gaps, schedule)
    assert abs(got - p) < 5 * (2 if schedule is RANDOM else 1) * sd
    if schedule is STABLE:
        assert got == pytest.approx(exact, abs=1e-3)
    counts = missed_counts(gaps, schedule, got)
    assert counts.mean.sum() == pytest.approx(missed.sum(), rel=0.1, abs=6)
    # a maximum: no neighbour is better
    assert not counts.outside.any()


def test_chance_of_a_miss_is_the_maximum():
    gaps = np.array([100.0, 250.0, 700.0, 130.0, 340.0])
    first = estimate_p_missed(gaps, RANDOM)

    def score(p):
        counts = missed_counts(gaps, RANDOM, p)
        total = 0.5 * np.log(p * (1 - p))
        for gap, least, most in zip(gaps, counts.least, counts.most, strict=True):
            n = np.arange(least, most + 1)
            total += np.log(np.sum(interval_sum_density(n, gap, RANDOM) * p**n * (1 - p)))
        return total

    grid = np.linspace(0.001, 0.999, 999)
    assert abs(grid[np.argmax([score(p) for p in grid])] - first) < 1e-3


def test_never_missed_is_small_but_not_zero():
    assert 0 < estimate_p_missed(np.full(50, 75.0), RANDOM) < 0.02


# -- case 11 -----------------------------------------------------------------------------------


def test_case_11(shared_dir):
    folder = shared_dir / "cases" / "11-burst-240-360-missed"
    with (folder / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    gaps = np.array([float(row["seconds"]) for row in rows])
    schedule = Schedule("random", 240.0, 360.0)
    chance = estimate_p_missed(gaps, schedule)
    assert 0.3 < chance < 0.75  # 19 of 34 were missed
    counts = missed_counts(gaps, schedule, chance)
    assert counts.least.tolist() == [int(row["min_missed"]) for row in rows]
    assert counts.most.tolist() == [int(row["max_missed"]) for row in rows]
    assert counts.determined.tolist() == [row["determined"] == "True" for row in rows]
    assert counts.determined.sum() == 12
    assert not counts.outside.any()
    for g, row in enumerate(rows):
        true = int(row["true_missed"])
        assert counts.pmf[g][true - counts.least[g]] > 0.05
    rng = np.random.default_rng(0)
    for g, gap in enumerate(gaps):
        n = int(counts.most_probable[g])
        times = draw_missed_times(rng, gap, n, schedule, 50)
        ends = np.full((50, 1), gap)
        steps = np.diff(np.concatenate([0 * ends, times, ends], axis=1))
        assert steps.min() >= 240 and steps.max() <= 360


# -- draws -------------------------------------------------------------------------------------


def _steps(times, gap):
    ends = np.full((len(times), 1), gap)
    return np.diff(np.concatenate([0 * ends, times, ends], axis=1))


@pytest.mark.parametrize("m, share", [(2, 0.3), (3, 0.5), (4, 0.2), (5, 0.75), (8, 0.45)])
def test_draws_equal_rejection_sampling(m, share):
    gap = m * (60 + share * 120)
    times = draw_missed_times(np.random.default_rng(2), gap, m - 1, RANDOM, 8000)
    assert times.shape == (8000, m - 1)
    steps = _steps(times, gap)
    want = oracles.intervals_given_sum(np.random.default_rng(3), 60.0, 180.0, m, gap, 8000)
    views = [lambda x, k=k: x[:, k] for k in range(m)]  # each, then jointly
    views += [lambda x: x[:, 0] * x[:, 1], lambda x: x.max(axis=1), lambda x: x.min(axis=1)]
    for view in views:
        assert stats.ks_2samp(view(steps), view(want)).pvalue > FALSE_ALARM  # type: ignore


@pytest.mark.parametrize("m", [12, 60, 100])
def test_many_intervals_given_their_sum_are_exchangeable(m):
    """Without a preferred place: first, middle and last interval have one distribution."""
    for share in (0.05, 0.4) if m < 100 else (0.4,):
        gap = m * (60 + share * 120)
        steps = _steps(draw_missed_times(np.random.default_rng(5), gap, m - 1, RANDOM, 2000), gap)
        for k in (m // 2, m - 2, m - 1):
            assert stats.ks_2samp(steps[:, 0], steps[:, k]).pvalue > FALSE_ALARM  # type: ignore


@pytest.mark.parametrize("m", [2, 12, 60, 320])
@pytest.mark.parametrize("share", [1e-6, 0.5, 0.99])
def test_draws_keep_the_limits_and_the_sum(m, share):
    gap = m * (60 + share * 120)
    times = draw_missed_times(np.random.default_rng(4), gap, m - 1, RANDOM, 20)
    steps = _steps(times, gap)
    assert steps.min() >= 60 - 1e-6 and steps.max() <= 180 + 1e-6
    assert np.all(np.diff(times, axis=1) > 0)


def test_stable_draws_are_a_gaussian_bridge():
    gap, n = 151.0, 4
    times = draw_missed_times(np.random.default_rng(6), gap, n, STABLE, 20_000)
    k = np.arange(1, n + 1)
    sd = soft_limits(STABLE)[1]
    cov = sd**2 * (np.minimum.outer(k, k) - np.outer(k, k) / (n + 1))
    z = np.linalg.solve(np.linalg.cholesky(cov), (times - gap * k / (n + 1)).T)
    for column in z:
        assert stats.kstest(column, "norm").pvalue > FALSE_ALARM
    limit = stats.norm.isf(FALSE_ALARM / 10) * np.sqrt(2 / 20_000)
    assert np.abs(z @ z.T / 20_000 - np.eye(n)).max() < limit


def test_draws_of_an_impossible_gap_are_even():
    times = draw_missed_times(np.random.default_rng(0), 100.0, 4, RANDOM, 3)
    np.testing.assert_allclose(times, np.tile([20.0, 40.0, 60.0, 80.0], (3, 1)))


def test_a_gap_within_the_soft_limits_only():
    times = draw_missed_times(np.random.default_rng(0), 119.99, 1, RANDOM, 100)
    lo, hi = soft_limits(RANDOM)
    assert times.min() >= lo and (119.99 - times).min() >= lo
    assert times.std() > 0


def test_draws_without_order_stay_ordered():
    loose = Schedule("stable", 30.0, 25.0)
    times = draw_missed_times(np.random.default_rng(0), 90.0, 2, loose, 2000)
    assert np.all(np.diff(times, axis=1) > 0) and times.min() > 0 and times.max() < 90


def test_no_missed_pings():
    assert draw_missed_times(np.random.default_rng(0), 100.0, 0, RANDOM, 7).shape == (7, 0)


def test_draws_are_reproducible():
    one, two = (draw_missed_times(np.random.default_rng(9), 500.0, 3, RANDOM, 5) for _ in range(2))
    np.testing.assert_array_equal(one, two)


# -- bad input ---------------------------------------------------------------------------------


def test_bad_input_is_named():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="burst interval is unknown"):
        missed_counts([100.0], Schedule(), 0.1)
    with pytest.raises(InputError, match="burst interval is unknown"):
        draw_missed_times(rng, 100.0, 1, Schedule(), 1)
    for gap in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="gap"):
            estimate_p_missed([100.0, gap], RANDOM)
        with pytest.raises(InputError, match="gap"):
            draw_missed_times(rng, gap, 1, RANDOM, 1)
    with pytest.raises(InputError, match="chance"):
        missed_counts([100.0], RANDOM, 1.1)
    with pytest.raises(InputError, match="2 chances"):
        missed_counts([100.0], RANDOM, [0.1, 0.2])
    with pytest.raises(InputError, match="missed"):
        draw_missed_times(rng, 100.0, -1, RANDOM, 1)
    with pytest.raises(InputError, match="count"):
        interval_sum_density(-1, 100.0, RANDOM)
    with pytest.raises(InputError, match="dimensions"):
        missed_counts([[100.0]], RANDOM, 0.1)
