"""Checks of arrays at the edge: one place where shape, type and finiteness are enforced."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc.errors import InputError


def text(values: Any, name: str, n: int | None = None) -> np.ndarray:
    """Return a read-only 1-D array of text, of length `n` if given."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "UOS" and raw.size:
        raise InputError(f"{name} must be text, got {raw.dtype}", mend="convert ids with str()")
    if raw.dtype.kind == "O" and any(v is None or isinstance(v, float) for v in raw.ravel()):
        raise InputError(f"{name} has missing or numeric values, text expected")
    return _done(raw.astype(str), name, n)


def times(values: Any, name: str, n: int | None = None) -> np.ndarray:
    """Return read-only int64 ns since 1970; datetime64 is converted, floats are refused."""
    raw = np.asarray(values)
    if raw.dtype.kind == "M":
        if np.isnat(raw).any():
            raise InputError(f"{name} has missing times (NaT)")
        raw = raw.astype("datetime64[ns]").astype(np.int64)
    elif raw.dtype.kind not in "iu" and raw.size:
        raise InputError(f"{name} must be int64 ns since 1970 UTC or datetime64, got {raw.dtype}")
    return _done(raw.astype(np.int64), name, n)


def integers(values: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return a read-only int64 array of this shape."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "iu" and raw.size:
        raise InputError(f"{name} must be whole numbers, got {raw.dtype}")
    return _shaped(raw.astype(np.int64), name, shape)


def floats(
    values: Any, name: str, shape: tuple[int, ...], *, finite: bool = False, positive: bool = False
) -> np.ndarray:
    """Return a read-only float64 array of this shape; infinities are always refused."""
    try:
        out = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers") from None
    out = _shaped(out, name, shape)
    if np.isinf(out).any() or (finite and np.isnan(out).any()):
        where = np.argwhere(np.isinf(out) | (finite & np.isnan(out)))[0]
        raise InputError(f"{name} is not finite at index {', '.join(map(str, where))}")
    if positive and (out <= 0).any():
        raise InputError(f"{name} must be positive")
    return out


def _done(out: np.ndarray, name: str, n: int | None) -> np.ndarray:
    if out.ndim != 1:
        raise InputError(f"{name} must have one dimension, got shape {out.shape}")
    return _shaped(out, name, (len(out) if n is None else n,))


def _shaped(out: np.ndarray, name: str, shape: tuple[int, ...]) -> np.ndarray:
    if out.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {out.shape}")
    out = out if out.flags.owndata else out.copy()
    out.setflags(write=False)
    return out


def first_of_each(*columns: np.ndarray) -> np.ndarray:
    """Return where a row (N,) of these columns is not a repetition of an earlier one."""
    import polars as pl

    if (one := _one_number(columns)) is not None:
        return pl.Series(one).is_first_distinct().to_numpy()
    frame = pl.DataFrame(
        {str(i): c.tolist() if c.dtype.kind in "UO" else c for i, c in enumerate(columns)}
    )
    return frame.select(pl.struct(pl.all()).is_first_distinct()).to_series().to_numpy()


def _one_number(columns: tuple[np.ndarray, ...]) -> np.ndarray | None:
    """Columns of whole numbers as one that tells rows apart; None where that is not possible."""
    if any(c.dtype.kind not in "iu" for c in columns) or not len(columns[0]):
        return None
    out, size = np.zeros(len(columns[0]), np.int64), 1
    for c in columns:
        low = c.min()
        c = c - low
        step = max(int(np.gcd.reduce(c)), 1)  # times in whole ms need fewer digits than ns
        c = c // step
        count = int(c.max()) + 1
        size *= count
        if size >= 2**63:
            return None
        out = out * count + c
    return out


def frame(data: Any):
    """Return any dataframe (polars, pandas, a dict of columns) as a polars DataFrame."""
    import polars as pl

    if isinstance(data, pl.LazyFrame):
        return data.collect()
    if isinstance(data, pl.DataFrame):
        return data
    columns = data.keys() if isinstance(data, dict) else getattr(data, "columns", None)
    if columns is None:
        raise InputError(f"a table is expected, got {type(data).__name__}")
    return pl.DataFrame({str(c): _column(data[c]) for c in columns}, strict=False)


def _column(values: Any) -> Any:
    zone = getattr(getattr(values, "dtype", None), "tz", None)
    if zone is not None:  # pandas: times with a zone would come out as objects
        values = values.dt.tz_convert("UTC").dt.tz_localize(None)
    to_numpy = getattr(values, "to_numpy", None)
    out = to_numpy() if to_numpy else values
    return list(out) if getattr(getattr(out, "dtype", None), "kind", "") == "O" else out
