"""How deep simulated animals swim: between surface and bottom, around a depth of their own."""

from __future__ import annotations

import math

import numpy as np

__all__ = ["swimming_depth"]


def swimming_depth(
    rng: np.random.Generator,
    time: np.ndarray,
    bottom: float = 80.0,
    middle: float = 40.0,
    sd: float = 20.0,
    t05: float = 1800.0,
) -> np.ndarray:
    """Draw depths at given times: an Ornstein-Uhlenbeck process, mirrored at surface and bottom.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    time : array (P,)
        Increasing, s.
    bottom : float
        Depth of the water, m.
    middle, sd : float
        Mean and standard deviation of the depth, m, before it is mirrored.
    t05 : float
        Time after which 5 % of the correlation is left, s.

    Returns
    -------
    array (P,)
        m, positive down, from 0 to `bottom`.
    """
    keep = np.exp(math.log(0.05) / t05 * np.diff(time))
    z = rng.standard_normal(len(time))
    off = np.empty(len(time))
    off[0] = z[0]
    for k, e in enumerate(keep):
        off[k + 1] = e * off[k] + math.sqrt(1 - e * e) * z[k + 1]
    folded = np.mod(middle + sd * off, 2 * bottom)
    return np.where(folded > bottom, 2 * bottom - folded, folded)
