"""Jumps of clocks that votes do not see: where residuals step, and between which detections.

Reflections are only late, so levels are low quantiles of short runs of detections, not medians.
"""

from __future__ import annotations

import numpy as np

from maloc.sync._arrivals import log_density, low_quantile

__all__ = ["backfit", "date", "steps"]

RUN = 15  # detections whose low quantile is a level
QUANTILE = 0.35
FEWEST = 8  # of fewer too many may be late by chance
CURVED = 1e-5  # change of level that a silent gap explains, s/s
STEEPEST = 1e-5  # of a level about a straight line, s/s
SURE = 6.0  # a step is this many times as large as its error
DOUBT = 4.6  # log likelihood ratio at which a detection still may lie on either side
NEAR = 12  # detections on either side of a jump among which its date is sought


def _level(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low quantile and number of the `RUN` values before each place (N + 1,), with none inf."""
    padded = np.concatenate([np.full(RUN, np.inf), y])
    runs = np.sort(np.lib.stride_tricks.sliding_window_view(padded, RUN), axis=1)
    count = np.minimum(np.arange(len(y) + 1), RUN)
    at = (np.maximum(count - 1, 0) * QUANTILE).astype(int)
    return runs[np.arange(len(runs)), at], count


def _mean(t: np.ndarray) -> np.ndarray:
    """Mean of the `RUN` values before each place (N + 1,)."""
    total = np.concatenate([[0.0], np.cumsum(t - t[0])])
    n = np.arange(len(t) + 1)
    low = np.maximum(n - RUN, 0)
    return t[0] + (total[n] - total[low]) / np.maximum(n - low, 1)


def backfit(y: np.ndarray, ping: np.ndarray, clock: np.ndarray, rounds: int = 4) -> np.ndarray:
    """Emission times (P,) from arrivals whose clocks are off by smooth curves and steps.

    Parameters
    ----------
    y : array (N,)
        Arrival time less travel time by coarse clocks, s; pings ascending.
    ping, clock : array (N,) of int
    rounds : int
    """
    level, emission = np.zeros(len(y)), low_quantile(y, ping)
    rows = [np.flatnonzero(clock == j) for j in np.unique(clock)]
    for _ in range(rounds):
        rest = y - emission[ping]
        for mine in rows:
            # levels of runs that end half a run later
            before, _ = _level(rest[mine])
            at = np.minimum(np.arange(len(mine)) + 1 + RUN // 2, len(mine))
            level[mine] = before[at]
        emission = low_quantile(y - level, ping)
    return emission


def steps(time: np.ndarray, y: np.ndarray, least: float, most: int = 12) -> list[tuple[int, float]]:
    """Steps of one clock's series: (i, size), between detections i - 1 and i, largest first.

    Parameters
    ----------
    time : array (N,)
        Ascending, s.
    y : array (N,)
        Offset, but for a straight line, s.
    least : float
        Smaller steps are none, s.
    most : int
        Number of steps.
    """
    found: list[tuple[int, float]] = []
    y = y.copy()
    n = len(y)
    if n < 2 * FEWEST:
        return found
    time = np.maximum.accumulate(time)
    gap = np.concatenate([[0.0], np.diff(time), [0.0]])
    t_left, t_right = _mean(time), -_mean(-time[::-1])[::-1]
    while len(found) < most:
        (left, n_left), (right, n_right) = _level(y), _right(y)
        with np.errstate(invalid="ignore", divide="ignore"):
            size = right - left
            rate = np.full((2, n + 1), np.nan)
            rate[0, RUN:] = (left[RUN:] - left[:-RUN]) / (t_left[RUN:] - t_left[:-RUN])
            rate[1, :-RUN] = (right[RUN:] - right[:-RUN]) / (t_right[RUN:] - t_right[:-RUN])
        rate[0, : RUN + FEWEST], rate[1, max(n - RUN - FEWEST + 1, 0) :] = np.nan, np.nan
        known = np.isfinite(rate)
        rate = np.clip(rate, -STEEPEST, STEEPEST)
        mean = np.where(known, rate, 0.0).sum(0) / np.maximum(known.sum(0), 1)
        size = size - mean * (t_right - t_left)
        fewest = np.minimum(n_left, n_right)
        ok = (fewest >= FEWEST) & known.any(0) & np.isfinite(size)
        if not ok.any():
            break
        error = 1.4826 * np.median(np.abs(size[ok] - np.median(size[ok])))
        error = error * np.sqrt(RUN / np.maximum(fewest, 1))
        limit = np.maximum(SURE * error, least) + CURVED * gap
        over = np.where(ok, np.abs(size) / limit, 0.0)
        at = int(over.argmax())
        if over[at] <= 1:
            break
        found.append((at, float(size[at])))
        y[at:] -= size[at]
    return found


def _right(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low quantile and number of the values after each place: `_level` from the other end."""
    level, count = _level(y[::-1])
    return level[::-1], count[::-1]


def date(
    rows: np.ndarray,
    first: int,
    size: float,
    apart: np.ndarray,
    sigma: float,
    reflected: float,
) -> tuple[int, int, int]:
    """Between which detections of a clock a jump most likely lies.

    Parameters
    ----------
    rows : array (M,) of int
        The clock's arrivals from the jump before to the jump after, in time order.
    first : int
        Of them, the first after the jump as it is dated now.
    size : float
        Of the jump, s.
    apart : array (N,)
        Residual of each arrival to what the other receivers say, s.
    sigma, reflected : float
        Error sd of direct arrivals (s), share of late ones.

    Returns
    -------
    best, low, high : int
        Number of detections before the jump: most likely, at least and at most.
    """
    begin, end = max(first - NEAR, 0), min(first + NEAR, len(rows))
    near = rows[begin:end]
    after = np.arange(begin, end) >= first
    if_before = apart[near] + np.where(after, size, 0.0)
    if_after = apart[near] - np.where(after, 0.0, size)
    gain = log_density(if_before, sigma, reflected) - log_density(if_after, sigma, reflected)
    score = np.concatenate([[0.0], np.cumsum(gain)])
    best = int(score.argmax())
    likely = np.flatnonzero(score > score[best] - DOUBT)
    return begin + best, begin + int(likely[0]), begin + int(likely[-1])
