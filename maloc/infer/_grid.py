"""Where a tag may have been, on a coarse grid: starts for fits whose posterior has many hills.

A forward-backward pass over the cells: each ping's arrival differences and silence at each cell,
a random walk from ping to ping. One tag at a time; nothing here is exact, or needs to be.
"""

from __future__ import annotations

import numpy as np

from maloc.model_data.joint import JointData

__all__ = ["grid_paths"]

_CELLS = 2500
_TINY = 1e-12
_LATE = 0.06  # share of arrivals that may be anything


def grid_paths(
    data: JointData,
    log_miss,
    log_hit,
    sigma: float,
    speed: float,
    draws: int,
    rng: np.random.Generator,
    emission: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Paths of all states: the posterior mean on the grid, and draws from it.

    Parameters
    ----------
    data : JointData
    log_miss, log_hit : callable, optional
        Log probabilities that receivers at distances (G, R) m miss and hear a ping; None: silence
        says nothing.
    sigma : float
        Error of an arrival, m.
    speed : float
        m/s in each axis, from ping to ping.
    draws : int
        Paths drawn besides the mean.
    rng : numpy.random.Generator
    emission : pair of (S,) arrays, optional
        Ranges of emission that a beat foretells, m, and their sds; by default whichever suits the
        arrivals best.

    Returns
    -------
    (1 + draws, S, 2) array
        m; padding stands still.
    """
    xy, present = np.asarray(data.receiver_xy), np.asarray(data.present)
    low, high = np.asarray(data.encounters.low), np.asarray(data.encounters.high)
    cell = np.sqrt(np.prod(high - low) / _CELLS)
    axes = [np.arange(a + cell / 2, b, cell) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    away = ((cells[:, None] - xy) ** 2).sum(-1) + 0.25
    if data.depth is not None:  # one depth for all: a start needs no better
        deep = np.mean(np.asarray(data.depth.initial), keepdims=True)
        away = away + np.asarray(data.depth.square(deep))
    away = np.sqrt(away)
    score = _arrival_scores(data, away, np.hypot(sigma, 0.3 * cell), emission)
    if log_miss is not None:
        heard = np.asarray(data.heard)
        listening = _listening(data) & present
        score += np.where(heard, 1.0, 0.0) @ log_hit(away).T
        quiet = listening & ~heard & np.asarray(data.ping)[:, None]
        score += np.where(quiet, 1.0, 0.0) @ log_miss(away).T
    out = np.tile(0.5 * (low + high), (1 + draws, len(score), 1))
    tag, valid = np.asarray(data.tag), np.asarray(data.valid)
    for one in np.unique(tag[valid]):
        rows = np.flatnonzero((tag == one) & valid)
        step = np.maximum(speed * np.asarray(data.dt)[rows[:-1]], 0.8 * cell)
        out[:, rows] = _smooth(score[rows], step, axes, cells, draws, rng)
    return out


def _listening(data: JointData) -> np.ndarray:
    """Which receivers were considered at each state, (S, R) bool."""
    who = data.encounters
    out = np.zeros(np.shape(data.heard), bool)
    rows = np.arange(len(out))[:, None]
    np.logical_or.at(out, (rows, np.asarray(who.receiver)), np.asarray(who.listening))
    return out


def _arrival_scores(data: JointData, away: np.ndarray, sigma: float, emission) -> np.ndarray:
    """Log likelihood of each ping's arrivals at each cell, (S, G); see `grid_paths`."""
    heard, ranges = np.asarray(data.heard), np.asarray(data.range)
    phi = float(data.phi)
    out = np.zeros((len(heard), len(away)))
    for t in np.flatnonzero(heard.any(axis=1)):
        columns = np.flatnonzero(heard[t])
        left = ranges[t, columns] - away[:, columns]  # (G, m): emission, were that arrival direct
        if emission is not None:
            wide = np.hypot(sigma, emission[1][t])
            out[t] = _fit(left - emission[0][t], wide, phi).sum(axis=1)
        elif len(columns) > 1:
            off = left[:, None] - left[:, :, None]  # lateness of each, by each
            out[t] = _fit(off, sigma, phi).sum(axis=2).max(axis=1)
    return out


def _fit(late: np.ndarray, sigma: float, phi: float) -> np.ndarray:
    """Log density, up to a constant, of an arrival so late (m): direct, or perhaps reflected."""
    floor = np.log(_LATE * sigma * np.sqrt(2 * np.pi) / phi)
    return np.maximum(-0.5 * (late / sigma) ** 2, np.where(late > -2 * sigma, floor, 3 * floor))


def _smooth(score, step, axes, cells, draws: int, rng) -> np.ndarray:
    """Posterior mean path on the grid and draws of it, (1 + draws, T, 2)."""
    shape = (len(axes[0]), len(axes[1]))
    like = np.exp(score - score.max(axis=1, keepdims=True)).reshape(-1, *shape) + _TINY
    forward = np.empty_like(like)
    forward[0] = like[0] / like[0].sum()
    for t in range(1, len(like)):
        now = _blur(forward[t - 1], step[t - 1], axes) * like[t]
        forward[t] = now / now.sum()
    out = np.empty((1 + draws, len(like), 2))
    backward = np.ones(shape)
    last = np.zeros((draws, 2))
    for t in range(len(like) - 1, -1, -1):
        both = forward[t] * backward
        out[0, t] = both.ravel() @ cells / both.sum()
        for i in range(draws):
            weight = forward[t]
            if t < len(like) - 1:
                weight = weight * np.outer(
                    *(_kernel(a - last[i, k], step[t]) for k, a in enumerate(axes))
                )
            total = np.cumsum(weight.ravel())
            pick = min(int(np.searchsorted(total, rng.random() * total[-1])), total.size - 1)
            out[1 + i, t] = last[i] = cells[pick]
        if t:
            backward = _blur(backward * like[t], step[t - 1], axes)
            backward /= backward.sum()
    return out


def _kernel(off: np.ndarray, sd: float) -> np.ndarray:
    return np.exp(-0.5 * (off / sd) ** 2) + _TINY


def _blur(values: np.ndarray, sd: float, axes) -> np.ndarray:
    by_east, by_north = (_kernel(a[:, None] - a, sd) for a in axes)
    return by_east @ values @ by_north
