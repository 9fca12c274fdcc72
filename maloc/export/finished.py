"""A finished run as exports see it, and what several of them ask of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Finished", "dated", "degrees", "ellipse_axes", "read_finished", "typed"]

_TABLES = ("predicted", "track", "points")


class Finished(NamedTuple):
    """A finished run: its table, the frame of x and y, whole tracks drawn (or None).

    ``left_out`` counts the pings that have no position.
    """

    table: pl.DataFrame
    crs: str | None
    draws: pl.DataFrame | None
    left_out: int = 0


def read_finished(folder: str | Path) -> Finished:
    """Read the table of a `maloc track`, a `maloc predict` or a `maloc points`.

    Raises
    ------
    InputError
        If the folder holds none, or no position.
    """
    import polars as pl

    folder = Path(folder)
    table = next((f for n in _TABLES if (f := folder / f"{n}.csv").is_file()), None)
    if table is None:
        raise InputError(
            f"holds none of {', '.join(f'{n}.csv' for n in _TABLES)}",
            file=folder,
            mend="give a folder that maloc track, predict or points wrote",
        )
    draws = folder / "draws.parquet"
    read = pl.read_csv(
        table, schema_overrides={"tag": pl.String, "time": pl.String}, infer_schema_length=None
    )
    found = pl.read_parquet(draws) if draws.is_file() else None
    located = read.drop_nulls(["t", "x", "y", "sd_x", "sd_y", "cov_xy"])
    if not len(located):
        raise InputError("holds no position", file=table)
    return Finished(located, _frame(folder), found, len(read) - len(located))


def _frame(folder: Path) -> str | None:
    summary = folder / "summary.json"
    said = json.loads(summary.read_text("utf-8")) if summary.is_file() else {}
    if "crs" in said:
        return said["crs"]
    for file in sorted(folder.glob("posterior*.nc")):
        import xarray as xr

        with xr.open_dataset(file, engine="h5netcdf") as root:
            return root.attrs.get("crs")
    return None


def ellipse_axes(table: pl.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error ellipses of a table's positions.

    Returns
    -------
    major, minor : (n,) arrays
        Standard deviations along the axes, m.
    bearing : (n,) array
        Of the major axis, degrees clockwise from the y axis (grid north), in [0, 180).
    """
    sd_x, sd_y, cov = (table[c].to_numpy() for c in ("sd_x", "sd_y", "cov_xy"))
    block = np.array([[sd_x**2, cov], [cov, sd_y**2]]).transpose(2, 0, 1)
    values, vectors = np.linalg.eigh(block)
    minor, major = np.sqrt(np.maximum(values, 0.0)).T
    east, north = vectors[:, 0, 1], vectors[:, 1, 1]
    return major, minor, np.degrees(np.arctan2(east, north)) % 180.0


def degrees(table: pl.DataFrame, to: str) -> tuple[np.ndarray, np.ndarray]:
    """Longitude and latitude; refused where the frame is a local one."""
    if "longitude" not in table.columns:
        raise InputError(
            f"{to} needs longitude and latitude, and the run's frame is a local one",
            mend="run maloc track with --crs, or with receivers in longitude and latitude",
        )
    return table["longitude"].to_numpy(), table["latitude"].to_numpy()


def dated(table: pl.DataFrame, to: str) -> pl.Series:
    """Times as UTC datetimes; refused where there are none."""
    if table["time"].null_count():
        raise InputError(f"{to} needs dates, and the run's times are seconds without one")
    return table["time"].str.to_datetime("%Y-%m-%dT%H:%M:%S%.fZ", time_unit="us", time_zone="UTC")


def typed(table: pl.DataFrame) -> pl.DataFrame:
    """The table with its time as UTC datetimes."""
    import polars as pl

    when = pl.col("time").str.to_datetime(
        "%Y-%m-%dT%H:%M:%S%.fZ", time_unit="us", time_zone="UTC", strict=False
    )
    return table.with_columns(when)
