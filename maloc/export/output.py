"""The files of a finished run, as tables and as text: every number with sensible digits."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._mirror import Line, reflect
from maloc.data._time import NS

if TYPE_CHECKING:
    import polars as pl

    from maloc.data.arrivals import ArrivalTimes
    from maloc.data.receivers import Receivers
    from maloc.sync import ClockSync

__all__ = [
    "ARRIVALS",
    "PARAMETERS",
    "TRACK",
    "arrivals_table",
    "counts",
    "finish_track",
    "parameters_table",
    "sync_record",
    "versions",
    "write_json",
    "write_table",
]

TRACK = (
    "tag",
    "time",
    "t",
    "x",
    "y",
    "sd_x",
    "sd_y",
    "cov_xy",
    "x_lo",
    "x_hi",
    "y_lo",
    "y_hi",
    "n_receivers",
    "heard",
    "ping",
)
ARRIVALS = ("ping", "receiver", "residual", "p_direct", "used", "why", "tag", "t", "detection")
PARAMETERS = (
    "name",
    "mean",
    "sd",
    "2.5 %",
    "97.5 %",
    "ess_bulk",
    "ess_tail",
    "r_hat",
    "unit",
    "tag",
)
LATE = "late: p_direct below 0.5"

# decimals: times to the microsecond, metres to the millimetre, degrees to about a millimetre
DECIMALS = {
    "t": 6,
    "x": 3,
    "y": 3,
    "sd_x": 4,
    "sd_y": 4,
    "cov_xy": 6,
    "x_lo": 3,
    "x_hi": 3,
    "y_lo": 3,
    "y_hi": 3,
    "z": 3,
    "sd_z": 4,
    "z_lo": 3,
    "z_hi": 3,
    "vx": 6,
    "vy": 6,
    "sd_vx": 6,
    "sd_vy": 6,
    "mirror_x": 3,
    "mirror_y": 3,
    "longitude": 8,
    "latitude": 8,
    "residual": 7,
    "p_direct": 6,
}


def finish_track(table: pl.DataFrame, receivers: Receivers, line: Line | None) -> pl.DataFrame:
    """Bring a track table into track.csv's order, and add what only the array knows.

    Parameters
    ----------
    table : DataFrame
        With the columns `TRACK`.
    receivers : Receivers
        Give longitude and latitude where their frame is known.
    line : Line, optional
        The line on which the receivers stand; the mirror images of the positions are added.

    Returns
    -------
    DataFrame
        `TRACK`, then longitude and latitude, then mirror_x and mirror_y, then other columns.
    """
    import polars as pl

    xy = table.select("x", "y").to_numpy().astype(float)
    extra: dict[str, np.ndarray] = {}
    if receivers.crs is not None and "longitude" not in table.columns:
        extra["longitude"], extra["latitude"] = receivers.lonlat(xy[:, 0], xy[:, 1])
    if line is not None:
        extra["mirror_x"], extra["mirror_y"] = reflect(xy, line).T
    table = table.with_columns(**{k: pl.Series(k, v) for k, v in extra.items()})
    known = [*TRACK, "longitude", "latitude", "mirror_x", "mirror_y"]
    rest = [c for c in table.columns if c not in known]
    return table.select(*(c for c in known if c in table.columns), *rest)


def arrivals_table(fit: Any, toa: ArrivalTimes) -> pl.DataFrame:
    """Return one row a detection, used ones by ping and column, then those set aside.

    Parameters
    ----------
    fit : Fit
        Gives residuals and p_direct, (T, R), of the T heard pings.
    toa : ArrivalTimes
        What was fitted.

    Returns
    -------
    DataFrame
        Columns `ARRIVALS`; ping and residual are null where a detection is in no ping.
    """
    import polars as pl

    row, column = np.nonzero(toa.heard)
    place = np.cumsum(toa.n_heard > 0) - 1  # row of the fit's arrays, heard pings only
    residual = np.asarray(fit.residuals(), float)[place[row], column]
    direct = np.asarray(fit.p_direct(), float)[place[row], column]
    aside = toa.set_aside
    nothing = [None] * len(aside)
    names = np.asarray(toa.receivers.labels, dtype=str)
    start = 0.0 if toa.origin is None else toa.origin / NS  # t as in track.csv
    known = toa.detection
    detection = [None] * len(row) if known is None else known[row, column].tolist()
    columns: dict[str, list] = {
        "ping": toa.ping[row].tolist() + nothing,
        "receiver": names[column].tolist() + aside.receiver.tolist(),
        "residual": residual.tolist() + nothing,
        "p_direct": direct.tolist() + nothing,
        "used": [True] * len(row) + [False] * len(aside),
        "why": [LATE if p < 0.5 else "" for p in direct.tolist()] + aside.why.tolist(),
        "tag": [toa.tag] * (len(row) + len(aside)),
        "t": (start + np.concatenate([toa.toa[row, column], aside.time])).tolist(),
        "detection": [None if d == -1 else d for d in detection] + aside.detection.tolist(),
    }
    types = {
        "ping": pl.Int64,
        "residual": pl.Float64,
        "p_direct": pl.Float64,
        "used": pl.Boolean,
        "t": pl.Float64,
        "detection": pl.Int64,
    }
    return pl.DataFrame([pl.Series(k, columns[k], types.get(k, pl.String)) for k in ARRIVALS])


def parameters_table(fit: Any, tag: str) -> pl.DataFrame:
    """Return one row a parameter, columns `PARAMETERS`; six significant digits."""
    import polars as pl

    rename = {"2.5 %": "q2.5", "97.5 %": "q97.5"}
    text = ("name", "unit")
    rows = fit.parameters()
    columns = []
    for name in PARAMETERS[:-1]:
        values = [row.get(rename.get(name, name)) for row in rows]
        if name not in text:
            values = [None if v is None else significant(v) for v in values]
        columns.append(pl.Series(name, values, pl.String if name in text else pl.Float64))
    return pl.DataFrame([*columns, pl.Series("tag", [tag] * len(rows), pl.String)])


def sync_record(sync: ClockSync) -> dict[str, Any]:
    """Return what summary.json says of a synchronisation."""
    names = list(zip(sync.receivers.names, sync.synced.tolist(), strict=True))
    used = sync.residuals.used
    return {
        "reference": sync.reference,
        "synchronised": [name for name, done in names if done],
        "not_synchronised": [name for name, done in names if not done],
        "sound_speed": sync.sound_speed,
        "sound_speed_sd": sync.sound_speed_sd,
        "arrivals_used": int(used.sum()),
        "arrivals_set_aside": counts(sync.residuals.why[~used]),
        "residual_sd": sync.residual_sd,
        "residual_mad": sync.residual_mad,
    }


def counts(values: Sequence[str] | np.ndarray) -> dict[str, int]:
    """Count equal texts, the most frequent first."""
    names, number = np.unique(np.asarray(values, dtype=str), return_counts=True)
    order = np.argsort(-number, kind="stable")
    return {str(names[i]): int(number[i]) for i in order}


def significant(value: float, digits: int = 6) -> float:
    """Round to significant digits; NaN and infinities stay."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else float(value)


def write_table(table: pl.DataFrame, path: Path) -> None:
    """Write a CSV: rounded as `DECIMALS` says, times as ISO UTC, missing values empty."""
    import polars as pl
    import polars.selectors as cs

    table = table.with_columns(cs.float().fill_nan(None), cs.string().replace("", None))
    table = table.with_columns(
        *(pl.col(c).round(d) for c, d in DECIMALS.items() if c in table.columns),
        cs.datetime().dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ"),
    )
    table.write_csv(path)


def write_json(content: Mapping[str, Any], path: Path) -> None:
    """Write readable JSON; NaN and infinities become null, arrays become lists."""
    path.write_text(json.dumps(_plain(content), indent=2, ensure_ascii=False) + "\n", "utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return significant(float(value), 10) if math.isfinite(value) else None
    return value if value is None else str(value)


def versions() -> dict[str, str]:
    """Versions of Python, maloc and what the numbers depend on."""
    from importlib.metadata import PackageNotFoundError, version

    out = {"python": platform.python_version()}
    for name in ("maloc", "numpy", "scipy", "jax", "numpyro", "polars", "xarray"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "unknown"
    return out
