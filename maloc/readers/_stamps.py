"""Dates and times of the commonest form, a million at once, through integers only."""

from __future__ import annotations

import numpy as np
import polars as pl

__all__ = ["fixed"]

_DAYS = np.array([0, 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31], np.int32)  # of each month


def fixed(cell: pl.Series) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parse the commonest form, "2021-06-01 10:00:00.217" with 0 to 9 decimals, all at once.

    Parameters
    ----------
    cell : Series (N,) of text
        Dates and times; null = missing.

    Returns
    -------
    seconds : array (N,) of int64
        Since 1970, as written.
    fraction : array (N,) of int64
        ns.
    done : array (N,) of bool
        Where the value has this form and is a possible date; the rest is left alone.
    """
    n = len(cell)
    seconds, fraction, done = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, bool)
    size = cell.str.len_bytes().fill_null(0).to_numpy()
    for length in np.unique(size):
        if length != 19 and not 21 <= length <= 29:
            continue
        mine = size == length
        text = cell.filter(pl.Series(mine)).str.join("")[0].encode()
        raw = np.ascontiguousarray(np.frombuffer(text, np.uint8).reshape(-1, length).T)
        rows = np.flatnonzero(mine)
        seconds[rows], fraction[rows], done[rows] = _digits(raw)
    return seconds, fraction, done


def _digits(raw: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Seconds, ns and validity of stamps given as bytes (length, N)."""
    length, n = raw.shape
    ok = (raw[4] == ord("-")) & (raw[7] == ord("-"))
    ok &= (raw[10] == ord(" ")) | (raw[10] == ord("T"))
    ok &= (raw[13] == ord(":")) & (raw[16] == ord(":"))
    if length > 19:
        ok &= raw[19] == ord(".")
    places = [i for i in range(length) if i not in (4, 7, 10, 13, 16, 19)]
    for i in places:
        ok &= (raw[i] - np.uint8(ord("0"))) < 10

    def number(a: int, b: int) -> np.ndarray:
        out = np.zeros(n, np.int32)  # nine digits at most
        for i in range(a, b):
            out = out * np.int32(10) + (raw[i] - np.uint8(ord("0")))
        return out

    year, month, day = number(0, 4), number(5, 7), number(8, 10)
    hour, minute, second = number(11, 13), number(14, 16), number(17, 19)
    ok &= (year >= 1970) & (year < 2200) & (month >= 1) & (month <= 12) & (day >= 1)
    ok &= (hour < 24) & (minute < 60) & (second < 60)
    leap = (year % 4 == 0) & ((year % 100 != 0) | (year % 400 == 0))
    ok &= day <= _DAYS[np.where(ok, month, 0)] + (leap & (month == 2))
    # years counted from March, so that the leap day is the last: months before then need no rule
    early = month <= 2
    y, m = year - early, month + np.where(early, 9, -3)
    days = 365 * y + y // 4 - y // 100 + y // 400 + (153 * m + 2) // 5 + day - 719_469
    clock = (hour * 60 + minute) * 60 + second
    seconds = days.astype(np.int64) * 86_400 + clock
    fraction = np.zeros(n, np.int64)
    if length > 19:
        fraction = number(20, length).astype(np.int64) * 10 ** (29 - length)
    return np.where(ok, seconds, 0), np.where(ok, fraction, 0), ok
