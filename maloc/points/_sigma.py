"""The arrivals' standard deviation and the array's extent, from the pings themselves."""

from __future__ import annotations

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.points._problem import problem_of, ranges_of, residuals

__all__ = ["UNKNOWN", "diameter", "estimate_sigma", "spread_of"]

UNKNOWN = 1.5  # m, 1 ms; where the pings do not tell


def diameter(toa: ArrivalTimes) -> float:
    """Largest extent of the receivers that heard something, m."""
    used = toa.receivers.xy[toa.heard.any(axis=0)]
    return max(float(np.linalg.norm(np.ptp(used, axis=0))), 1.0)


def estimate_sigma(toa: ArrivalTimes, below: np.ndarray, d: int) -> float:
    """Standard deviation of direct arrivals' errors, m; as of `spread_of`."""
    return spread_of(ranges_of(toa), toa.receivers.xy, below, d, 2 * diameter(toa))


def spread_of(
    ranges: np.ndarray, xy: np.ndarray, below: np.ndarray, d: int, reach: float, most: int = 512
) -> float:
    """Standard deviation of direct arrivals' errors, m, from pings with arrivals to spare.

    The median absolute residual of a consensus, each corrected for what the fit took; twice, the
    second time with the first's answer. 1.5 m (1 ms) where no ping has two arrivals to spare.

    Parameters
    ----------
    ranges, xy, below
        As of `maloc.points._problem.problem_of`.
    d : int
        2 or 3.
    reach : float
        Largest distance (m) from the nearest receiver that heard a ping.
    most : int
        Pings used, about.
    """
    from maloc.points._robust import consensus

    rows = np.flatnonzero(np.isfinite(ranges).sum(axis=1) >= d + 3)
    rows = rows[:: max(1, len(rows) // most)]
    if not len(rows):
        return UNKNOWN
    ranges, below = ranges[rows], below[rows]
    scale = 4.0
    for _ in range(3):
        problem, _ = problem_of(ranges, xy, below, np.full(ranges.shape, scale))
        found = consensus(problem, d, reach=reach)
        # where two places fit, residuals count only if all arrivals agree with both (a mirror)
        used = found.used if found.agreed is None else found.agreed
        count = used.sum(axis=1)
        spare = (count >= d + 3) & (count == found.used.sum(axis=1))
        if not spare.any():
            return UNKNOWN
        free = np.sqrt(count / np.maximum(count - d - 1, 1))[:, None]
        residual = np.abs(residuals(problem, found) * free)[used & spare[:, None]]
        scale = max(1.4826 * float(np.median(residual)), 0.1)
    return scale
