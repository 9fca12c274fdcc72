"""When the tag spoke: burst intervals between heard pings, missed pings summed out.

Between two heard pings lies a gap: the sum of n + 1 burst intervals, n of whose pings nobody
heard. Here the chance p that a ping is heard by nobody is constant, so that n given the gap has the
closed form P(n) ~ p^n (1 - p) f_(n+1)(gap), f_m the density of the sum of m intervals.

Real tags break their stated limits by a few milliseconds, so an interval may pass each limit by
5 ms plus 1e-4 of the limit (`soft_limits`); for a stable schedule the same is added to the sd, in
squares. A gap that no count explains even so keeps the nearest count and is flagged: never a zero
likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit

from maloc.data.arrivals import Schedule
from maloc.errors import InputError
from maloc.schedule.sums import (
    log_density,
    log_uniform_sum,
    log_uniform_sum_slope,
    soft_limits,
)

__all__ = [
    "MissedCounts",
    "draw_missed_times",
    "estimate_p_missed",
    "interval_sum_density",
    "missed_counts",
    "soft_limits",
]

_REACH = 6.0  # sds of a stable schedule's gap that count as feasible
_TINY = 1e-12
_EXACT_DRAWS, _MOST_EXACT_DRAWS = 40, 300  # intervals; the remainder is normal beyond
_MOST_TRIES = 10_000  # of a rejection step; about 2 are needed


def interval_sum_density(n, gap, schedule: Schedule, *, slack: float = 0.0) -> np.ndarray:
    """Density of a gap that holds n missed pings: the sum of n + 1 burst intervals.

    Parameters
    ----------
    n : array of int
        Missed pings, broadcast against `gap`.
    gap : array
        Time from one heard ping to the next, s.
    schedule : Schedule
        Random: intervals uniform between `soft_limits`, summed exactly (positive recursion) up to
        300 intervals, as a normal beyond. Stable: normal.
    slack : float
        How far the gap itself may be off either way, s (uniform): differences of first arrivals
        carry the change of travel time.

    Returns
    -------
    array
        1/s, the broadcast shape.

    Raises
    ------
    InputError
        If the schedule is unknown, or a gap or count is not a non-negative number.
    """
    n, gap = np.broadcast_arrays(np.asarray(n), np.asarray(gap, float))
    if not np.all(n >= 0):
        raise InputError("a count of missed pings is below 0")
    flat = log_density(n.ravel(), _checked(gap.ravel()), schedule, slack)
    return np.exp(flat).reshape(gap.shape)


def _checked(gaps) -> np.ndarray:
    gaps = np.atleast_1d(np.asarray(gaps, float))
    if gaps.ndim != 1:
        raise InputError(f"gaps have {gaps.ndim} dimensions, not 1")
    if not np.all(np.isfinite(gaps) & (gaps >= 0)):
        raise InputError("a gap between pings is not a non-negative number of seconds")
    return gaps


# -- how many were missed ----------------------------------------------------------------------


class _Table(NamedTuple):
    """Every feasible (gap, count) pair, gap after gap; `start[g]:start[g + 1]` is gap g's."""

    least: np.ndarray
    most: np.ndarray
    outside: np.ndarray
    start: np.ndarray
    gap: np.ndarray  # which gap
    n: np.ndarray
    log_density: np.ndarray


def _feasible(gaps, schedule: Schedule, slack: float):
    """Least and most intervals (inclusive) that can make up each gap; least > most: none can."""
    lo, hi = soft_limits(schedule)
    if schedule.kind == "random":
        return np.ceil((gaps - slack) / hi), np.floor((gaps + slack) / lo)
    # |gap - m mean| <= 6 sd sqrt(m), solved for sqrt(m)
    reach = _REACH * hi
    low, high = np.maximum(gaps - slack, 0.0), gaps + slack
    least = ((np.sqrt(reach**2 + 4 * lo * low) - reach) / (2 * lo)) ** 2
    most = ((np.sqrt(reach**2 + 4 * lo * high) + reach) / (2 * lo)) ** 2
    return np.ceil(least - 1e-9), np.floor(most + 1e-9)


def _nearest(gaps, schedule: Schedule) -> np.ndarray:
    """Intervals (>= 1) whose sum comes nearest to each gap."""
    lo, hi = soft_limits(schedule)
    if schedule.kind == "stable":
        return np.maximum(np.rint(gaps / lo), 1)
    under = np.maximum(np.floor(gaps / hi), 1)
    over = np.maximum(np.ceil(gaps / lo), 1)
    return np.where(np.abs(gaps - under * hi) <= np.abs(over * lo - gaps), under, over)


