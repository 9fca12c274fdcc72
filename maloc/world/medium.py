"""Sound speed in water, from temperature, salinity and depth, in time or by depth.

The speed at each ping goes into `ArrivalTimes.sound_speed`; how sure it is into
`ArrivalTimes.sound_speed_sd`, and the models then estimate what is left of its error. A profile
goes into `ArrivalTimes.profile` as well: where the track has depth, each arrival has the mean speed
between the tag's depth and its receiver's (`maloc.world.ray`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS
from maloc.data.sound_profile import SoundProfile
from maloc.errors import InputError
from maloc.readers.medium import MediumTable, read_medium
from maloc.world.seawater import CHEN_MILLERO_SD, chen_millero, mackenzie

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes

__all__ = ["chen_millero", "mackenzie", "sound_profile", "with_sound_speed"]

UNSTATED_SD = 1.0  # m/s: loggers' errors, and the water between them, where a table says nothing
_DAY = 86_400.0  # s
_STEPS = 100  # of the water column, over which an unknown depth is uniform


def with_sound_speed(
    toa: ArrivalTimes,
    table: Any,
    *,
    salinity: float | None = None,
    depth: float = 0.0,
    sd: float | None = None,
) -> ArrivalTimes:
    """Give arrival times the sound speed that a table of the water's state foretells.

    Temperature and salinity become a speed by `chen_millero`.

    Parameters
    ----------
    toa : ArrivalTimes
        With a date (`origin`), if the table has times.
    table : DataFrame, path of a CSV file, or SoundProfile
        Columns time (ISO 8601 UTC) and temperature (deg C); salinity and depth (m) where they
        vary. Or time and sound_speed (m/s). Linear in time between rows, constant beyond.
        A profile has depths and no times, or several depths at one time: see `sound_profile`.
        Then a ping's speed is the mean from the tag's depth (as sensed, linear in time in between)
        to the receivers'; from all depths alike where none was sensed. Give the arrival times
        their depths and `column` before.
    salinity : float, optional
        Where the table has no column of it.
    depth : float
        m, where the table has no column of it.
    sd : float, optional
        Standard deviation of an error that all pings share, m/s; 0 = exact. By default the
        equation's error and what columns temperature_sd, salinity_sd or sound_speed_sd state; 1
        where they state nothing. A flat track's speed by a profile is less sure by what it differs
        over the depths that were not known.

    Returns
    -------
    ArrivalTimes

    Raises
    ------
    InputError
        If the arrival times have no date, a column is missing, a value is not one of water, or
        the table does not reach within a day of the pings.
    """
    read = table if isinstance(table, SoundProfile | MediumTable) else read_medium(table)
    if isinstance(read, SoundProfile) or read.by_depth:
        profile = read if isinstance(read, SoundProfile) else _profile(read, salinity, sd)
        return _by_depth(toa, profile)
    speed, own = _speeds(read, salinity, depth)
    assert read.time is not None
    at = _met(toa, read.time)
    order = np.argsort(read.time, kind="stable")
    found = np.interp(at, read.time[order], speed[order])
    return toa.replace(sound_speed=found, sound_speed_sd=(own if sd is None else float(sd)) or None)


def sound_profile(
    table: Any, *, salinity: float | None = None, sd: float | None = None
) -> SoundProfile:
    """Read sound speed by depth from a cast or several.

    Parameters
    ----------
    table : DataFrame, or path of a CSV file
        Columns depth (m) and sound_speed (m/s), or depth, temperature (deg C) and salinity; time
        (ISO 8601 UTC) where there are several casts, the same in all rows of one.
    salinity, sd : float, optional
        As of `with_sound_speed`.

    Raises
    ------
    InputError
        If a column is missing, a value is not one of water, or a cast has a depth twice.
    """
    read = table if isinstance(table, MediumTable) else read_medium(table)
    return _profile(read, salinity, sd)


def speed_among(profile: SoundProfile, depth: np.ndarray) -> np.ndarray:
    """Sound speed between receivers by a profile, the mean over their pairs.

    Parameters
    ----------
    profile : SoundProfile
        Of N casts.
    depth : (R,) array
        Receivers' depths, m; the whole water column where none is known.

    Returns
    -------
    (N,) array
        m/s.
    """
    from maloc.world.ray import mean_slowness, ray_data

    own = np.asarray(depth, float)[np.isfinite(depth)]
    at = own if len(own) else _column(profile, own)
    out = np.empty(len(profile.speed))
    for i, row in enumerate(profile.speed):
        ray = ray_data(profile.depth, row[None], np.ones(len(at)))
        out[i] = 1 / float(np.mean(mean_slowness(ray, at, at)))
    return out


def speed_table(
    table: Any, salinity: float | None = None, depth: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (s since 1970 UTC, ascending) and sound speeds of a table; of a profile, casts' means.

    A profile without times: one at time 0.
    """
    read = read_medium(table)
    if read.by_depth:
        profile = _profile(read, salinity, None)
        time = np.zeros(1) if profile.time is None else profile.time
        return time, 1 / np.mean(1 / _evenly(profile, profile.speed), axis=1)
    assert read.time is not None
    order = np.argsort(read.time, kind="stable")
    return read.time[order], _speeds(read, salinity, depth)[0][order]


