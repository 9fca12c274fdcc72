"""Exports that are tables: CSV, Parquet, Movebank, and what R's movement packages read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._limits import CHI95
from maloc.errors import InputError
from maloc.export.finished import Finished, dated, degrees, ellipse_axes, typed

if TYPE_CHECKING:
    import polars as pl

__all__ = ["crawl", "csv", "imputations", "movebank", "parquet"]


def csv(run: Finished, path: Path) -> None:
    """Write the table as it is."""
    run.table.write_csv(path)


def parquet(run: Finished, path: Path) -> None:
    """Write the table with types."""
    typed(run.table).write_parquet(path)


def movebank(run: Finished, path: Path) -> None:
    """Movebank's import: its attribute names; the error is the 95 % ellipse's longer half-axis."""
    import polars as pl

    table = run.table
    lon, lat = degrees(table, "movebank")
    major, _, _ = ellipse_axes(table)
    tag = table["tag"].fill_null("")
    columns = {
        "timestamp": dated(table, "movebank").dt.strftime("%Y-%m-%d %H:%M:%S%.3f"),
        "location-long": np.round(lon, 8),
        "location-lat": np.round(lat, 8),
        "location-error-numerical": np.round(np.sqrt(CHI95) * major, 3),
        "location-error-percentile": np.full(len(table), 95),
        "sensor-type": ["acoustic-telemetry"] * len(table),
        "tag-local-identifier": tag,
        "individual-local-identifier": tag,
    }
    pl.DataFrame(columns).write_csv(path)


def crawl(run: Finished, path: Path) -> None:
    """Columns for crawl and momentuHMM (ln.sd.x, ...) and for aniMotum (smaj, smin, eor, x.sd)."""
    import polars as pl

    table = run.table
    major, minor, bearing = ellipse_axes(table)
    tag, time = table["tag"].fill_null("track"), dated(table, "crawl")
    sd_x, sd_y = table["sd_x"].to_numpy(), table["sd_y"].to_numpy()
    columns: dict[str, Any] = {"id": tag, "ID": tag}
    columns["date"] = columns["time"] = time.dt.strftime("%Y-%m-%d %H:%M:%S%.3f")
    columns["lc"] = ["GL"] * len(table)
    if "longitude" in table.columns:
        columns |= {"lon": table["longitude"], "lat": table["latitude"]}
    columns |= {
        "x": table["x"],
        "y": table["y"],
        "x.sd": sd_x,
        "y.sd": sd_y,
        "ln.sd.x": np.log(sd_x),
        "ln.sd.y": np.log(sd_y),
        "error.corr": table["cov_xy"].to_numpy() / (sd_x * sd_y),
        # Argos half-axes are sqrt(2) standard deviations (McClintock et al. 2015)
        "smaj": np.sqrt(2) * major,
        "smin": np.sqrt(2) * minor,
        "eor": bearing,
    }
    pl.DataFrame(columns).write_csv(path, float_precision=8)


def imputations(run: Finished, path: Path) -> None:
    """Whole tracks, one after the other: what momentuHMM's MIfitHMM takes once split by draw."""
    import polars as pl

    draws = _whole(run, "imputations")
    time = pl.col("time").dt.strftime("%Y-%m-%d %H:%M:%S%.3f")
    draws.select("draw", ID="tag", time=time, t="t", x="x", y="y").write_csv(
        path, float_precision=6
    )


def _whole(run: Finished, to: str) -> pl.DataFrame:
    if run.draws is None:
        raise InputError(
            f"{to} needs whole tracks, and the folder has none",
            mend="export the folder of maloc predict --draws N",
        )
    return run.draws
