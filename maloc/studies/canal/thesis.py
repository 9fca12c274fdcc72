"""Table C.1 of the thesis on cleaning fish tracks in the Albert Canal: mean errors, m.

200 simulated tracks of 250 pings a cell; the noise of arrivals that are not late is not stated.
"""

from __future__ import annotations

__all__ = ["STEPS_C1", "TABLE_C1", "Steps", "Thesis"]

from typing import NamedTuple


class Thesis(NamedTuple):
    """Mean errors (m): YAPS, LS-TDOA by differential evolution, and that after its whole chain.

    The chain: outlier filter, Kalman filter, Rauch-Tung-Striebel smoother.
    """

    yaps: float
    ls: float
    chain: float


class Steps(NamedTuple):
    """Mean errors (m) on the way through the chain: after the outlier filter, Kalman filtered."""

    outlier: float
    kf: float


# (missing, late) -> mean errors
TABLE_C1 = {
    (0.0, 0.00): Thesis(0.58, 0.62, 2.09),
    (0.0, 0.03): Thesis(0.59, 5.51, 3.29),
    (0.0, 0.06): Thesis(0.64, 9.91, 5.84),
    (0.0, 0.09): Thesis(0.66, 14.37, 10.43),
    (0.0, 0.12): Thesis(0.66, 18.34, 14.73),
    (0.0, 0.15): Thesis(0.83, 21.86, 17.92),
    (0.1, 0.00): Thesis(0.61, 2.68, 2.32),
    (0.1, 0.03): Thesis(0.62, 7.34, 3.57),
    (0.1, 0.06): Thesis(0.68, 11.56, 6.73),
    (0.1, 0.09): Thesis(0.67, 15.68, 10.52),
    (0.1, 0.12): Thesis(0.74, 19.57, 14.14),
    (0.1, 0.15): Thesis(0.83, 23.24, 18.02),
    (0.2, 0.00): Thesis(0.69, 11.51, 3.06),
    (0.2, 0.03): Thesis(0.67, 15.53, 5.41),
    (0.2, 0.06): Thesis(0.70, 19.27, 9.03),
    (0.2, 0.09): Thesis(0.72, 23.34, 13.55),
    (0.2, 0.12): Thesis(0.87, 26.81, 16.53),
    (0.2, 0.15): Thesis(1.00, 29.87, 20.35),
    (0.3, 0.00): Thesis(0.75, 27.27, 5.78),
    (0.3, 0.03): Thesis(0.73, 30.33, 9.41),
    (0.3, 0.06): Thesis(0.97, 34.43, 13.09),
    (0.3, 0.09): Thesis(0.95, 37.82, 16.41),
    (0.3, 0.12): Thesis(0.91, 41.87, 20.56),
    (0.3, 0.15): Thesis(1.39, 44.87, 24.32),
    (0.4, 0.00): Thesis(0.90, 49.39, 10.98),
    (0.4, 0.03): Thesis(0.90, 52.31, 14.24),
    (0.4, 0.06): Thesis(0.94, 55.91, 19.01),
    (0.4, 0.09): Thesis(1.13, 58.03, 22.38),
    (0.4, 0.12): Thesis(1.31, 61.49, 25.89),
    (0.4, 0.15): Thesis(1.78, 64.27, 28.57),
    (0.5, 0.00): Thesis(0.90, 74.73, 17.34),
    (0.5, 0.03): Thesis(1.23, 77.39, 19.71),
    (0.5, 0.06): Thesis(1.20, 79.57, 25.48),
    (0.5, 0.09): Thesis(1.68, 83.27, 27.15),
    (0.5, 0.12): Thesis(2.25, 85.33, 31.29),
    (0.5, 0.15): Thesis(2.21, 87.50, 34.46),
}

STEPS_C1 = {
    (0.0, 0.00): Steps(0.62, 3.41),
    (0.0, 0.03): Steps(1.30, 4.76),
    (0.0, 0.06): Steps(3.08, 7.39),
    (0.0, 0.09): Steps(6.16, 12.40),
    (0.0, 0.12): Steps(9.62, 17.14),
    (0.0, 0.15): Steps(12.99, 20.88),
    (0.1, 0.00): Steps(0.70, 3.82),
    (0.1, 0.03): Steps(1.50, 5.40),
    (0.1, 0.06): Steps(3.38, 8.55),
    (0.1, 0.09): Steps(6.17, 12.49),
    (0.1, 0.12): Steps(9.39, 16.89),
    (0.1, 0.15): Steps(12.98, 21.23),
    (0.2, 0.00): Steps(1.54, 4.78),
    (0.2, 0.03): Steps(3.74, 7.34),
    (0.2, 0.06): Steps(6.06, 11.43),
    (0.2, 0.09): Steps(9.53, 15.96),
    (0.2, 0.12): Steps(12.76, 19.66),
    (0.2, 0.15): Steps(16.03, 23.62),
    (0.3, 0.00): Steps(8.07, 8.57),
    (0.3, 0.03): Steps(10.72, 12.57),
    (0.3, 0.06): Steps(14.76, 16.32),
    (0.3, 0.09): Steps(18.42, 20.15),
    (0.3, 0.12): Steps(22.62, 24.69),
    (0.3, 0.15): Steps(27.06, 29.19),
    (0.4, 0.00): Steps(25.67, 15.42),
    (0.4, 0.03): Steps(29.70, 18.80),
    (0.4, 0.06): Steps(34.11, 24.17),
    (0.4, 0.09): Steps(37.71, 27.43),
    (0.4, 0.12): Steps(41.74, 31.58),
    (0.4, 0.15): Steps(45.96, 35.08),
    (0.5, 0.00): Steps(55.00, 24.65),
    (0.5, 0.03): Steps(58.19, 26.29),
    (0.5, 0.06): Steps(61.62, 33.51),
    (0.5, 0.09): Steps(66.28, 35.42),
    (0.5, 0.12): Steps(69.47, 39.79),
    (0.5, 0.15): Steps(72.49, 44.03),
}
