"""ClockSync to files and back."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

    from maloc.sync.clocks import ClockSync

__all__ = ["from_netcdf", "to_netcdf", "write"]

FORMAT = "maloc clock synchronisation 2"
_RECEIVERS = ("receiver", "x", "y", "depth", "sync_tag", "start", "end")
_ARRAYS = {
    "knots": ("knot",),
    "values": ("clock", "knot"),
    "slopes": ("clock", "knot"),
    "values_sd": ("clock", "knot"),
    "noise": ("clock",),
    "covariance": ("interval", "row", "column"),
    "speeds": ("knot",),
    "speeds_sd": ("knot",),
    "span": ("clock", "bound"),
    "delay": ("deployment",),
    "delay_sd": ("deployment",),
    "position_sd": ("deployment", "axis"),
    "shift": ("deployment", "axis"),
    "value_draws": ("draw", "clock", "knot"),
    "slope_draws": ("draw", "clock", "knot"),
    "jump_draws": ("draw", "jump"),
}
_SCALARS = ("reference", "sigma", "reflected")
_UNITS = {
    "knots": "s",
    "values": "s",
    "slopes": "s/s",
    "values_sd": "s",
    "span": "s",
    "noise": "s^2/s^3",
    "covariance": "s^2",
    "speeds": "m/s",
    "speeds_sd": "m/s",
    "delay": "s",
    "delay_sd": "s",
    "value_draws": "s",
    "slope_draws": "s/s",
    "jump_draws": "s",
    "jump_time": "s",
    "jump_low": "s",
    "jump_high": "s",
    "jump_size": "s",
    "jump_size_sd": "s",
    "residual_offset": "s",
    "position_sd": "m",
    "shift": "m",
    "residual_residual": "s",
    "residual_distance": "m",
}


def to_netcdf(sync: ClockSync, path: str | Path) -> None:
    """Write `sync` to one NetCDF file."""
    import xarray as xr

    def plain(a: np.ndarray) -> np.ndarray:
        return a.astype(object) if a.dtype.kind == "U" else a

    data: dict[str, Any] = {name: (d, getattr(sync, name)) for name, d in _ARRAYS.items()}
    for field in dataclasses.fields(sync.jumps):
        data[f"jump_{field.name}"] = ("jump", plain(getattr(sync.jumps, field.name)))
    for name in _RECEIVERS:
        data[f"deployment_{name}"] = ("deployment", plain(getattr(sync.receivers, name)))
    for field in dataclasses.fields(sync.residuals):
        data[f"residual_{field.name}"] = (
            "arrival",
            plain(np.asarray(getattr(sync.residuals, field.name))),
        )
    data["note_level"] = ("note", np.array([n.level for n in sync.notes], object))
    data["note_text"] = ("note", np.array([n.text for n in sync.notes], object))
    data["note_count"] = ("note", np.array([n.count for n in sync.notes], np.int64))
    attributes = {name: getattr(sync, name) for name in _SCALARS}
    attributes |= {"format": FORMAT, "crs": sync.receivers.crs or ""}
    # int64 nanoseconds as text: attributes may come back as float64
    dataset = xr.Dataset(data, attrs=attributes | {"origin": str(sync.origin)})
    for name, unit in _UNITS.items():
        dataset[name].attrs["unit"] = unit
    dataset.to_netcdf(path, engine="h5netcdf")


def from_netcdf(path: str | Path) -> ClockSync:
    """Read what `to_netcdf` wrote.

    Raises
    ------
    InputError
        If there is no such file or it is something else.
    """
    import xarray as xr

    from maloc.sync.clocks import ClockJumps, ClockSync, SyncResiduals

    if not Path(path).is_file():
        raise InputError("no such file", file=path)
    try:
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as file:
            d = file.load()
    except (OSError, ValueError, KeyError) as error:
        raise InputError("not a NetCDF file", file=path) from error
    if d.attrs.get("format") != FORMAT:
        raise InputError("not a synchronisation of maloc's", file=path, mend="run maloc sync")

    def text(name: str) -> np.ndarray:
        return d[name].values.astype(str) if d[name].size else np.empty(0, "U1")

    def any_(name: str) -> np.ndarray:
        return text(name) if d[name].dtype.kind in "OSU" else d[name].values

    fields: dict[str, Any] = {name: d[name].values for name in _ARRAYS}
    fields |= {name: float(d.attrs[name]) for name in _SCALARS if name != "reference"}
    levels, texts, counts = text("note_level"), text("note_text"), d["note_count"].values
    return ClockSync(
        receivers=Receivers(
            *(any_(f"deployment_{name}") for name in _RECEIVERS), crs=str(d.attrs["crs"]) or None
        ),
        origin=int(d.attrs["origin"]),
        jumps=ClockJumps(
            **{f.name: any_(f"jump_{f.name}") for f in dataclasses.fields(ClockJumps)}
        ),
        residuals=SyncResiduals(
            **{f.name: any_(f"residual_{f.name}") for f in dataclasses.fields(SyncResiduals)}
        ),
        notes=tuple(
            Note(str(a), str(b), int(c)) for a, b, c in zip(levels, texts, counts, strict=True)
        ),
        reference=str(d.attrs["reference"]),
        **fields,
    )


def receivers_frame(sync: ClockSync) -> pl.DataFrame:
    """Return the fitted receivers' table with shifts from the given one and standard errors."""
    import polars as pl

    extra = {
        "shift_x": sync.shift[:, 0],
        "shift_y": sync.shift[:, 1],
        "sd_x": sync.position_sd[:, 0],
        "sd_y": sync.position_sd[:, 1],
    }
    return sync.receivers.to_frame().with_columns(pl.Series(k, v) for k, v in extra.items())


def write(sync: ClockSync, folder: str | Path, detections: Detections | None) -> list[Path]:
    """Write the files of `maloc sync`; returns their paths."""
    import polars.selectors as cs
    from matplotlib.figure import Figure

    from maloc.plots import _sync as figures
    from maloc.plots._sync_links import sync_matrix
    from maloc.sync.connect import connectivity

    folder = Path(folder)
    to_netcdf(sync, folder / "sync.nc")
    paths = [folder / "sync.nc"]
    for name, table in (
        ("receivers_fitted.csv", receivers_frame(sync)),
        ("residuals.csv", sync.residuals_frame()),
        ("links.csv", sync.links_frame()),
        ("jumps.csv", sync.jumps_frame()),
    ):
        iso = cs.datetime().dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        table.with_columns(iso).write_csv(folder / name, float_precision=6)
        paths.append(folder / name)
    if detections is not None:
        paths.append(folder / "detections_synced.parquet")
        sync.apply(detections).to_frame().write_parquet(paths[-1])
    drawn: list[tuple[str, Any]] = [
        ("residuals.png", figures.sync_residuals),
        ("clocks.png", figures.clocks),
    ]
    if detections is not None:
        found = connectivity(detections, sync.receivers)
        drawn.append(("connectivity.png", lambda _, ax: sync_matrix(found, ax=ax)))
    for name, draw in drawn:
        figure = Figure(figsize=(9.0, 4.5))  # no pyplot: nothing global, no window
        draw(sync, figure.subplots())
        paths.append(folder / name)
        figure.savefig(paths[-1], dpi=150, bbox_inches="tight")
    return paths
