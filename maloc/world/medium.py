"""Sound speed in water, from temperature, salinity and depth.

The speed at each ping goes into `ArrivalTimes.sound_speed`; how sure it is into
`ArrivalTimes.sound_speed_sd`, and the models then estimate what is left of its error.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes

__all__ = ["mackenzie", "with_sound_speed"]

MACKENZIE_SD = 0.07  # m/s, the equation's own standard error
_RANGES = {"temperature": (-2.0, 35.0), "salinity": (0.0, 45.0), "depth": (0.0, 8000.0)}


def mackenzie(temperature: Any, salinity: Any = 35.0, depth: Any = 0.0) -> np.ndarray:
    """Speed of sound in sea water by nine terms in temperature, salinity and depth.

    Parameters
    ----------
    temperature : array
        deg C, 2 to 30 in the original.
    salinity : array
        Practical salinity, 25 to 40 in the original; in fresh water (0) it is within 1 m/s of
        other equations up to 25 deg C.
    depth : array
        m, 0 to 8000.

    Returns
    -------
    array
        m/s, the broadcast shape; NaN where an input is NaN.

    Raises
    ------
    InputError
        If a value is not one of water: temperature -2 to 35, salinity 0 to 45, depth 0 to 8000.

    References
    ----------
    Mackenzie (1981) Nine-term equation for sound speed in the oceans. J. Acoust. Soc. Am. 70(3):
    807-812.
    """
    given = {"temperature": temperature, "salinity": salinity, "depth": depth}
    for name, value in given.items():
        low, high = _RANGES[name]
        wrong = np.asarray(value, float)
        wrong = wrong[(wrong < low) | (wrong > high)]
        if wrong.size:
            raise InputError(f"{name} {wrong.flat[0]:g} is not between {low:g} and {high:g}")
    t, s, d = (np.asarray(v, float) for v in (temperature, salinity, depth))
    s = s - 35.0
    return (
        1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * s
        + 1.630e-2 * d + 1.675e-7 * d**2 - 1.025e-2 * t * s - 7.139e-13 * t * d**3
    )  # fmt: skip


def with_sound_speed(
    toa: ArrivalTimes,
    table: Any,
    *,
    salinity: float | None = None,
    depth: float = 0.0,
    sd: float = 1.0,
) -> ArrivalTimes:
    """Give arrival times the sound speed that a table of the water's state foretells.

    Parameters
    ----------
    toa : ArrivalTimes
        With a date (`origin`).
    table : DataFrame, or path of a CSV file
        Columns time (ISO 8601 UTC) and temperature (deg C); salinity and depth (m) where they
        vary. Or time and sound_speed (m/s). Linear in time between rows, constant beyond.
    salinity : float, optional
        Where the table has no column of it.
    depth : float
        m, where the table has no column of it.
    sd : float
        Standard deviation of an error that all pings share, m/s: of the loggers, and of the
        water between them.

    Returns
    -------
    ArrivalTimes

    Raises
    ------
    InputError
        If the arrival times have no date, a column is missing, a value is not one of water, or
        the table does not reach within a day of the pings.
    """
    if toa.origin is None:
        raise InputError("the arrival times have no date: a table of the water cannot be met")
    time, speed = speed_table(table, salinity, depth)
    at = toa.first + toa.origin / NS
    heard = at[np.isfinite(at)]
    if len(heard) and (heard.max() < time[0] - 86_400 or heard.min() > time[-1] + 86_400):
        raise InputError("the table of the water is of another time than the pings")
    return toa.replace(sound_speed=np.interp(at, time, speed), sound_speed_sd=float(sd))


def speed_table(
    table: Any, salinity: float | None = None, depth: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (s since 1970 UTC, ascending) and sound speeds of a table."""
    import polars as pl

    from maloc.data import _arrays

    path = Path(table) if isinstance(table, str | Path) else None
    if path is not None and not path.is_file():
        raise InputError("no such file", file=path)
    rows = pl.read_csv(path) if path is not None else _arrays.frame(table)
    name = {c.strip().lower(): c for c in rows.columns}
    for needed in ("time",) if "sound_speed" in name else ("time", "temperature"):
        if needed not in name:
            raise InputError(f"no column '{needed}'", file=path, mend="see maloc.medium")
    when = rows[name["time"]]
    if when.dtype == pl.String:
        when = when.str.strip_suffix("Z").str.to_datetime(time_unit="ns", strict=False)
    if when.dtype.base_type() is not pl.Datetime or when.null_count():
        row = int(when.is_null().arg_max() or 0) + 2 if when.null_count() else None
        raise InputError("not an ISO 8601 time in UTC", file=path, row=row, column="time")
    seconds = when.dt.cast_time_unit("ns").dt.replace_time_zone(None).to_physical().to_numpy() / NS
    values = {c: rows[o].cast(pl.Float64, strict=False).to_numpy() for c, o in name.items()
              if c in ("sound_speed", "temperature", "salinity", "depth")}  # fmt: skip
    if "sound_speed" in values:
        speed = values["sound_speed"]
    else:
        salt = values.get("salinity", salinity)
        if salt is None:
            raise InputError("no column 'salinity'", file=path, mend="give salinity=")
        speed = mackenzie(values["temperature"], salt, values.get("depth", depth))
    if (bad := np.flatnonzero(~np.isfinite(speed))).size:
        raise InputError("a value is missing or no number", file=path, row=int(bad[0]) + 2)
    order = np.argsort(seconds, kind="stable")
    return seconds[order], np.broadcast_to(speed, seconds.shape)[order]
