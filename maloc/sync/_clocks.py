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

    Fields are those of `maloc.sync.ClockSync`, which says what each is.
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
