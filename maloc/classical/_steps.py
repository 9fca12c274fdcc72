"""Transitions of the movement models of the classical chain, for axes side by side.

A state is (positions, velocities), each as long as there are axes, or positions alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

__all__ = ["LAWS", "Law", "steps"]


class Law(NamedTuple):
    """One axis's movement.

    ``names`` of the parameters with ``guess`` and ``range`` of each; ``step(dt, *parameters)``
    gives transition and covariance (..., k, k); ``first(*parameters)`` the variance of the first
    velocity, (m/s)2, or None where the state has none.
    """

    names: tuple[str, ...]
    guess: tuple[float, ...]
    range: tuple[tuple[float, float], ...]
    step: Callable
    first: Callable


def _constant_velocity(dt: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity in Brownian motion: white acceleration of density sigma2, m2/s3."""
    dt = np.asarray(dt, float)
    a = np.zeros((*dt.shape, 2, 2))
    a[..., 0, 0] = a[..., 1, 1] = 1.0
    a[..., 0, 1] = dt
    q = np.empty((*dt.shape, 2, 2))
    q[..., 0, 0], q[..., 1, 1] = dt**3 / 3, dt
    q[..., 0, 1] = q[..., 1, 0] = dt**2 / 2
    return a, sigma**2 * q


def _brownian(dt: np.ndarray, *parameters: float) -> tuple[np.ndarray, np.ndarray]:
    from maloc.movement import Brownian  # brings JAX

    return Brownian.step(dt, *parameters)  # pyright: ignore[reportReturnType]


def _ctcrw(dt: np.ndarray, *parameters: float) -> tuple[np.ndarray, np.ndarray]:
    from maloc.movement import CTCRW

    return CTCRW.step(dt, *parameters)  # pyright: ignore[reportReturnType]


LAWS = {
    "rw": Law(("sigma_step",), (0.5,), ((1e-4, 1e3),), _brownian, lambda sigma: None),
    "crw": Law(("sigma_acc",), (0.05,), ((1e-6, 1e2),), _constant_velocity, lambda sigma: 1.0),
    "ctcrw": Law(
        ("sigma_vel", "t05"), (0.3, 260.0), ((1e-4, 50.0), (0.1, 1e7)), _ctcrw,
        lambda sigma, t05: sigma**2,
    ),
}  # fmt: skip


def steps(law: Law, dt: np.ndarray, d: int, parameters: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Transitions and covariances (T, k d, k d) of d axes over dt (T,)."""
    a, q = law.step(dt, *parameters)
    return np.asarray(np.kron(a, np.eye(d))), np.asarray(np.kron(q, np.eye(d)))
