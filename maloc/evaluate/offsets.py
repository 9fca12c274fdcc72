"""Receivers whose direct arrivals are late, or early, on the whole.

A residual's median is 0 where the receiver stands where it is said to, its clock is right and it
hears the direct path. The median's standard error is that of a normal law, widened by how long
residuals stay on one side of it: the variance of a median is that of the mean of signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import polars as pl

__all__ = ["receiver_offsets"]

LEVEL = 0.01  # of naming any receiver where all are right
_FEWEST = 10  # direct arrivals behind a median
_MAD = 1.4826  # standard deviation of a normal law over its median absolute deviation
_MEDIAN = 1.2533  # standard error of a normal law's median over that of its mean


def receiver_offsets(
    residual: np.ndarray, p_direct: np.ndarray, names: Sequence[str], sound_speed: float = 1.0
) -> pl.DataFrame:
    """Median residual of each receiver's direct arrivals, and whether it is far from 0.

    Parameters
    ----------
    residual, p_direct : (T, R) array
        Residuals (s) and probabilities that arrivals are direct, NaN where not heard: those of a
        `maloc.infer.Fit`.
    names : sequence of R str
        Receivers' names.
    sound_speed : float
        m/s; makes the medians metres.

    Returns
    -------
    polars.DataFrame
        The farthest for its number first: ``receiver``, ``n`` direct arrivals (``p_direct`` over
        .5), ``median`` and its standard error ``se`` (s, or m with a sound speed), ``z``, their
        quotient, and ``far``: beyond what chance does in one array of a hundred. Null where fewer
        than ten arrivals are direct.
    """
    import polars as pl
    from scipy.stats import norm

    limit = float(norm.isf(LEVEL / 2 / max(len(names), 1)))
    rows = []
    for j, name in enumerate(names):
        direct = np.isfinite(residual[:, j]) & (np.nan_to_num(p_direct[:, j]) > 0.5)
        late = residual[direct, j] * sound_speed
        row = {"receiver": str(name), "n": len(late), "median": None, "se": None, "z": None}
        if len(late) >= _FEWEST:
            median, se = _median(late)
            row |= {"median": median, "se": se, "z": median / se if se > 0 else None}
        rows.append(row | {"far": row["z"] is not None and abs(row["z"]) > limit})
    kinds = {c: pl.Float64 for c in ("median", "se", "z")}
    table = pl.DataFrame(rows, schema_overrides=kinds)
    return table.sort(pl.col("z").abs(), descending=True, nulls_last=True, maintain_order=True)


def _median(late: np.ndarray) -> tuple[float, float]:
    """Median of residuals (n,) in order of time, and its standard error."""
    median = float(np.median(late))
    spread = _MAD * float(np.median(np.abs(late - median)))
    return median, _MEDIAN * spread * float(np.sqrt(_together(late - median) / len(late)))


def _together(off: np.ndarray) -> float:
    """How many successive residuals count as one: 1 + 2 sum of their signs' autocorrelations.

    Summed over pairs of lags for as long as the pairs are positive (Geyer 1992, initial positive
    sequence).
    """
    sign = np.sign(off)
    n = len(sign)
    size = 1 << (2 * n - 1).bit_length()
    power = np.abs(np.fft.rfft(sign, size)) ** 2
    rho = np.fft.irfft(power, size)[:n] / max(float(sign @ sign), 1.0)
    pairs = rho[: n // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(pairs <= 0)
    kept = pairs[: stop[0]] if len(stop) else pairs
    return float(np.clip(2 * kept.sum() - 1, 1.0, n))
