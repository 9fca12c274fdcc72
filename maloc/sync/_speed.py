"""What is known of the sound speed before the fit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError

__all__ = ["Speed", "speed_of"]

DEFAULT, DEFAULT_SD = 1500.0, 50.0  # prior of an estimated sound speed, m/s


class Speed(NamedTuple):
    """Sound speed as asked for.

    Attributes
    ----------
    mean, sd : float
        Prior, m/s; sd 0 = given.
    varying : bool
        Whether it is followed in time.
    table : array (M, 2), optional
        Given times (s from the origin) and speeds (m/s).
    """

    mean: float
    sd: float
    varying: bool
    table: np.ndarray | None = None

    def at(self, time: np.ndarray) -> np.ndarray | None:
        """Given speed over the mean at times (K,), or None where there is no table."""
        if self.table is None:
            return None
        return np.interp(time, *self.table.T) / self.mean


def speed_of(sound_speed: Any, origin: int, last: int, sd: float = 0.0) -> Speed:
    """Read the arguments `sound_speed` and `sound_speed_sd` of `maloc.sync.fit`.

    Raises
    ------
    InputError
        If it is none of what that allows, or a table is of another time (ns since 1970).
    """
    if not (np.isfinite(sd) and sd >= 0):
        raise InputError(f"sound_speed_sd must be at least 0, got {sd}")
    if sound_speed is None or isinstance(sound_speed, str) and sound_speed == "varying":
        return Speed(DEFAULT, DEFAULT_SD, True)
    if isinstance(sound_speed, str) and sound_speed == "constant":
        return Speed(DEFAULT, DEFAULT_SD, False)
    if np.ndim(sound_speed) == 0 and isinstance(sound_speed, int | float | np.number):
        speed = float(sound_speed)
        if not (np.isfinite(speed) and speed >= 300.0):
            raise InputError(f"sound_speed must be at least 300, got {sound_speed}")
        return Speed(speed, float(sd), False)
    from maloc.world.medium import speed_table

    time, speeds = speed_table(sound_speed)
    if last / NS < time[0] - 86_400 or origin / NS > time[-1] + 86_400:
        raise InputError("the table of the water is of another time than the detections")
    return Speed(float(speeds.mean()), 0.0, False, np.column_stack([time - origin / NS, speeds]))
