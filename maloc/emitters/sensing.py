"""Receivers that hear emitters without identity, and what is known of what they hear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.errors import InputError

__all__ = ["Sensing"]


@dataclass(frozen=True, eq=False)
class Sensing:
    """Receivers, and what is known of what they hear.

    Parameters
    ----------
    receivers : array (R, 2)
        Metres.
    speed : float
        Of propagation, m/s.
    sigma : float
        Standard deviation of a measurement, s.
    p_detect : float
        Probability that a receiver (a pair) measures an emission.
    n_false : float
        False measurements to be expected of a receiver (a pair) in one scan.
    reference : int or None
        None: arrival times. A number: differences of arrival times from this receiver's.
    low, high : pair of float
        Corners of the box in which emitters may be, m; without them the receivers' box widened by
        its own larger side.
    expected : float
        Emissions to be expected in a scan.
    gate : float
        Standard deviations that a measurement may be off what the others of its set predict.
    most : int
        Hypotheses of one size kept, the likeliest; what is beyond is counted.

    Raises
    ------
    InputError
        If there are too few receivers, or a number makes no sense.
    """

    receivers: np.ndarray
    speed: float
    sigma: float
    p_detect: float = 0.95
    n_false: float = 1.0
    reference: int | None = None
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    expected: float = 1.0
    gate: float = 4.0
    most: int = 20_000

    def __post_init__(self) -> None:
        xy = np.array(self.receivers, float)
        if xy.ndim != 2 or xy.shape[1:] != (2,) or not np.isfinite(xy).all():
            raise InputError(f"receivers must be (R, 2) numbers, got shape {xy.shape}")
        if len(xy) < 3:
            raise InputError(f"{len(xy)} receivers: positions need at least 3")
        if self.reference is not None and not 0 <= self.reference < len(xy):
            raise InputError(f"reference {self.reference} is none of {len(xy)} receivers")
        for name in ("speed", "sigma", "expected", "gate", "most"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} {getattr(self, name)} is not positive")
        if not 0 < self.p_detect <= 1 or self.n_false < 0:
            raise InputError("p_detect must be a chance above 0, n_false not negative")
        wide = float(np.ptp(xy, axis=0).max())
        low = xy.min(axis=0) - wide if self.low is None else np.array(self.low, float)
        high = xy.max(axis=0) + wide if self.high is None else np.array(self.high, float)
        if not (high > low).all():
            raise InputError("the box of emitters has no area")
        xy.setflags(write=False)
        for name, value in (("receivers", xy), ("low", tuple(low)), ("high", tuple(high))):
            object.__setattr__(self, name, value)

    @property
    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """First and last measurement possible at each receiver (R,), s.

        Of arrival times from the earliest emission on, all emissions of a scan being at about one
        time; of differences plus or minus the time between the two receivers.
        """
        if self.reference is not None:
            apart = np.linalg.norm(self.receivers - self.receivers[self.reference], axis=1)
            return -apart / self.speed, apart / self.speed
        corner = np.maximum(self.high - self.receivers, self.receivers - self.low)
        return np.zeros(len(corner)), np.linalg.norm(corner, axis=1) / self.speed

    @property
    def false_density(self) -> np.ndarray:
        """False measurements a metre of range at each receiver (R,).

        At least a thousandth of one over the window, so that a set-up without any still works.
        """
        first, last = self.window
        length = np.maximum((last - first) * self.speed, 1e-9)
        return max(self.n_false, 1e-3) / length

    @property
    def area(self) -> float:
        """Of the box in which emitters may be, m^2."""
        return float(np.prod(np.asarray(self.high) - np.asarray(self.low)))

    @property
    def emission_density(self) -> float:
        """Emissions to be expected a m^2, and a metre of emission's range where that is unknown."""
        volume = self.area
        if self.reference is None:
            volume *= float((self.window[1]).max()) * self.speed
        return self.expected / volume