def _table(gaps, schedule: Schedule, slack: float) -> _Table:
    gaps = _checked(gaps)
    least, most = _feasible(gaps, schedule, slack)
    least = np.maximum(least, 1)
    outside = most < least
    nearest = _nearest(gaps, schedule)
    least = np.where(outside, nearest, least).astype(int) - 1
    most = np.where(outside, nearest, most).astype(int) - 1
    size = most - least + 1
    start = np.concatenate([[0], np.cumsum(size)])
    which = np.repeat(np.arange(len(gaps)), size)
    n = np.arange(start[-1]) - start[which] + least[which]
    density = log_density(n, gaps[which], schedule, slack)
    density[outside[which]] = 0.0  # whatever, as long as it is not zero likelihood
    if len(gaps):
        # exactly on the last limit: density 0, yet nothing else explains the gap
        dead = np.maximum.reduceat(density, start[:-1]) == -np.inf
        density[dead[which]] = 0.0
        outside = outside | dead
    return _Table(least, most, outside, start, which, n, density)


@dataclass(frozen=True)
class MissedCounts:
    """How many pings nobody heard in each of G gaps.

    Attributes
    ----------
    least, most : (G,) int
        Feasible counts, inclusive: by the limits (random) or within 6 sd (stable).
    most_probable : (G,) int
        The count of highest probability.
    mean : (G,)
        Expected count.
    pmf : tuple of G arrays
        ``pmf[g][i]`` is the probability of ``least[g] + i`` missed pings.
    outside : (G,) bool
        Gaps that no count explains within the limits; the nearest count stands there.
    """

    least: np.ndarray
    most: np.ndarray
    most_probable: np.ndarray
    mean: np.ndarray
    pmf: tuple[np.ndarray, ...]
    outside: np.ndarray

    def __len__(self) -> int:
        return len(self.least)

    @property
    def determined(self) -> np.ndarray:
        """Where the limits leave one count only, (G,) bool."""
        return (self.least == self.most) & ~self.outside


def _log_joint(table: _Table, p_missed) -> np.ndarray:
    """Log of density x p^n (1 - p) for every feasible pair."""
    p = np.clip(p_missed, _TINY, 1 - _TINY)
    p = p if np.ndim(p) == 0 else p[table.gap]
    return table.log_density + table.n * np.log(p) + np.log1p(-p)


def missed_counts(gaps, schedule: Schedule, p_missed, *, slack: float = 0.0) -> MissedCounts:
    """Numbers of missed pings in gaps, each with its probabilities.

    Parameters
    ----------
    gaps : (G,) array
        Times from each heard ping to the next, s.
    schedule : Schedule
        Burst interval, random or stable.
    p_missed : float or (G,) array
        Chance that a ping is heard by nobody, in [0, 1]; see `estimate_p_missed`.
    slack : float
        How far each gap may be off either way, s.

    Returns
    -------
    MissedCounts

    Raises
    ------
    InputError
        If the schedule is unknown, a gap is no non-negative number or a chance not in [0, 1].
    """
    p_missed = np.asarray(p_missed, float)
    if not np.all((p_missed >= 0) & (p_missed <= 1)):
        raise InputError("the chance that a ping is missed is not in [0, 1]")
    table = _table(gaps, schedule, slack)
    if p_missed.ndim and p_missed.shape != table.least.shape:
        raise InputError(f"{p_missed.size} chances of a miss for {table.least.size} gaps")
    if not len(table.least):
        none = np.zeros(0, int)
        return MissedCounts(none, none, none, np.zeros(0), (), np.zeros(0, bool))
    joint = _log_joint(table, p_missed)
    first = table.start[:-1]
    weight = np.exp(joint - np.maximum.reduceat(joint, first)[table.gap])
    pmf = weight / np.add.reduceat(weight, first)[table.gap]
    parts = tuple(np.split(pmf, table.start[1:-1]))
    best = np.array([int(np.argmax(part)) for part in parts])
    mean = np.add.reduceat(pmf * table.n, first)
    return MissedCounts(table.least, table.most, table.least + best, mean, parts, table.outside)


def estimate_p_missed(gaps, schedule: Schedule, *, slack: float = 0.0) -> float:
    """Chance that a ping is heard by nobody, by maximum marginal likelihood.

    The counts are summed out. Half a heard and half a missed ping are added to the data, so that
    the estimate is never 0 or 1.

    Parameters
    ----------
    gaps : (G,) array
        Times from each heard ping to the next, s.
    schedule : Schedule
        Burst interval, random or stable.
    slack : float
        How far each gap may be off either way, s.

    Returns
    -------
    float
        In (0, 1); 1/2 without any gap.

    Raises
    ------
    InputError
        If the schedule is unknown or a gap is no non-negative number.
    """
    table = _table(gaps, schedule, slack)
    if not len(table.least):
        return 0.5

    def cost(logit) -> float:
        p = expit(logit)
        joint = _log_joint(table, p)
        highest = np.maximum.reduceat(joint, table.start[:-1])
        total = np.add.reduceat(np.exp(joint - highest[table.gap]), table.start[:-1])
        return -float(np.sum(highest + np.log(total)) + 0.5 * np.log(p) + 0.5 * np.log1p(-p))

    grid = np.linspace(-12, 12, 49)  # the likelihood may have more than one mode
    best = grid[np.argmin([cost(value) for value in grid])]
    found = minimize_scalar(cost, bounds=(best - 0.5, best + 0.5), method="bounded")
    return float(expit(found.x))


