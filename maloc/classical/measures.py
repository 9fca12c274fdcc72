"""Error measures: how sensitive a position is to errors, and what that says of its true error.

None is an error in metres until `regress` has set it against positions whose true error is known.

References
----------
Ehrenberg & Steig (2002) ICES J. Mar. Sci. 59: 140-149, in two dimensions and with all receivers
that heard, as the thesis on cleaning fish tracks in the Albert Canal rewrites it (section 3.3).
Smith (2013) Understanding HPE in the VEMCO Positioning System: what HPE is made of; its formulas
are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.data.receivers import Receivers
    from maloc.points.result import Points

__all__ = ["Regression", "ehrenberg_error", "geometric_error", "regress"]


def geometric_error(
    points: Points, receivers: Receivers, *, sigma: float = 1.0, speed_sd: float = 0.0
) -> np.ndarray:
    """Error of each position to be expected from where its receivers stand: what HPE is made of.

    Parameters
    ----------
    points : Points
        P pings in the plane; arrivals that are no inliers take no part.
    receivers : Receivers
        R, the columns of the pings.
    sigma : float
        Standard deviation of an arrival's error, m; 1: metres a metre, the dilution of precision.
    speed_sd : float
        Relative standard deviation of the sound speed.

    Returns
    -------
    (P,) array
        Root mean square error, m; inf where the receivers leave a direction open, NaN where there
        is no position.

    Raises
    ------
    InputError
        If the pings' columns are not the receivers.
    """
    from maloc.points.expected import position_covariance

    position, used, out = _used(points, receivers)
    rows = np.flatnonzero(points.located)
    found = position_covariance(position[rows], receivers.xy, sigma, used[rows], speed_sd=speed_sd)
    out[rows] = np.sqrt(np.trace(found, axis1=1, axis2=2))
    return out


def ehrenberg_error(
    points: Points, receivers: Receivers, *, sound_speed: float = 1500.0
) -> np.ndarray:
    """How far each position moves when the sound speed is wrong by 1 m/s.

    Parameters
    ----------
    points, receivers
        As of `geometric_error`.
    sound_speed : float
        m/s.

    Returns
    -------
    (P,) array
        m for an error of 1 m/s; inf where the receivers leave a direction open, NaN where there is
        no position.

    Raises
    ------
    InputError
        As `geometric_error`.

    Notes
    -----
    Least squares of M (east, north, range) = travel times, a row of M the direction to a receiver
    and 1; a time common to all arrivals, the emission's, drops out.
    """
    position, used, out = _used(points, receivers)
    rows = np.flatnonzero(points.located)
    offset = receivers.xy[None] - position[rows, None]
    distance = np.maximum(np.linalg.norm(offset, axis=2), 1e-9)
    slope = np.concatenate([offset / distance[..., None], np.ones((*distance.shape, 1))], axis=2)
    heard = used[rows][..., None]
    slope = np.where(heard, slope, 0.0)
    late = np.where(heard, distance[..., None] / sound_speed, 0.0)
    moved = (np.linalg.pinv(slope, rcond=1e-6) @ late)[..., 0]
    whole = np.linalg.matrix_rank(slope, rtol=1e-6) == 3
    out[rows] = np.where(whole, np.hypot(moved[:, 0], moved[:, 1]), np.inf)
    return out


def _used(points: Points, receivers: Receivers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (P, 2), who made them (P, R), and NaN (P,) to write into."""
    if points.inlier.shape[1] != len(receivers):
        raise InputError(
            f"pings of {points.inlier.shape[1]} columns, but {len(receivers)} receivers"
        )
    return points.position[:, :2], points.inlier, np.full(len(points), np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Regression:
    """A line of true error on an error measure.

    Attributes
    ----------
    slope, intercept : float
        Expected error (m) = intercept + slope x measure.
    r2 : float
        Share of the error's variance that the line explains.
    rho : float
        Rank correlation (Spearman).
    measure, error : (N,) arrays
        The pairs behind it.
    left_out : int
        Pairs of which one is not finite.
    """

    slope: float
    intercept: float
    r2: float
    rho: float
    measure: np.ndarray
    error: np.ndarray
    left_out: int

    def expected(self, measure: Any) -> np.ndarray:
        """Expected error (m) at values of the measure, never below 0."""
        return np.maximum(self.intercept + self.slope * np.asarray(measure, float), 0.0)

    def limit(self, goal: float = 2.5) -> float:
        """Value of the measure at which the expected error is `goal` m, for `threshold_filter`.

        Raises
        ------
        InputError
            If the error does not grow with the measure.
        """
        if not self.slope > 0:
            raise InputError("the true error does not grow with this measure: it gives no limit")
        return (goal - self.intercept) / self.slope

    def plot(self, ax: Axes | None = None, *, name: str = "Error measure") -> Axes:
        """Draw the pairs and the line.

        Parameters
        ----------
        ax : Axes, optional
            New ones when not given.
        name : str
            Of the measure, with its unit.
        """
        from maloc.plots._style import new_axes, tidy

        ax = new_axes(ax, (5.0, 4.0))
        ax.plot(self.measure, self.error, ".", ms=3, alpha=0.5)
        ends = np.array([self.measure.min(), self.measure.max()])
        ax.plot(ends, self.intercept + self.slope * ends, color="C3")
        ax.set_ylim(bottom=0.0)
        return tidy(
            ax, name, "True error (m)", f"R² {self.r2:.2f}, rank correlation {self.rho:.2f}"
        )

    def __repr__(self) -> str:
        return (
            f"Regression: error = {self.intercept:.3g} + {self.slope:.3g} x measure, R2 "
            f"{self.r2:.3f}, rho {self.rho:.3f}, of {len(self.error)} ({self.left_out} left out)"
        )


def regress(measure: Any, error: Any) -> Regression:
    """Set true errors against an error measure.

    Parameters
    ----------
    measure : (P,) array
        NaN or inf: not known.
    error : (P,) array
        True error, m; NaN where there is none.

    Returns
    -------
    Regression

    Raises
    ------
    InputError
        If shapes differ, or fewer than 3 pairs, or one value only of the measure, are there.
    """
    from scipy.stats import linregress, spearmanr

    measure, error = np.asarray(measure, float), np.asarray(error, float)
    if measure.ndim != 1 or measure.shape != error.shape:
        raise InputError(f"measure {measure.shape} and error {error.shape} are no pairs")
    both = np.isfinite(measure) & np.isfinite(error)
    if both.sum() < 3 or np.ptp(measure[both]) == 0:
        raise InputError(f"{both.sum()} pairs of measure and error: no line can be drawn")
    measure, error = measure[both], error[both]
    line: Any = linregress(measure, error)
    rank: Any = spearmanr(measure, error)
    return Regression(
        float(line.slope),
        float(line.intercept),
        float(line.rvalue) ** 2,
        float(rank.statistic),
        measure,
        error,
        int((~both).sum()),
    )
