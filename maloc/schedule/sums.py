"""Densities of sums of burst intervals, exact where they can be.

References
----------
Irwin (1927) and Hall (1927), Biometrika 19: 225-245, for the sum of uniforms; de Boor (1972) On
calculating with B-splines, J. Approx. Theory 6: 50-62, for the recursion, whose terms are all
positive.
"""

from __future__ import annotations

import numpy as np

from maloc.data.arrivals import Schedule
from maloc.errors import InputError

__all__ = ["log_density", "log_uniform_sum", "log_uniform_sum_slope", "soft_limits"]

_EDGE = 5e-3  # s by which real tags break a limit, and
_RELATIVE_EDGE = 1e-4  # the share of the limit (the tag's clock)
_EXACT_UP_TO = 300  # intervals; the sum is taken as normal beyond


def soft_limits(schedule: Schedule) -> tuple[float, float]:
    """Limits that one interval is held to, s.

    Parameters
    ----------
    schedule : Schedule
        "random" or "stable".

    Returns
    -------
    tuple of float
        Random: MIN and MAX, each moved outwards by 5 ms + 1e-4 of itself. Stable: MEAN, and the
        SD with 5 ms + 1e-4 of MEAN added in squares.

    Raises
    ------
    InputError
        If the schedule is unknown, or Poisson: there are no limits.
    """
    if schedule.kind not in ("random", "stable"):
        raise InputError(
            f"the burst interval is {schedule.kind}",
            mend="give it as random MIN MAX or stable MEAN SD",
        )
    if schedule.kind == "stable":
        tolerance = _EDGE + _RELATIVE_EDGE * schedule.lo
        return float(schedule.lo), float(np.hypot(schedule.hi, tolerance))
    lo = (1 - _RELATIVE_EDGE) * schedule.lo - _EDGE
    hi = (1 + _RELATIVE_EDGE) * schedule.hi + _EDGE
    return float(max(lo, 0.1 * schedule.lo)), float(hi)


def splines(m: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cardinal B-splines of order m at x, x - 1, x - 2, ... (..., J), and the log of their scale.

    B_m is the density of the sum of m uniforms on (0, 1).
    """
    shifts = np.arange(max(int(np.max(x, initial=0.0)), 0) + 1)
    y = x[..., None] - shifts
    b = np.where((y >= 0) & (y < 1), 1.0, 0.0)
    log_scale = np.zeros(x.shape)
    for k in range(2, m + 1):
        left = np.concatenate([b[..., 1:], np.zeros((*b.shape[:-1], 1))], axis=-1)
        b = (y * b + (k - y) * left) / (k - 1)
        highest = b.max(axis=-1)
        scale = np.where(highest > 0, highest, 1.0)
        b = b / scale[..., None]
        log_scale = log_scale + np.log(scale)
    return b, log_scale


def log_uniform_sum(
    m: int, x: np.ndarray, slack: float = 0.0, exact_up_to: int = _EXACT_UP_TO
) -> np.ndarray:
    """Log density at x of the sum of m uniforms on (0, 1) and one on (-slack, slack)."""
    x = np.minimum(x, m - x)  # symmetric; the lower half keeps its relative precision
    if m > exact_up_to:
        variance = m / 12 + slack**2 / 3
        normal = -0.5 * (x - m / 2) ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
        return np.where(x > -slack, normal, -np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):  # log 0 is meant: -inf
        if slack == 0:
            b, log_scale = splines(m, x)
            return np.log(b[..., 0]) + log_scale
        ends = np.stack([x - slack, x + slack])
        b, log_scale = splines(m + 1, ends)  # their sum is the distribution function
        below, above = np.log(b.sum(axis=-1)) + log_scale
        share = -np.expm1(np.where(above > -np.inf, below - above, -1.0))
        return above + np.log(np.maximum(share, 0.0)) - np.log(2 * slack)


def log_uniform_sum_slope(m: int, x: np.ndarray, exact_up_to: int = _EXACT_UP_TO) -> np.ndarray:
    """Derivative at x in (0, m) of the log density of the sum of m >= 2 uniforms on (0, 1)."""
    if m > exact_up_to:
        return (m / 2 - x) / (m / 12)
    lower = np.minimum(x, m - x)
    b, _ = splines(m - 1, lower)
    here, before = b[..., 0], b[..., 1] if b.shape[-1] > 1 else 0.0
    slope = (m - 1) * (here - before) / (lower * here + (m - lower) * before)
    return np.where(x <= m - x, slope, -slope)


def log_density(n, gap, schedule: Schedule, slack: float) -> np.ndarray:
    """Log density (flat) at each gap of the sum of n + 1 intervals."""
    first, second = soft_limits(schedule)
    m = n + 1
    if schedule.kind == "stable":
        variance = m * second**2 + slack**2 / 3
        return -0.5 * (gap - m * first) ** 2 / variance - 0.5 * np.log(2 * np.pi * variance)
    width = second - first
    x = (gap - m * first) / width
    out = np.empty(gap.shape)
    for count in np.unique(m):
        here = m == count
        out[here] = log_uniform_sum(int(count), x[here], slack / width)
    return out - np.log(width)
