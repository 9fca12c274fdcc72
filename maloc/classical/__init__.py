"""The chain of today: outlier filters, Kalman filter and smoother on positions of single pings.

What most studies do after positioning, on the same data types as everything else in maloc, so that
it can be compared honestly with the posterior of arrival times. `kalman` takes the positions of
`maloc.points.locate`; `speed_filter` and its kin say which of them cannot be, `geometric_error` and
its kin how far each is to be trusted.

Comes in: `Points`, `ArrivalTimes`.
Goes out: what was screened out, smoothed tracks, error measures.
Start reading: `outliers.py`, `kalman.py`.
The mathematics: docs/classical.md.
"""

from __future__ import annotations

from maloc.classical.ektoa import ek_toa
from maloc.classical.fixed import (
    FixedTags,
    cluster_error,
    cluster_filter,
    clusters,
    timing_error,
)
from maloc.classical.kalman import MOVEMENTS, KalmanTrack, kalman
from maloc.classical.measures import Regression, ehrenberg_error, geometric_error, regress
from maloc.classical.outliers import (
    Screened,
    interval_filter,
    land_filter,
    speed_filter,
    three_stage_filter,
    threshold_filter,
    two_stage_filter,
)

__all__ = [
    "MOVEMENTS",
    "FixedTags",
    "KalmanTrack",
    "Regression",
    "Screened",
    "cluster_error",
    "cluster_filter",
    "clusters",
    "ehrenberg_error",
    "ek_toa",
    "geometric_error",
    "interval_filter",
    "kalman",
    "land_filter",
    "regress",
    "speed_filter",
    "three_stage_filter",
    "threshold_filter",
    "timing_error",
    "two_stage_filter",
]