def _speeds(
    read: MediumTable, salinity: float | None, depth: float = 0.0
) -> tuple[np.ndarray, float]:
    """Speeds (N,) of a table's rows, and the sd of their common error, m/s."""
    values, n = read.values, len(read.table)
    stated = [values[k] for k in values if k.endswith("_sd")]
    if "sound_speed" in values:
        own = values.get("sound_speed_sd", np.full(n, UNSTATED_SD))
        return values["sound_speed"], float(np.sqrt(np.mean(own**2)))
    salt = values.get("salinity", salinity)
    if salt is None:
        raise read.error("no column 'salinity'", mend="add it, 0 for fresh water")
    own_depth = values.get("depth", np.full(n, depth))
    water = [values["temperature"], np.broadcast_to(salt, n), own_depth]
    try:
        speed = chen_millero(*water)
    except InputError:
        for i in range(n):  # which row it is
            try:
                chen_millero(*(w[i] for w in water))
            except InputError as problem:
                column = problem.problem.split()[0]
                raise read.error(problem.problem, i, column) from None
        raise
    if not stated:
        return speed, UNSTATED_SD
    square = np.full(n, CHEN_MILLERO_SD**2)
    for k, name in enumerate(("temperature", "salinity")):
        if (own := values.get(f"{name}_sd")) is not None:
            more = [w + 1e-2 * (j == k) for j, w in enumerate(water)]
            square += (own * (chen_millero(*more) - speed) / 1e-2) ** 2
    return speed, float(np.sqrt(square.mean()))


def _profile(read: MediumTable, salinity: float | None, sd: float | None) -> SoundProfile:
    if "depth" not in read.values:
        raise read.error("no column 'depth': a profile needs it")
    speed, own = _speeds(read, salinity)
    own = own if sd is None else float(sd)
    depth = read.values["depth"]
    casts = np.zeros(len(depth)) if read.time is None else read.time
    knots, times = np.unique(depth), np.unique(casts)
    rows = np.empty((len(times), len(knots)))
    for j, one in enumerate(times):
        mine = np.flatnonzero(casts == one)
        order = mine[np.argsort(depth[mine], kind="stable")]
        again = np.flatnonzero(np.diff(depth[order]) == 0)
        if len(again):
            i = int(order[again[0] + 1])
            raise read.error(f"depth {depth[i]:g} m is there twice in one cast", i, "depth")
        rows[j] = np.interp(knots, depth[order], speed[order])
    return SoundProfile(knots, rows, None if read.time is None else times, own)


def _met(toa: ArrivalTimes, time: np.ndarray) -> np.ndarray:
    """Times of the pings, s since 1970 UTC, if the table's reach them."""
    if toa.origin is None:
        raise InputError("the arrival times have no date: a table of the water cannot be met")
    at = toa.first + toa.origin / NS
    heard = at[np.isfinite(at)]
    if len(heard) and (heard.max() < time.min() - _DAY or heard.min() > time.max() + _DAY):
        raise InputError("the table of the water is of another time than the pings")
    return at


def _by_depth(toa: ArrivalTimes, profile: SoundProfile) -> ArrivalTimes:
    """A ping's speed by the depths that are known, and the profile to go by the others."""
    from maloc.world.ray import mean_slowness, ray_data

    at = np.zeros(len(toa)) if profile.time is None else _met(toa, profile.time)
    rows = profile.at(at)
    own = np.asarray(toa.receivers.depth)[toa.heard.any(axis=0)]
    own = own[np.isfinite(own)]
    column = _column(profile, own)
    there = own if len(own) else column
    sensed = np.full(len(toa), np.nan) if toa.depth is None else toa.depth
    known = np.flatnonzero(np.isfinite(sensed))
    ones = np.ones(len(toa))
    if len(known):
        tag = np.interp(toa.first, toa.first[known], sensed[known])[:, None]
    else:
        tag = np.broadcast_to(column, (len(toa), len(column)))
    slow = np.stack(
        [mean_slowness(ray_data(profile.depth, rows, ones), z, there) for z in tag.T], axis=1
    ).reshape(len(toa), -1)
    square = profile.sd**2
    if toa.column is None:
        square += float(np.mean(np.var(1 / slow, axis=1)))
    speed = 1 / slow.mean(axis=1)
    return toa.replace(sound_speed=speed, sound_speed_sd=np.sqrt(square) or None, profile=profile)


def _column(profile: SoundProfile, receivers: np.ndarray) -> np.ndarray:
    """Depths all over the water, m: down to the deepest receiver, or to the profile's end."""
    bottom = float(receivers.max()) if len(receivers) else float(profile.depth[-1])
    return (np.arange(_STEPS) + 0.5) / _STEPS * max(bottom, 0.1)


def _evenly(profile: SoundProfile, rows: np.ndarray) -> np.ndarray:
    """Speeds of casts (N, K) at depths all over the profile, (N, M)."""
    at = _column(profile, np.zeros(0))
    return np.stack([np.interp(at, profile.depth, row) for row in rows])
