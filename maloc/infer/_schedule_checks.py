"""Whether the times between pings, the schedule left out, keep to the schedule."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from maloc.infer._input_scores import Point
from maloc.infer.initial import repair
from maloc.infer.mode import _factor, find_mode

__all__ = ["Gaps", "Outside", "Spread", "implied_gaps", "outside_limits", "spread_of_intervals"]

_TOLERANCE = 0.25  # s beyond a limit; less may be an arrival taken for direct that was late
_FEWEST = 3  # one ping in a wrong place spoils two gaps
_DRAWS = 999
_SD_SPREAD = 1.0  # sd of the log of a stable interval's sd about the stated one, as in the models


class Gaps(NamedTuple):
    """Times (G,) s from each heard ping to the tag's next, their sd, intervals in each or 0."""

    length: np.ndarray
    sd: np.ndarray
    n: np.ndarray


class Outside(NamedTuple):
    """Gaps (G,) bool that no number of intervals explains; smallest count that is too many; p."""

    gaps: np.ndarray
    threshold: int
    p: float


class Spread(NamedTuple):
    """Standard deviation of the burst interval (s); largest that the schedule allows; p."""

    sd: float
    threshold: float
    p: float


def implied_gaps(point: Point, rng: np.random.Generator) -> Gaps:
    """Gaps by the arrivals and the movement alone, the parameters held."""
    cm, data = point.cm, point.args[0]
    free = dataclasses.replace(data, n_intervals=np.zeros_like(data.n_intervals))
    args = (free, *point.args[1:])
    x = repair(cm, args, point.x, point.u)
    x = find_mode(cm, args, x, point.u).x
    factor = _factor(cm.terms(x, point.u, args, 0.0, False)[2], cm.d)
    noise = factor.unwhiten(rng.standard_normal((100, *x.shape)))
    column = next(s.columns.start for s in cm.chain if s.name == "emission")
    speed = np.asarray(data.speed)
    time = x[:, column] / speed + np.asarray(data.time)
    off = noise[:, :, column] / speed
    tag = np.asarray(getattr(data, "tag", np.zeros(len(time))))
    heard = np.flatnonzero(np.asarray(data.heard).any(axis=1) & np.asarray(data.valid))
    one, next_one = heard[:-1], heard[1:]
    same = tag[one] == tag[next_one]
    one, next_one = one[same], next_one[same]
    n = np.asarray(data.n_intervals)
    n = np.where(next_one == one + 1, n[np.minimum(one, len(n) - 1)], 0.0)
    sd = (off[:, next_one] - off[:, one]).std(axis=0)
    return Gaps(time[next_one] - time[one], sd, n)


def _misfit(length, sd, lo: float, hi: float):
    """How far each gap is outside what whole numbers of intervals explain, less its tolerance."""
    few, many = np.maximum(np.floor(length / hi), 1), np.maximum(np.ceil(length / hi), 1)
    off = np.full(np.shape(length), np.inf)
    for m in (few, many):
        off = np.minimum(off, np.maximum(m * lo - length, length - m * hi))
    return off - _TOLERANCE - 3 * sd


def outside_limits(
    gaps: Gaps, lo: float, hi: float, level: float, rng: np.random.Generator
) -> Outside:
    """Gaps beyond the limits of a random burst interval, `lo` to `hi` s."""
    outside = _misfit(gaps.length, gaps.sd, lo, hi) > 0
    m = np.maximum(np.ceil(gaps.length / hi), 1)
    kept = np.clip(gaps.length, m * lo, m * hi)
    drawn = kept + gaps.sd * rng.standard_normal((_DRAWS, len(kept)))
    count = (_misfit(drawn, gaps.sd, lo, hi) > 0).sum(axis=1)
    p = (1 + np.sum(count >= outside.sum())) / (1 + _DRAWS)
    return Outside(outside, max(_FEWEST, int(np.quantile(count, 1 - level)) + 1), float(p))


def _interval_sd(length, n):
    """Sd of one interval by differences of gaps that follow each other: drift cancels."""
    each = length / n
    step = np.diff(each, axis=-1) / np.sqrt(1 / n[1:] + 1 / n[:-1])
    return np.median(np.abs(step), axis=-1) / 0.6745


def spread_of_intervals(
    gaps: Gaps, mean: float, sd: float, level: float, rng: np.random.Generator
) -> Spread:
    """Spread of a burst interval that is said to be stable, of given mean and sd (s)."""
    n = np.where(gaps.n > 0, gaps.n, np.maximum(np.rint(gaps.length / mean), 1))
    found = float(_interval_sd(gaps.length, n))
    sds = sd * np.exp(_SD_SPREAD * rng.standard_normal(_DRAWS))[:, None]
    width = np.sqrt(n * sds**2 + gaps.sd**2)
    drawn = _interval_sd(n * mean + width * rng.standard_normal(width.shape), n)
    p = (1 + np.sum(drawn >= found)) / (1 + _DRAWS)
    return Spread(found, float(np.quantile(drawn, 1 - level)), float(p))
