"""Covariates of detection: receiver depth, time of day, noise and other readings.

Each is a value of `EncounterHistory.covariates`, which standardises it; a missing value counts as
average. Callables take seconds from the history's origin, so that nodes between pings have values
of their own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maloc.data._time import NS
from maloc.data.receivers import Receivers
from maloc.errors import InputError

__all__ = ["readings", "receiver_depth", "series", "time_of_day"]

DAY = 86400.0


def receiver_depth(receivers: Receivers) -> np.ndarray:
    """Depth of each receiver, (1, R) m.

    Raises
    ------
    InputError
        If no depth is known.
    """
    if not np.isfinite(receivers.depth).any():
        raise InputError("the receivers table has no depths")
    return receivers.depth[None]


def time_of_day(origin: int | None, period: float = DAY) -> dict[str, Callable]:
    """Sine and cosine of the time of day in UTC: two covariates, ``day_sin`` and ``day_cos``.

    Parameters
    ----------
    origin : int
        The history's: ns since 1970 UTC of second 0.
    period : float
        s; half a day for tides in the rough.

    Raises
    ------
    InputError
        If the data have no date.
    """
    if origin is None:
        raise InputError("the data have no date, so no time of day")
    phase = float(origin % int(period * NS)) / NS

    def angle(time: np.ndarray) -> np.ndarray:
        return 2 * np.pi * (phase + np.asarray(time)) / period

    return {"day_sin": lambda t: np.sin(angle(t)), "day_cos": lambda t: np.cos(angle(t))}


def series(time: np.ndarray, value: np.ndarray, origin: int) -> Callable:
    """One value for all receivers (wind, say), linear in time between readings.

    Parameters
    ----------
    time : array (M,) of int64
        ns since 1970 UTC, any order.
    value : array (M,)
        NaN = missing.
    origin : int
        The history's.

    Raises
    ------
    InputError
        If there is no reading.
    """
    time, value = np.asarray(time), np.asarray(value, float)
    good = np.flatnonzero(np.isfinite(value))
    if not len(good):
        raise InputError("no reading has a value")
    order = good[np.argsort(time[good], kind="stable")]
    seconds, values = (time[order] - origin) / NS, value[order]
    return lambda t: np.interp(t, seconds, values)


def readings(
    time: np.ndarray, receiver: np.ndarray, value: np.ndarray, receivers: Receivers, origin: int
) -> Callable:
    """A value for each receiver and time (noise, tilt), linear in time between its own readings.

    Parameters
    ----------
    time : array (M,) of int64
        ns since 1970 UTC, any order.
    receiver : array (M,) of str
        Whose reading it is.
    value : array (M,)
        NaN = missing. For the noise column of a detections table: ``detections.extra["noise"]``.
    receivers : Receivers
        R deployments; those without a reading have the average.
    origin : int
        The history's.

    Returns
    -------
    callable
        (T,) seconds -> (T, R).

    Raises
    ------
    InputError
        If no receiver of the table has a reading.
    """
    time, value = np.asarray(time), np.asarray(value, float)
    column = receivers.deployment_of(receiver, time)
    curves: dict[int, Callable] = {}
    for j in np.unique(column[(column >= 0) & np.isfinite(value)]):
        curves[int(j)] = series(time[column == j], value[column == j], origin)
    if not curves:
        raise InputError("no receiver of the table has a reading")

    def at(t: np.ndarray) -> np.ndarray:
        out = np.full((len(t), len(receivers)), np.nan)
        for j, curve in curves.items():
            out[:, j] = curve(t)
        return out

    return at
