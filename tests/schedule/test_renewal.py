"""The renewal likelihood of gaps against simulation, closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from maloc._jax import jax, jnp
from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.schedule.intervals import IntervalLaw, Poisson, Stable, Table, uniform_law
from maloc.schedule.renewal import (
    Gap,
    Gaps,
    draw_missed,
    gap_log_likelihood,
    gap_nodes,
    missed_mean,
    missed_pmf,
    pack_gaps,
)
from maloc.schedule.renewal.gap import needed
from maloc.schedule.renewal.grid import grid_of
from maloc.schedule.renewal.long import LongPart
from maloc.schedule.renewal.pack import exact_part
from maloc.schedule.signal import interval_sum_density
from tests.oracles import missed_by_simulation

LAW = uniform_law(1.0, 2.0, edge=1e-6)
INTO_ARRAY = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0, 12.2)
LOG_Q = np.log([0.3, 0.2, 0.6, 0.9, 0.5, 0.4, 0.2, 0.3, 0.9, 0.5])


likelihood = jax.jit(gap_log_likelihood)
counts = jax.jit(missed_pmf, static_argnums=2)
mean_count = jax.jit(missed_mean)


def inside(rng, n):
    return rng.uniform(1.0, 2.0, n)


def packed(durations, kind="inside", law: IntervalLaw = LAW, path=None, first=False):
    """Gaps laid end to end, and log q at their states: `path` of the time in the gap."""
    gaps, log_q, n = [], [], 0
    for duration in durations:
        nodes = gap_nodes(duration, kind, law)
        gaps.append(Gap(kind, duration, nodes, n + np.arange(len(nodes)), first))
        log_q.append(np.zeros(len(nodes)) if path is None else path(nodes))
        n += len(nodes)
    return pack_gaps(gaps, law), jnp.asarray(np.concatenate([*log_q, np.zeros(1)]))


def constant(value):
    return lambda s: np.full(np.shape(s), np.log(value))


def varying(s):
    return np.interp(s, INTO_ARRAY, LOG_Q)


CASES = [
    *[("inside", 2.2, constant(1.0)), ("inside", 3.4, constant(1.0))],
    *[("inside", 5.7, constant(0.3)), ("inside", 12.2, constant(0.3))],
    *[("inside", 4.0, varying), ("inside", 7.3, varying), ("inside", 12.2, varying)],
    *[("after", 3.3, varying), ("after", 12.0, varying), ("after", 12.0, constant(0.9))],
    *[("before", 3.3, varying), ("before", 12.0, varying)],
]


def simulated(kind, duration, log_q, draws, law=LAW, draw=inside, first=False):
    """Oracle of one gap; q is linear in log between the gap's nodes, as in the likelihood."""
    nodes = gap_nodes(duration, kind, law)

    def q(s):
        return np.exp(np.interp(s, nodes, log_q(nodes)))

    rng = np.random.default_rng(5)
    if kind != "before":
        end = law.density if kind == "inside" else law.survival
        return missed_by_simulation(rng, draw, q, duration, end, draws)
    alone = lambda x: law.first_density(x, first)  # noqa: E731
    # first ping's density by weights: uniform on the gap times the density
    weights: list[np.ndarray] = []

    def start(rng, n):
        at = rng.uniform(0.0, min(duration, law.hi), n)
        weights.append(alone(at) * min(duration, law.hi))
        return at

    def weighted_q(s):  # the first call carries the weight of the proposal
        return q(s) * (weights.pop() if weights else 1.0)

    ends = (alone, law.density)
    return missed_by_simulation(rng, draw, weighted_q, duration, ends, draws, start)


