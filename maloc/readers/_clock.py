"""Text to int64 ns since 1970, through integers only: ".5" is 500 ms and nothing is rounded."""

from __future__ import annotations

import re

import numpy as np
import polars as pl

from maloc.data._time import NS
from maloc.readers._stamps import fixed
from maloc.readers._text import Table

_STAMP = (
    r"^(\d{4})[-/](\d{2})[-/](\d{2})(?:[T ]\s*(\d{2}):(\d{2})(?::(\d{2})(?:[.,](\d{0,18}))?)?)?"
    r"\s*(Z|z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})?$"
)
_SECONDS = r"^([+-]?)(\d{0,11})(?:\.(\d*))?$"
_UTC = ("UTC", "GMT", "Z", "Etc/UTC")
LATEST_S = 7_258_118_400  # 2200-01-01; text dates outside 1970..2200 are taken for mistakes


def stamps(
    table: Table, k: int, tz: str | None = "UTC", *, coarse: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Parse column `k` as date and time.

    Parameters
    ----------
    table : Table
        The file.
    k : int
        Column.
    tz : str or None
        Zone of stamps that name none; None = they must name one.
    coarse : bool
        Accept a stamp without seconds (deployments).

    Returns
    -------
    ns : array (N,) of int64
        ns since 1970 UTC (0 where missing).
    known : array (N,) of bool
        Where there was a value.

    Raises
    ------
    InputError
        If a stamp cannot be read, does not exist or occurs twice in its zone.
    """
    cell = table.cells[k]
    if isinstance(cell.dtype, pl.Datetime):
        return _typed(table, cell, k, tz)
    if cell.dtype == pl.Date:
        cell = cell.cast(pl.String)
    elif cell.dtype != pl.String:
        raise table.error(
            "a column of plain numbers where dates are expected", None, _name(table, k)
        )
    else:
        cell = table.text(k)
    known = cell.is_not_null().to_numpy()
    seconds, fraction, done = fixed(cell)
    zone = pl.Series([None], dtype=pl.String).new_from_index(0, len(cell))
    rest = np.flatnonzero(known & ~done)
    if len(rest):
        parts = _free(table, cell, rest, k, coarse)
        seconds[rest], fraction[rest] = parts[:2]
        zone = zone.scatter(rest, parts[2])
    out = to_utc(table, seconds, zone, known, k, tz)
    return np.where(known, out * NS + fraction, 0), known


def _free(
    table: Table, cell: pl.Series, rows: np.ndarray, k: int, coarse: bool
) -> tuple[np.ndarray, np.ndarray, pl.Series]:
    """Seconds, ns and named zone of the values at `rows`, in any form known."""
    p = cell.gather(rows).str.extract_groups(_STAMP).struct.unnest()
    year, month, day, hour, minute, second, fraction, zone = (p[str(i)] for i in range(1, 9))
    read = year.is_not_null()
    if not coarse:
        read = read & second.is_not_null()
    clock = [hour.fill_null("00"), minute.fill_null("00"), second.fill_null("00")]
    joined = pl.select(
        pl.concat_str([year, month, day, *clock], separator=" ").alias("t")
    ).to_series()
    when = joined.str.to_datetime("%Y %m %d %H %M %S", strict=False, time_unit="us")
    seconds = when.dt.epoch("s")
    ok = read & when.is_not_null() & (seconds >= 0) & (seconds < LATEST_S)
    ok = ok & (second.is_null() | (second != "60"))
    bad = np.flatnonzero(~ok.fill_null(False).to_numpy())
    if len(bad):
        raise _unreadable(table, cell, int(rows[bad[0]]), k)
    return seconds.to_numpy().astype(np.int64), _nanoseconds(fraction), zone


def _typed(table: Table, cell: pl.Series, k: int, tz: str | None) -> tuple[np.ndarray, np.ndarray]:
    zone = cell.dtype.time_zone  # pyright: ignore[reportAttributeAccessIssue]
    known = cell.is_not_null().to_numpy()
    stamp = cell.cast(pl.Datetime("ns", zone)).to_physical().fill_null(0).to_numpy()
    if zone is None and tz not in _UTC:
        if tz is None:
            raise _which_zone(table, k)
        nothing = pl.Series([None] * len(cell), dtype=pl.String)
        whole = to_utc(table, stamp // NS, nothing, known, k, tz)
        stamp = whole * NS + stamp % NS
    return np.asarray(stamp, dtype=np.int64), known


def _nanoseconds(fraction: pl.Series) -> np.ndarray:
    digits = fraction.fill_null("").str.slice(0, 9).str.pad_end(9, "0")
    return digits.cast(pl.Int64).to_numpy()


def to_utc(
    table: Table, seconds: np.ndarray, zone: pl.Series, known: np.ndarray, k: int, tz: str | None
) -> np.ndarray:
    """Shift local seconds by the offset each stamp names, or else by the zone `tz`."""
    out = np.asarray(seconds, dtype=np.int64)
    named = zone.is_not_null().to_numpy()
    if named.any():
        offsets = {z: _offset(z) for z in zone.drop_nulls().unique().to_list()}
        shift = zone.replace_strict(offsets, default=0, return_dtype=pl.Int64)
        out = out - shift.fill_null(0).to_numpy()
    bare = known & ~named
    if tz in _UTC or not bare.any():
        return out
    if tz is None:
        raise _which_zone(table, k)
    when = (pl.Series(seconds) * 1_000_000).cast(pl.Datetime("us"))
    try:
        local = when.dt.replace_time_zone(tz, ambiguous="null", non_existent="null")
        first = when.dt.replace_time_zone(tz, ambiguous="earliest", non_existent="null")
    except pl.exceptions.PolarsError:
        raise table.error(
            f"unknown time zone '{tz}'", mend="use a name such as Europe/Copenhagen or Etc/GMT-1"
        ) from None
    lost = bare & local.is_null().to_numpy()
    if lost.any():
        nowhere = np.flatnonzero(lost & first.is_null().to_numpy())
        if len(nowhere):
            i = int(nowhere[0])
            raise table.error(
                f"local time {when[i]} does not exist in {tz} (clocks went forward)",
                i,
                _name(table, k),
                "check the zone, or export in UTC",
            )
        rows = [str(v) for v in table.line[lost][:8]]
        more = ", ..." if lost.sum() > 8 else ""
        raise table.error(
            f"ambiguous local time in {tz} (clocks went back) on {int(lost.sum())} lines: "
            f"{', '.join(rows)}{more}",
            int(np.flatnonzero(lost)[0]),
            _name(table, k),
            "export in UTC",
        )
    utc = local.dt.convert_time_zone("UTC").dt.epoch("s").fill_null(0).to_numpy()
    return np.where(bare, utc, out)


def _offset(zone: str) -> int:
    if zone[0] not in "+-":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    size = 3600 * int(digits[:2]) + 60 * int(digits[2:])
    return -size if zone[0] == "-" else size


def seconds(table: Table, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Parse column `k` as decimal seconds, exactly.

    Returns
    -------
    ns : array (N,) of int64
        Nanoseconds (0 where missing); digits beyond the ninth are cut.
    known : array (N,) of bool
        Where there was a value.

    Raises
    ------
    InputError
        If a value is not a plain decimal number.
    """
    cell = table.cells[k]
    if cell.dtype.is_integer():
        known = cell.is_not_null().to_numpy()
        whole = cell.cast(pl.Int64).fill_null(0).to_numpy()
        _refuse_large(table, whole, k)
        return whole * NS, known
    if cell.dtype.is_float():
        value = cell.cast(pl.Float64).fill_null(np.nan).to_numpy()
        known = np.isfinite(value)
        value = np.where(known, value, 0.0)
        whole = np.floor(value)
        _refuse_large(table, whole, k)
        return whole.astype(np.int64) * NS + np.rint((value - whole) * 1e9).astype(np.int64), known
    cell = table.text(k)
    known = cell.is_not_null().to_numpy()
    if table.delimiter != ",":
        cell = cell.str.replace(",", ".", literal=True)
    p = cell.str.extract_groups(_SECONDS).struct.unnest()
    digits = p["2"].str.len_chars() + p["3"].fill_null("").str.len_chars()
    bad = np.flatnonzero(known & (digits.fill_null(0) == 0).to_numpy())
    if len(bad):
        i = int(bad[0])
        value = str(cell[i])
        if re.fullmatch(r"[+-]?\d{12,}(\.\d*)?", value):
            _refuse_large(table, np.full(1, 10**12), k, i)
        mend = None
        if re.fullmatch(r"[+-]?\d+(\.\d+)?[eE][+-]?\d+", value):
            mend = "written with an exponent: digits are lost, export it again in full"
        raise table.error(f"'{value}' is not a number of seconds", i, _name(table, k), mend)
    whole = p["2"].cast(pl.Int64, strict=False).fill_null(0).to_numpy()
    _refuse_large(table, whole, k)
    size = whole * NS + _nanoseconds(p["3"])
    return np.where((p["1"] == "-").fill_null(False).to_numpy(), -size, size), known


def _refuse_large(table: Table, whole: np.ndarray, k: int, i: int | None = None) -> None:
    large = np.flatnonzero(np.abs(whole) >= 10**9 * 9)
    if len(large):
        raise table.error(
            "too large for seconds, perhaps milliseconds",
            int(large[0]) if i is None else i,
            _name(table, k),
            "give seconds",
        )


def refuse_outside(table: Table, ns: np.ndarray, known: np.ndarray, k: int) -> None:
    """Refuse Unix times outside 1970..2200."""
    bad = np.flatnonzero(known & ((ns < 0) | (ns >= LATEST_S * NS)))
    if len(bad):
        raise table.error(
            "a Unix time outside 1970..2200", int(bad[0]), _name(table, k), "give Unix seconds"
        )


def _name(table: Table, k: int) -> str:
    return table.columns[k]


def _which_zone(table: Table, k: int):
    return table.error(
        f"column '{_name(table, k)}' is local time",
        mend='say its zone, tz="Europe/Copenhagen" or tz="UTC" (or export in UTC)',
    )


def _unreadable(table: Table, cell: pl.Series, i: int, k: int):
    value, mend = str(cell[i]), "write it as 2021-06-01 10:00:00.217"
    if re.fullmatch(r"\d{1,2}[/.-]\d{1,2}[/.-]\d{2,4}.*", value):
        mend = "day and month cannot be told apart (re-saved by Excel?); " + mend
    elif re.fullmatch(r"\d{4}-\d{2}-\d{2}([T ]\d{2}:\d{2})?", value):
        mend = "the seconds are missing; " + mend
    return table.error(f"'{value}' is not a date and time", i, _name(table, k), mend)
