"""The chain of today: outlier filters, Kalman filter and smoother on positions of single pings.

What most studies do after positioning, on the same data types as everything else in maloc, so that
it can be compared honestly with the posterior of arrival times. `kalman` takes the positions of
`maloc.points.locate`; `speed_filter` and its kin say which of them cannot be.
"""

from __future__ import annotations

from maloc.classical.ektoa import ek_toa
from maloc.classical.kalman import MOVEMENTS, KalmanTrack, kalman
from maloc.classical.outliers import (
    Screened,
    land_filter,
    speed_filter,
    three_stage_filter,
    threshold_filter,
    two_stage_filter,
)

__all__ = [
    "MOVEMENTS",
    "KalmanTrack",
    "Screened",
    "ek_toa",
    "kalman",
    "land_filter",
    "speed_filter",
    "three_stage_filter",
    "threshold_filter",
    "two_stage_filter",
]
