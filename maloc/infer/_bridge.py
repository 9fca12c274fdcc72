"""Positions between two states of a Gauss-Markov path, drawn exactly."""

from __future__ import annotations

import numpy as np

from maloc.movement import ctcrw_beta, ctcrw_transition

__all__ = ["bridge"]


def bridge(
    rng: np.random.Generator,
    track: np.ndarray,
    clock: np.ndarray,
    k: int,
    times: np.ndarray,
    scale: dict[str, np.ndarray],
) -> np.ndarray:
    """Draw positions at times after state k and before state k + 1.

    Parameters
    ----------
    rng : numpy.random.Generator
    track : (D, T, 2, A) or (D, T, A) array
        Draws of a CTCRW path (positions and velocities) or of a Brownian one.
    clock : (D, T) array
        Times of the states in each draw (s).
    k : int
        State before; -1 for times before the first, T - 1 for times after the last.
    times : (D, n) array
        Times in each draw, ascending (s).
    scale : dict
        Draws (D,) of ``sigma_vel`` and ``t05`` (CTCRW), or of ``sigma_step`` (Brownian).

    Returns
    -------
    (D, n, A) array
        Positions (m).

    References
    ----------
    The conditional of a Gauss-Markov chain: p(s | before, after) is proportional to
    p(s | before) p(after | s).
    """
    moves = "sigma_vel" in scale
    state = track if moves else track[:, :, None, :]  # (D, T, order, A)
    if k < 0:  # a stationary path runs backward as it runs forward, with the velocity turned round
        start, begin = _turned(state[:, 0], moves), -clock[:, 0]
        ahead = -times[:, ::-1]
        return _walk(rng, start, begin, None, None, ahead, scale, moves)[:, ::-1]
    after = k + 1 < state.shape[1]
    target = state[:, k + 1] if after else None
    end = clock[:, k + 1] if after else None
    return _walk(rng, state[:, k], clock[:, k], target, end, times, scale, moves)


def _turned(state, moves: bool):
    if not moves:
        return state
    return state * np.array([1.0, -1.0])[:, None]


def _walk(rng, start, begin, target, end, times, scale, moves: bool):
    """One time after another, each given the state before it and (if any) the one at the end."""
    out = []
    for i in range(times.shape[1]):
        a, q = _step(times[:, i] - begin, scale, moves)
        mean = a @ start
        if target is not None:
            a_next, q_next = _step(end - times[:, i], scale, moves)
            ahead = a_next @ q
            gain = np.swapaxes(ahead, 1, 2) @ np.linalg.inv(
                ahead @ np.swapaxes(a_next, 1, 2) + q_next
            )
            mean = mean + gain @ (target - a_next @ mean)
            q = q - gain @ ahead
        root = _root(q)
        start = mean + root @ rng.standard_normal(start.shape)
        begin = times[:, i]
        out.append(start[:, 0])
    return np.stack(out, axis=1)


def _root(q):
    """Cholesky-like root of small covariances that rounding may have made indefinite."""
    values, vectors = np.linalg.eigh((q + np.swapaxes(q, 1, 2)) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]


def _step(dt, scale, moves: bool):
    """Transition matrix and covariance (D, order, order) over dt (D,)."""
    dt = np.maximum(dt, 1e-6)
    if not moves:
        q = scale["sigma_step"] ** 2 * dt
        return np.ones((len(dt), 1, 1)), q[:, None, None]
    parts = ctcrw_transition(dt, scale["sigma_vel"], ctcrw_beta(scale["t05"]))
    a12, a22, q11, q12, q22 = (np.asarray(p) for p in parts)
    zero, one = np.zeros_like(a12), np.ones_like(a12)
    a = np.stack([np.stack([one, a12], -1), np.stack([zero, a22], -1)], -2)
    q = np.stack([np.stack([q11, q12], -1), np.stack([q12, q22], -1)], -2)
    return a, q
