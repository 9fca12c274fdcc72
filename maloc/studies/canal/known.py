"""Hyperparameters as the truth has them: what a model cannot do better than to be given.

The track model's movement is a CTCRW and the fish's is not, so the true value of its parameters is
that of the CTCRW under which the true path, seen without error, is likeliest.
"""

from __future__ import annotations

import numpy as np

from maloc.errors import FitError

__all__ = ["ctcrw_of_path", "path_log_density", "true_values"]

_LATE = 25.0  # m; detours are 50 m or more, errors of clocks a few


def true_values(toa, truth: np.ndarray, emission: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of `maloc.models.toa_track` by the truth.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings.
    truth : array (P, 2)
        m.
    emission : array (P,)
        s from the data set's origin.

    Returns
    -------
    dict
        ``sigma`` (m): root mean square error of the arrivals that are not late; ``w``: share of
        those that are (half an arrival where none is, so that its logit is finite); ``sigma_vel``
        (m/s) and ``t05`` (s): `ctcrw_of_path`.
    """
    if not np.isfinite(emission).all():
        raise FitError("the true emission times are not known (column top)")
    distance = np.linalg.norm(truth[:, None] - toa.receivers.xy, axis=2)
    error = (toa.toa - emission[:, None]) * toa.sound_speed[:, None] - distance
    error = error[toa.heard]
    late = error > _LATE
    sigma_vel, t05 = ctcrw_of_path(emission, truth)
    w = np.clip(late.mean(), 0.5 / len(late), 1 - 0.5 / len(late))
    values = {"sigma": np.sqrt(np.mean(error[~late] ** 2)), "w": w}
    values |= {"sigma_vel": sigma_vel, "t05": t05}
    return {name: np.asarray(float(value)) for name, value in values.items()}


def ctcrw_of_path(time: np.ndarray, path: np.ndarray) -> tuple[float, float]:
    """Maximum likelihood sigma_vel (m/s) and t05 (s) of a path (P, A) seen without error."""
    from scipy.optimize import minimize

    dt, step = np.diff(time), np.diff(path, axis=0)
    start = np.log([np.sqrt(np.mean((step / dt[:, None]) ** 2)), 5 * np.median(dt)])
    found = minimize(lambda u: -path_log_density(dt, step, *np.exp(u)), start, method="Nelder-Mead")
    sigma_vel, t05 = np.exp(found.x)
    return float(sigma_vel), float(t05)


def path_log_density(dt: np.ndarray, step: np.ndarray, sigma_vel: float, t05: float) -> float:
    """Log density of the steps (N, A) of a CTCRW over times (N,); axes independent.

    A Kalman filter of the velocity: positions are seen, velocities are not. The first velocity is
    stationary.
    """
    from maloc.movement import ctcrw_beta, ctcrw_transition

    parts = ctcrw_transition(dt, sigma_vel, ctcrw_beta(t05))
    rows = np.column_stack([np.broadcast_to(np.asarray(p, float), dt.shape) for p in parts])
    mean, var = np.zeros(step.shape[1]), sigma_vel**2
    total = 0.0
    for (a12, a22, q11, q12, q22), moved in zip(rows.tolist(), step, strict=True):
        spread = a12 * a12 * var + q11
        off = moved - a12 * mean
        total -= 0.5 * float(off @ off) / spread + 0.5 * len(off) * np.log(2 * np.pi * spread)
        gain = (a12 * a22 * var + q12) / spread
        mean = a22 * mean + gain * off
        var = a22 * a22 * var + q22 - gain * gain * spread
    return total