# -- when they were ----------------------------------------------------------------------------


def draw_missed_times(
    rng: np.random.Generator, gap: float, n: int, schedule: Schedule, size: int
) -> np.ndarray:
    """Draws of the emission times of a gap's missed pings, given how many they are.

    Random schedule: exact draws of the intervals given their sum, one after the other, by rejection
    (the sum of more than 40 remaining intervals is taken as normal where their mean lies in the
    middle of the limits; of more than 300 always). Stable: a Gaussian bridge. Limits are the stated
    ones where these allow the gap, else the soft ones; where not even those do, the pings are
    spaced evenly.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    gap : float
        Time from the heard ping before to the one after, s, positive.
    n : int
        Missed pings.
    schedule : Schedule
        Burst interval, random or stable.
    size : int
        Number of draws.

    Returns
    -------
    (size, n) array
        Seconds after the gap's first ping, ascending in each row.

    Raises
    ------
    InputError
        If the schedule is unknown, the gap is no positive number or `n` is below 0.
    """
    if not (np.isfinite(gap) and gap > 0):
        raise InputError(f"a gap of {gap} s between pings is not positive")
    if n < 0:
        raise InputError(f"{n} missed pings")
    lo, hi = soft_limits(schedule)
    m = n + 1
    if n == 0:
        return np.empty((size, 0))
    if schedule.kind == "stable":
        return _bridge(rng, gap, m, hi, size)
    if m * schedule.lo < gap < m * schedule.hi:
        lo, hi = schedule.lo, schedule.hi
    if not m * lo < gap < m * hi:
        return np.tile(gap / m * np.arange(1, m), (size, 1))
    width = hi - lo
    intervals = lo + width * _uniforms_with_sum(rng, (gap - m * lo) / width, m, size)
    return np.cumsum(intervals[:, :-1], axis=1)


def _bridge(rng, gap: float, m: int, sd: float, size: int) -> np.ndarray:
    """Sums of normal intervals given their total; rows with an interval below 0 are redrawn."""
    out = np.empty((size, m))
    todo = np.arange(size)
    for _ in range(100):
        z = rng.normal(0.0, sd, (len(todo), m))
        out[todo] = gap / m + z - z.mean(axis=1, keepdims=True)
        todo = todo[np.any(out[todo] <= 0, axis=1)]
        if not len(todo):
            break
    out[todo] = gap / m  # an sd as long as the interval: no order to be had
    return np.cumsum(out[:, :-1], axis=1)


def _uniforms_with_sum(rng, total: float, m: int, size: int) -> np.ndarray:
    """Draws (size, m) of m uniforms on (0, 1) given their sum `total` in (0, m).

    Given the rest, the first of k uniforms has density ~ f_(k-1)(rest - u). That is log-concave, so
    a tangent of its log bounds it: a truncated exponential to reject from, close to it for large k.
    """
    out = np.empty((size, m))
    rest = np.full(size, float(total))
    # many intervals of middling length: the normal is as good, and the cost stays linear
    exact = _EXACT_DRAWS if abs(total / m - 0.5) < 0.15 else _MOST_EXACT_DRAWS
    for k in range(m, 2, -1):
        low = np.maximum(rest - (k - 1), 0.0)
        length = np.minimum(rest, 1.0) - low
        touch = np.full(size, 0.5)  # where the tangent touches, in shares of the range
        for _ in range(2):
            at = rest - low - touch * length
            tilt = -log_uniform_sum_slope(k - 1, at, exact) * length
            steep = np.abs(tilt) + 1e-6
            middle = 1 / steep - 1 / np.expm1(np.minimum(steep, 700.0))
            touch = np.where(tilt > 0, 1 - middle, middle)
        at = rest - low - touch * length
        tilt = -log_uniform_sum_slope(k - 1, at, exact) * length
        height = log_uniform_sum(k - 1, at, exact_up_to=exact)
        todo = np.arange(size)
        for _ in range(_MOST_TRIES):
            share = _truncated_exponential(rng, tilt[todo])
            value = rest[todo] - low[todo] - share * length[todo]
            bound = height[todo] + tilt[todo] * (share - touch[todo])
            log_ratio = log_uniform_sum(k - 1, value, exact_up_to=exact) - bound
            out[todo, m - k] = low[todo] + share * length[todo]
            todo = todo[np.log(rng.random(len(todo))) > log_ratio]
            if not len(todo):
                break
        rest = np.clip(rest - out[:, m - k], 0.0, k - 1)
    low = np.maximum(rest - 1, 0.0)
    out[:, -2] = low + (np.minimum(rest, 1.0) - low) * rng.random(size)
    out[:, -1] = rest - out[:, -2]
    return out


def _truncated_exponential(rng, tilt: np.ndarray) -> np.ndarray:
    """Draws on (0, 1) with density ~ exp(tilt u)."""
    steep = np.abs(tilt) + 1e-12
    falling = -np.log1p(rng.random(tilt.shape) * np.expm1(-steep)) / steep
    return np.where(tilt > 0, 1 - falling, falling)
