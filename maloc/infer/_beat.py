"""Emission times that a slowly drifting burst interval smooths, wild ones left out of account."""

from __future__ import annotations

import numpy as np

__all__ = ["smooth_beat"]

_WIDTHS = (0.2, 0.06, 0.02, 0.006, 0.002)  # s; errors no model knows of, narrowed step by step
_DRIFTS = np.array([0.1e-3, 0.3e-3, 1e-3, 3e-3, 10e-3, 30e-3])  # s an interval
_FREEDOM = 2.0  # of the t law whose weights are iterated


def smooth_beat(
    time: np.ndarray, sd: np.ndarray, nominal: np.ndarray, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth emission times by a nominal interval whose error is a random walk.

    Parameters
    ----------
    time : (P,) array
        Emission times, s; NaN where there is none.
    sd : (P,) array
        Their standard deviations, s.
    nominal : (P - 1,) array
        Nominal time from each ping to the next, s.
    n : (P - 1,) array
        Intervals in it; 0: the beat starts anew.

    Returns
    -------
    time, sd : (P,) arrays
    """
    out, spread = np.array(time, float), np.array(sd, float)
    ends = np.flatnonzero(n == 0) + 1
    for part in np.split(np.arange(len(time)), ends):
        if np.isfinite(time[part]).sum() < 3:
            continue
        steps = part[:-1]
        even = np.concatenate([[0.0], np.cumsum(nominal[steps])])
        smooth, spread[part] = _robust(time[part] - even, sd[part], n[steps])
        out[part] = even + smooth
    return out, spread


def _robust(off: np.ndarray, sd: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed offsets, by iterated weights while the unknown errors are narrowed."""
    seen = np.isfinite(off)
    centre = np.nanmedian(off)
    y = np.where(seen, off - centre, 0.0)
    drift, found = 3e-3, (np.zeros(len(y)), np.ones(len(y)))
    for k, width in enumerate(_WIDTHS):
        noise = sd**2 + width**2
        for again in range(3):
            weight = np.ones(len(y))
            if k or again:
                weight = (_FREEDOM + 1) / (_FREEDOM + (y - found[0]) ** 2 / noise)
            precision = np.where(seen, weight / noise, 0.0)
            if width == _WIDTHS[-1] and not again:
                scores = [_smooth(y, precision, n, s)[2] for s in _DRIFTS]
                drift = float(_DRIFTS[int(np.argmax(scores))])
            mean, wide, _ = _smooth(y, precision, n, drift)
            found = mean, wide
    return found[0] + centre, found[1]


def _smooth(y, precision, n, drift: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Kalman smoother of (offset, drift of the interval): offset's mean and sd, log likelihood."""
    size = len(y)
    mean, cov = np.zeros(2), np.diag([1.0, 0.25])
    means, covs = np.empty((size, 2)), np.empty((size, 2, 2))
    moves, aheads = np.empty((size, 2, 2)), np.empty((size, 2, 2))
    total = 0.0
    for k in range(size):
        if k:
            m = n[k - 1]
            move = np.array([[1.0, m], [0.0, 1.0]])
            shake = drift**2 * np.array(
                [[(m - 1) * m * (2 * m - 1) / 6, m * (m - 1) / 2], [m * (m - 1) / 2, m]]
            ) + np.diag([1e-8 * m, 0.0])  # fmt: skip
            mean, cov = move @ mean, move @ cov @ move.T + shake
            moves[k], aheads[k] = move, cov
        if precision[k] > 0:
            variance = cov[0, 0] + 1 / precision[k]
            gain = cov[:, 0] / variance
            off = y[k] - mean[0]
            total -= 0.5 * (off**2 / variance + np.log(variance))
            mean, cov = mean + gain * off, cov - np.outer(gain, cov[0])
        means[k], covs[k] = mean, cov
    for k in range(size - 2, -1, -1):
        move, ahead = moves[k + 1], aheads[k + 1]
        gain = np.linalg.solve(ahead, move @ covs[k]).T
        means[k] += gain @ (means[k + 1] - move @ means[k])
        covs[k] += gain @ (covs[k + 1] - ahead) @ gain.T
    return means[:, 0], np.sqrt(np.maximum(covs[:, 0, 0], 0.0)), total
