"""Tables of tracks, whoever wrote them, brought to one set of columns.

Columns are recognised by their names: maloc's own (``time`` or ``t``, ``x``, ``y``), YAPS's
(``top`` or ``epo``, ``x_sd``), a VPS's (``DATETIME``, ``X``, ``Y``), a GPS's (``utm_x``); kaltoa's
and others' by words for the same. Numbers for a time are seconds since 1970 where they are large
enough to be, and else seconds from an origin of the data set's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["as_track"]

_EPOCH = 1e8  # s; 1973, or three years into a data set
# of several columns the first named here is taken
_TIME = "time top epo ts datetime timestamp emission_time date_time t seconds"
_ROLES: dict[str, str] = {
    "x": "x utm_x easting east",
    "y": "y utm_y northing north",
    "sd_x": "sd_x x_sd sdx",
    "sd_y": "sd_y y_sd sdy",
    "var_x": "var_x x_var varx cov_xx xx",
    "var_y": "var_y y_var vary cov_yy yy",
    "cov_xy": "cov_xy covxy xy",
    **{f"{axis}_{end}": f"{axis}_{end}" for axis in "xy" for end in ("lo", "hi")},
}
_DEGREES = {"longitude", "lon", "latitude", "lat", "location_long", "location_lat"}


def as_track(source: Any, name: str) -> pl.DataFrame:
    """Bring a table to columns that mean one thing.

    Parameters
    ----------
    source : polars.DataFrame, Positions, str or Path
        A table, or the CSV that it is in.
    name : str
        "track" or "truth", for messages.

    Returns
    -------
    polars.DataFrame
        As many rows: ``time`` (dates) or ``t`` (s), or both; ``x``, ``y`` (m) and, where they are
        there, ``sd_x``, ``sd_y`` (m), ``cov_xy`` (m2), ``x_lo``, ``x_hi``, ``y_lo``, ``y_hi`` (m).

    Raises
    ------
    InputError
        If there is no such file, it is of several tags, or coordinates or times are not found.
    """
    import polars as pl

    from maloc.readers._columns import plain

    table = _table(source, name)
    simple: dict[str, str] = {}
    for column in table.columns:
        simple.setdefault(plain(column), column)
    tag = simple.get("detectedid" if isinstance(source, pl.DataFrame | str | Path) else "tag")
    if tag is not None and (n := table[tag].n_unique()) > 1:
        raise InputError(f"the {name} is of {n} tags", mend="give the rows of one")
    found = {role: _first(simple, words) for role, words in _ROLES.items()}
    for axis in "xy":
        if found[axis] is None:
            degrees = "maloc.read_positions(file, crs=...) projects degrees"
            mend = degrees if _DEGREES & simple.keys() else "x and y are metres"
            raise InputError(f"the {name} has no column '{axis}'", mend=mend)
    out = {role: table[column].cast(pl.Float64) for role, column in found.items() if column}
    for axis in "xy":
        variance = out.pop(f"var_{axis}", None)
        if variance is not None:
            out.setdefault(f"sd_{axis}", variance.sqrt())
    return pl.DataFrame(_times(table, simple, name) | out)


def _table(source: Any, name: str) -> pl.DataFrame:
    import polars as pl

    if isinstance(source, str | Path):
        if not Path(source).exists():
            raise InputError("does not exist", file=source)
        return pl.read_csv(source, null_values=["NA", "NaN", ""], infer_schema_length=None)
    return source if isinstance(source, pl.DataFrame) else source.to_frame()


def _first(simple: dict[str, str], words: str) -> str | None:
    return next((simple[word] for word in words.split() if word in simple), None)


def _times(table: pl.DataFrame, simple: dict[str, str], name: str) -> dict[str, Any]:
    """Columns ``time`` and ``t``, as far as the table has them."""
    if {"second", "millisecond"} <= simple.keys():  # kaltoa keeps them apart
        whole, rest = (_seconds(table[simple[c]]) for c in ("second", "millisecond"))
        return _placed(whole + 1e-3 * rest)
    column = _first(simple, _TIME)
    own = _placed(_seconds(table["t"])) if "t" in table.columns else {}
    if column is None or (own and table[column].null_count()):
        if not own:
            mend = "'time' are dates, 't' seconds"
            raise InputError(f"the {name} has no column 'time' or 't'", mend=mend)
        return own
    values = table[column]
    if values.dtype.is_numeric():
        return own | _placed(_seconds(values))
    return own | {"time": _dates(values, name)}


def _dates(values: pl.Series, name: str) -> pl.Series:
    import polars as pl

    if isinstance(values.dtype, pl.Datetime):
        return values
    try:
        stamps = values.cast(pl.String).str.strip_chars_end("Z").to_numpy()
        return pl.Series("time", stamps.astype("datetime64[ns]"))
    except ValueError:
        raise InputError(
            f"the {name}'s '{values.name}' holds '{values[0]}'",
            mend="dates are such as 2026-05-01T12:00:00.250, UTC",
        ) from None


def _seconds(values: pl.Series) -> np.ndarray:
    import polars as pl

    return values.cast(pl.Float64).to_numpy()


def _placed(seconds: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds since 1970 as dates, all others as they are."""
    if not len(seconds) or not np.nanmin(seconds) > _EPOCH:
        return {"t": seconds}
    whole = np.floor(seconds)
    ns = whole.astype(np.int64) * 10**9 + np.rint((seconds - whole) * 1e9).astype(np.int64)
    return {"time": ns.astype("datetime64[ns]")}
