"""Sound speed by depth: what a cast, or a string of loggers, says of the water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.data import _arrays
from maloc.errors import InputError

__all__ = ["SoundProfile"]


@dataclass(frozen=True, eq=False)
class SoundProfile:
    """Sound speed at depths, linear between them and constant beyond; one cast or several in time.

    Parameters
    ----------
    depth : array (K,)
        m, positive down, ascending.
    speed : array (N, K)
        m/s, a row a cast.
    time : array (N,), optional
        Casts' times, s since 1970 UTC, ascending; speeds are linear between them and constant
        beyond. None: one cast for all times.
    sd : float
        Standard deviation of an error that all depths and times share, m/s; 0 = exact.

    Raises
    ------
    InputError
        If shapes do not agree, depths or times do not ascend, or a speed is not positive.
    """

    depth: np.ndarray
    speed: np.ndarray
    time: np.ndarray | None = None
    sd: float = 0.0

    def __post_init__(self) -> None:
        n, k = len(np.atleast_2d(self.speed)), len(np.atleast_1d(self.depth))
        depth = _arrays.floats(self.depth, "depth", (k,), finite=True)
        speed = np.atleast_2d(np.asarray(self.speed, float))
        speed = _arrays.floats(speed, "speed", (n, k), finite=True, positive=True)
        if (np.diff(depth) <= 0).any():
            raise InputError("depths of a profile of sound speed do not ascend")
        if self.time is None and n > 1:
            raise InputError(f"a profile of {n} casts needs their times")
        if self.time is not None:
            time = _arrays.floats(self.time, "time", (n,), finite=True)
            if (np.diff(time) <= 0).any():
                raise InputError("times of the casts do not ascend")
            object.__setattr__(self, "time", time)
        if not (np.isfinite(self.sd) and self.sd >= 0):
            raise InputError(f"a sound speed's sd of {self.sd:g} m/s is negative")
        object.__setattr__(self, "depth", depth)
        object.__setattr__(self, "speed", speed)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Speeds (T, K) at times (T,), s since 1970 UTC; (1, K) where there is but one cast."""
        if self.time is None or len(self.time) == 1:
            return self.speed
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        share = (time - self.time[after - 1]) / (self.time[after] - self.time[after - 1])
        share = np.clip(share, 0.0, 1.0)[:, None]
        return (1 - share) * self.speed[after - 1] + share * self.speed[after]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SoundProfile) or (self.time is None) != (other.time is None):
            return False
        mine, theirs = ((p.depth, p.speed, p.time, p.sd) for p in (self, other))
        pairs = zip(mine, theirs, strict=True)
        return all(a is None or b is None or np.array_equal(a, b) for a, b in pairs)

    def __repr__(self) -> str:
        low, high = self.speed.min(), self.speed.max()
        casts = "" if len(self.speed) == 1 else f", {len(self.speed)} casts"
        return (
            f"SoundProfile: {low:.1f} to {high:.1f} m/s from {self.depth[0]:g} to "
            f"{self.depth[-1]:g} m{casts}"
        )
