"""Clock offsets as cubic Hermite curves between equally spaced knots.

The offset of a receiver is what its clock shows minus the common time. A knot holds the offset
(s) and its slope times the knot spacing (s). Given an integrated random walk observed at the
knots, the cubic Hermite curve is exactly its conditional mean between them.
"""

from __future__ import annotations

import numpy as np

__all__ = ["evaluate", "hermite", "to_common"]


def hermite(u: np.ndarray) -> np.ndarray:
    """Weights (..., 4) of [offset, slope, next offset, next slope] at fraction `u` (...)."""
    u2, u3 = u * u, u * u * u
    return np.stack(
        [1 - 3 * u2 + 2 * u3, u - 2 * u2 + u3, 3 * u2 - 2 * u3, u3 - u2],
        axis=-1,
    )


def evaluate(
    state: np.ndarray, first: float, spacing: float, receiver: np.ndarray, common: np.ndarray
) -> np.ndarray:
    """Offset of each receiver at common times; beyond the end knots the curve goes on straight.

    Parameters
    ----------
    state : array (K, R, 2)
        Offset and slope times `spacing`, s.
    first, spacing : float
        Time of the first knot and distance between knots, s.
    receiver : array (N,) of int
    common : array (N,)
        Common time, s.

    Returns
    -------
    array (N,)
        Offset, s.
    """
    last = len(state) - 1
    place = (common - first) / spacing
    inside = np.clip(place, 0.0, last)
    k = np.minimum(inside.astype(int), last - 1)
    ends = np.concatenate([state[k, receiver], state[k + 1, receiver]], axis=-1)
    curve = (hermite(inside - k) * ends).sum(-1)
    end_slope = np.where(place > inside, state[last, receiver, 1], state[0, receiver, 1])
    return curve + (place - inside) * end_slope


def to_common(
    state: np.ndarray,
    first: float,
    spacing: float,
    receiver: np.ndarray,
    recorded: np.ndarray,
    guess: np.ndarray | None = None,
) -> np.ndarray:
    """Common time (N,) of what receivers' clocks showed: solves recorded = t + offset(t).

    Slopes are below 1e-3, so each pass of the fixed point gains three digits at least.
    """
    common = recorded - state[:, :, 0].mean(0)[receiver] if guess is None else guess
    for _ in range(10):
        before, common = common, recorded - evaluate(state, first, spacing, receiver, common)
        if np.abs(common - before).max(initial=0.0) < 1e-8:  # the next pass: 1e-11
            break
    return common