@pytest.mark.parametrize(
    ("kind", "duration", "log_q"),
    [
        case if i % 3 == 2 else pytest.param(*case, marks=pytest.mark.extended)
        for i, case in enumerate(CASES)
    ],
)
def test_likelihood_and_counts_agree_with_simulation(kind, duration, log_q):
    gaps, at_states = packed([duration], kind, path=log_q)
    mean, se, by_count = simulated(kind, duration, log_q, 1_000_000)
    ours = float(likelihood(gaps, at_states)[0])
    assert abs(ours - np.log(mean)) < 0.01 + 2 * se / mean
    pmf = np.asarray(counts(gaps, at_states, 15)[0])
    assert pmf.sum() == pytest.approx(1.0, abs=1e-9)
    expected = np.zeros(16)
    expected[: len(by_count)] = by_count / by_count.sum()
    np.testing.assert_allclose(pmf, expected, atol=0.01)
    assert float(mean_count(gaps, at_states)[0]) == pytest.approx(pmf @ np.arange(16), abs=1e-8)


@pytest.mark.parametrize("law", [uniform_law(0.0, 3.0), Table((0.5, 1, 4), (0, 1, 0))])
def test_other_laws_agree_with_simulation(law):
    x, cdf = np.array(law.x), np.linspace(law.lo, law.hi, 4001)
    table = np.cumsum(np.interp(cdf, x, law.values))

    def draw(rng, n):
        return np.interp(rng.uniform(0, table[-1], n), table, cdf)

    gaps, at_states = packed([6.3], law=law, path=varying)
    mean, se, _ = simulated("inside", 6.3, varying, 200_000, law, draw)
    ours = float(likelihood(gaps, at_states)[0])
    assert abs(ours - np.log(mean)) < 0.015 + 4 * se / mean


def test_constant_q_agrees_with_sums_of_uniforms():
    schedule = Schedule("random", 20.0, 40.0)
    law = uniform_law(20.0, 40.0, edge=1e-4)
    durations = np.array([47.0, 71.0, 150.0, 243.0])
    gaps, log_q = packed(durations, law=law, path=constant(0.4))
    n = np.arange(15)[:, None]
    exact = np.sum(0.4**n * interval_sum_density(n, durations[None], schedule), axis=0)
    np.testing.assert_allclose(likelihood(gaps, log_q)[:4], np.log(exact), atol=0.02)


def test_silence_is_certain_where_nobody_can_hear():
    for kind, value in (("after", 1.0), ("before", 1 / LAW.mean)):
        gaps, log_q = packed([3.3, 12.0, 20.0], kind)
        found = np.exp(likelihood(gaps, log_q)[:3])
        np.testing.assert_allclose(found, value, rtol=1e-3)


WIDE = pytest.param(uniform_law(0, 3), marks=pytest.mark.extended)


@pytest.mark.parametrize("law", [LAW, Poisson(1.5, 0.05), Stable(1.5, 0.1), WIDE])
def test_gradient_and_curvature_agree_with_differences(law):
    gaps, log_q = packed([4.4, 9.3, 33.0], law=law, path=varying)

    @jax.jit
    def total(v):
        return gap_log_likelihood(gaps, v).sum()

    gradient = jax.jit(jax.grad(total))
    direction = jnp.asarray(np.random.default_rng(1).normal(size=len(log_q)))
    ahead, behind = log_q + 1e-5 * direction, log_q - 1e-5 * direction
    slope = (total(ahead) - total(behind)) / 2e-5
    assert float(gradient(log_q) @ direction) == pytest.approx(float(slope), rel=1e-6, abs=1e-7)
    curvature = jax.jit(lambda d: jax.linearize(jax.grad(total), log_q)[1](d))
    bend = (gradient(ahead) - gradient(behind)) / 2e-5
    np.testing.assert_allclose(curvature(direction), bend, atol=1e-5)


