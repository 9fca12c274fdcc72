"""Rows of a track table that the posterior holds, and those that are predicted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Rows"]


class Rows(NamedTuple):
    """Where pings stand in track.csv, counted from 0.

    Attributes
    ----------
    known : (P,) int
        Rows of the pings that are in the fit's chain.
    unheard : (n,) int
        Rows of those that are predicted: nobody heard them.
    ping : (n,) int
        Their ids in the input, -1 where only the schedule calls for them.
    tag : (n,) int
        Index of their tag.
    time : (n,)
        Their mean times, s from the origin.
    mean, covariance : (n, 2), (n, 2, 2)
        Of their positions, m.
    low, high : (n, 2)
        Central 95 %, m.
    """

    known: np.ndarray
    unheard: np.ndarray
    ping: np.ndarray
    tag: np.ndarray
    time: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    low: np.ndarray
    high: np.ndarray
