"""What is known of all receivers' clocks, and what follows from it directly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.data import Note, Receivers
from maloc.errors import InputError
from maloc.sync._records import ClockJumps, SyncResiduals

__all__ = ["Clocks"]


@dataclass(frozen=True, repr=False, eq=False)
class Clocks:
    """Clocks of all receivers against the common time; users hold a `maloc.sync.ClockSync`.

    The offset of a receiver is what its clock shows minus the common time: a cubic Hermite curve
    between knots plus the jumps before. Beyond its own sync detections it goes on straight.

    Parameters
    ----------
    receivers : Receivers
        With the fitted places.
    reference : str
        Receiver whose clock is the common time (but for its jumps, and unless anchored).
    origin : int
        ns since 1970 of second 0 of the common time.
    knots : array (K,)
        Common time, s from `origin`, equally spaced.
    values, slopes : array (R, K)
        Offset without jumps (s) and its slope (s/s) at the knots, one row a receiver in the order
        of `receivers.names`; NaN = not synchronised.
    values_sd : array (R, K)
        Standard error of `values`, s.
    noise : array (R,)
        Intensity of each clock's integrated random walk, s^2/s^3.
    covariance : array (M, 4, 4)
        Of offset and slope times spacing at both ends of each interval between knots, s^2, jumps
        included: the K - 1 intervals of the first receiver, one with a jump once for each side of
        it, then those of the next.
    jumps : ClockJumps
    speeds, speeds_sd : array (K,)
        Sound speed at the knots, m/s; sd 0 = it was given.
    span : array (R, 2)
        First and last sync detection used of each receiver, common time, s; NaN as above.
    sigma : float
        Error sd of direct arrivals, s.
    reflected : float
        Share of sync arrivals that came late.
    delay, delay_sd : array (D,)
        How late each deployment hears its own sync tag, s; 0 = it never did.
    position_sd : array (D, 2)
        Standard error of the fitted x, y of each deployment, m; 0 = held.
    shift : array (D, 2)
        Fitted minus given x, y, m.
    residuals : SyncResiduals
    value_draws, slope_draws : array (S, R, K)
        Posterior draws of `values` and `slopes`.
    jump_draws : array (S, J)
        Of the jumps' sizes, s.
    notes : tuple of Note
    """

    receivers: Receivers
    reference: str
    origin: int
    knots: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    values_sd: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    jumps: ClockJumps
    speeds: np.ndarray
    speeds_sd: np.ndarray
    span: np.ndarray
    sigma: float
    reflected: float
    delay: np.ndarray
    delay_sd: np.ndarray
    position_sd: np.ndarray
    shift: np.ndarray
    residuals: SyncResiduals
    value_draws: np.ndarray
    slope_draws: np.ndarray
    jump_draws: np.ndarray
    notes: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        shape = (len(self.receivers.names), len(self.knots))
        for name in ("values", "slopes", "values_sd"):
            if getattr(self, name).shape != shape:
                raise InputError(f"ClockSync.{name} must have shape {shape}")
        if self.reference not in self.receivers.names:
            raise InputError(f"reference '{self.reference}' is not among the receivers")

    @property
    def spacing(self) -> float:
        """Distance between knots, s."""
        return float(self.knots[1] - self.knots[0])

    @property
    def synced(self) -> np.ndarray:
        """Whether each receiver of `receivers.names` is synchronised (R,)."""
        return np.asarray(np.isfinite(self.values).all(axis=1))

    @property
    def sound_speed(self) -> float:
        """Sound speed, m/s, its mean where it varies."""
        return float(1 / np.mean(1 / self.speeds))

    @property
    def sound_speed_sd(self) -> float:
        """Standard error of the sound speed, m/s; 0 = it was given."""
        return float(self.speeds_sd.mean())

    @property
    def residual_sd(self) -> float:
        """Standard deviation of the residuals that count, s."""
        used = self.residuals.used
        return float(self.residuals.residual[used].std()) if used.any() else float("nan")

    @property
    def residual_mad(self) -> float:
        """1.4826 times the median absolute deviation of the residuals that count, s."""
        r = self.residuals.residual[self.residuals.used]
        return float(1.4826 * np.median(np.abs(r - np.median(r)))) if len(r) else float("nan")