def test_long_gaps_agree_with_the_exact_recursion():
    rng = np.random.default_rng(3)
    for duration in (16.0, 30.0):
        nodes = gap_nodes(duration, "inside", LAW)
        gap = Gap("inside", duration, nodes, np.arange(len(nodes)))
        walk = np.cumsum(rng.normal(0, 0.15, len(nodes)))
        log_q = jnp.asarray(-np.exp(-0.5 + walk))
        gaps = pack_gaps([gap], LAW)
        assert isinstance(gaps.parts[-1], LongPart) and gaps.parts[-1].index[0] == 0
        grid = grid_of(LAW)
        part, _ = exact_part([(0, gap)], LAW, grid, -(-needed(gap, LAW, grid) // grid.block), 1, 1)
        exact = Gaps((part,), np.zeros(1), np.zeros(1, bool), np.ones(1, bool), LAW)
        ours, dense = likelihood(gaps, log_q)[0], likelihood(exact, log_q)[0]
        assert abs(float(ours - dense)) < 0.08


def test_very_long_gaps_stay_finite():
    for law in (LAW, Poisson(1.5), Stable(1.5, 0.02)):
        gaps, log_q = packed([6000.0], law=law, path=constant(0.3))
        assert len(log_q) <= 67
        assert np.isfinite(likelihood(gaps, log_q)[0])
        assert 0 < float(mean_count(gaps, log_q)[0]) < 6000


def test_poisson_and_stable_closed_forms():
    law = Poisson(2.0)
    gaps, log_q = packed([7.0], law=law, path=constant(0.4))
    assert float(likelihood(gaps, log_q)[0]) == pytest.approx(np.log(0.5) - 0.5 * 7 * 0.6)
    assert float(mean_count(gaps, log_q)[0]) == pytest.approx(0.5 * 7 * 0.4)
    law = Stable(2.0, 0.1)
    gaps, log_q = packed([8.1], law=law, path=constant(0.4))
    m = np.arange(1, 8)
    exact = np.sum(0.4 ** (m - 1) * stats.norm.pdf(8.1, 2.0 * m, 0.1 * np.sqrt(m)))
    assert float(likelihood(gaps, log_q)[0]) == pytest.approx(np.log(exact))


@pytest.mark.parametrize("kind", ["inside", "after", "before"])
def test_draws_follow_the_simulated_times(kind):
    gaps, log_q = packed([6.4] * 1500, kind, path=varying)
    drawn = draw_missed(np.random.default_rng(2), gaps, log_q)
    n = np.array([len(t) for t in drawn])
    pmf = np.asarray(counts(gaps, log_q, 8)[0])
    se = np.sqrt(pmf * (1 - pmf) / len(n))
    np.testing.assert_array_less(np.abs(np.bincount(n, minlength=9) / len(n) - pmf), 4 * se + 1e-3)
    assert all(np.all((np.diff(t) > 0.99) & (np.diff(t) < 2.01)) for t in drawn)
    # brute force: expected misses up to a time, from derivatives of the likelihood by state
    by_state = jax.jit(jax.grad(lambda v: gap_log_likelihood(gaps, v)[0]))(log_q)
    nodes = gap_nodes(6.4, kind, LAW)
    hats = [np.interp(np.concatenate(drawn), nodes, row).sum() / 1500 for row in np.eye(len(nodes))]
    np.testing.assert_allclose(hats, by_state[: len(nodes)], atol=0.06)


def test_impossible_gap_has_the_floor_and_is_flagged():
    law = uniform_law(10.0, 12.0)
    gaps, log_q = packed([7.0, 15.0, 11.0, 22.0, 27.0], law=law, path=constant(0.5))
    assert list(gaps.impossible[:5]) == [True, True, False, False, True]
    assert np.all(np.isfinite(likelihood(gaps, log_q)))


def test_padding_gives_nothing_and_shapes_can_be_shared():
    gaps, log_q = packed([4.4, 9.3], path=varying)
    assert np.all(np.asarray(likelihood(gaps, log_q))[2:] == 0)
    small = pack_gaps([], LAW, like=gaps)
    assert jax.tree.map(np.shape, small) == jax.tree.map(np.shape, gaps)


def test_refuses_what_is_no_gap():
    with pytest.raises(InputError, match="not inside, before or after"):
        gap_nodes(3.0, "between", LAW)
    with pytest.raises(InputError, match="zero or more"):
        gap_nodes(-1.0, "inside", LAW)
