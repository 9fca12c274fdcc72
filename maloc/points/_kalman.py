"""Where a tag is thought to be between localizations: a Kalman filter and the seed's rules.

Arnon et al. (2023), section 2.5. Plain NumPy on one tag: a few microseconds a ping.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from maloc.errors import InputError

__all__ = ["Prior", "Rules"]


@dataclass(frozen=True)
class Rules:
    """Thresholds of the seed, by name; the defaults are the seed's.

    Parameters
    ----------
    unsure : int
        A place found from so few receivers is ambiguous while the prior is (3).
    sure : int
        Receivers that make the prior unambiguous at once (6).
    recent, recent_receivers : int
        So many localizations (5) of so many receivers or more (4) make it unambiguous too; it is
        then set to the one nearest their medians.
    stale : float
        A prior whose last localization is older is ambiguous again, s (20 min).
    speed : float
        A localization farther from the prior than `speed` x the time between does not advance it,
        m/s (20).
    gate_three, gate_four : float
        Nor does one farther than this from three (250) or four (1000) receivers, m.
    drift, drift_most : float
        Standard deviation of the movement between localizations: `drift` x the time, at most
        `drift_most`, m/s (10) and m (750).
    velocity : bool
        Constant velocity in place of constant position.
    density : bool
        Weigh places by the prior's density rather than the distance to it.
    queue : int
        Largest number of ambiguous pings kept for the way back.
    hint_window : float
        How old a hint may be, s (12 h).
    hints : int
        How many of the latest hints are used (10).

    Raises
    ------
    InputError
        If a threshold is not positive.
    """

    unsure: int = 3
    sure: int = 6
    recent: int = 5
    recent_receivers: int = 4
    stale: float = 1200.0
    speed: float = 20.0
    gate_three: float = 250.0
    gate_four: float = 1000.0
    drift: float = 10.0
    drift_most: float = 750.0
    velocity: bool = False
    density: bool = False
    queue: int = 1000
    hint_window: float = 43200.0
    hints: int = 10

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, bool) and not value > 0:
                raise InputError(f"rule {name} must be positive, got {value}")


@dataclass
class Prior:
    """The state of one tag: position (and velocity), covariance, and whether it is ambiguous."""

    rules: Rules
    mean: np.ndarray = field(default_factory=lambda: np.zeros(4))
    covariance: np.ndarray = field(default_factory=lambda: np.diag([1e12, 1e12, 100.0, 100.0]))
    time: float = -np.inf
    ambiguous: bool = True
    patience: float = 0.0  # s; how long the state holds without a localization
    seen: list = field(default_factory=list)  # (time, position, covariance) of four or more

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """Mean (2,), covariance (2, 2) and ambiguity at a time (either direction), s."""
        mean, covariance = self._ahead(time)
        stale = not np.isfinite(self.time) or abs(time - self.time) > self.patience
        return mean[:2], covariance[:2, :2], self.ambiguous or stale

    def _ahead(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        if not np.isfinite(self.time):
            return self.mean, self.covariance
        rules, dt = self.rules, time - self.time
        step = np.eye(4)
        if rules.velocity:
            step[:2, 2:] = dt * np.eye(2)
        spread = min(rules.drift * abs(dt), rules.drift_most) ** 2
        noise = np.zeros((4, 4))
        noise[:2, :2] = spread * np.eye(2)
        if rules.velocity:
            noise[2:, 2:] = min(rules.drift, rules.drift_most / max(abs(dt), 1e-9)) ** 2 * np.eye(2)
        return step @ self.mean, step @ self.covariance @ step.T + noise

    def consistent(self, time: float, position: np.ndarray, receivers: int) -> bool:
        """Whether a localization may advance the state."""
        rules = self.rules
        away = float(np.linalg.norm(position - self.at(time)[0]))
        if away > rules.speed * max(abs(time - self.time), 1.0):
            return False
        gate = {3: rules.gate_three, 4: rules.gate_four}
        return away <= (gate.get(receivers, np.inf) if receivers > 2 else 0.0)

    def observe(
        self, time: float, position: np.ndarray, covariance: np.ndarray, receivers: int
    ) -> bool:
        """Take a localization in; returns whether the state became unambiguous by it."""
        rules = self.rules
        if self.at(time)[2] and not self.ambiguous:
            self.ambiguous, self.seen = True, []
        if receivers >= rules.recent_receivers:
            self.seen.append((time, position, covariance))
        self.seen = [s for s in self.seen if abs(time - s[0]) <= rules.stale][-rules.recent :]
        if self.ambiguous:
            if receivers >= rules.sure:
                return self._set(time, position, covariance)
            if len(self.seen) == rules.recent:
                places = np.array([s[1] for s in self.seen])
                best = np.linalg.norm(places - np.median(places, axis=0), axis=1).argmin()
                return self._set(*self.seen[best])
        elif self.consistent(time, position, receivers):
            self._update(time, position, covariance)
        return False

    def _set(self, time: float, position: np.ndarray, covariance: np.ndarray) -> bool:
        self.mean = np.append(position, [0.0, 0.0])
        self.covariance = np.diag([0.0, 0.0, self.rules.drift**2, self.rules.drift**2])
        self.covariance[:2, :2] = covariance
        self.time, self.ambiguous, self.patience = time, False, self.rules.stale
        return True

    def _update(self, time: float, position: np.ndarray, covariance: np.ndarray) -> None:
        mean, ahead = self._ahead(time)
        gain = ahead[:, :2] @ np.linalg.inv(ahead[:2, :2] + covariance)
        self.mean = mean + gain @ (position - mean[:2])
        self.covariance = ahead - gain @ ahead[:2]
        self.time, self.patience = time, self.rules.stale
