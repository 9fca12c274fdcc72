"""ClockSync to files and back."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data import Note, Receivers
from maloc.errors import InputError
from maloc.sync._records import ClockJumps, SyncResiduals

if TYPE_CHECKING:
    from maloc.sync._clocks import Clocks

__all__ = ["from_netcdf", "to_netcdf"]

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


def to_netcdf(sync: Clocks, path: str | Path) -> None:
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


def from_netcdf(path: str | Path) -> dict[str, Any]:
    """Read what `to_netcdf` wrote: the fields of a `ClockSync`.

    Raises
    ------
    InputError
        If there is no such file or it is something else.
    """
    import xarray as xr

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
    return fields | {
        "receivers": Receivers(
            *(any_(f"deployment_{name}") for name in _RECEIVERS), crs=str(d.attrs["crs"]) or None
        ),
        "origin": int(d.attrs["origin"]),
        "jumps": ClockJumps(
            **{f.name: any_(f"jump_{f.name}") for f in dataclasses.fields(ClockJumps)}
        ),
        "residuals": SyncResiduals(
            **{f.name: any_(f"residual_{f.name}") for f in dataclasses.fields(SyncResiduals)}
        ),
        "notes": tuple(
            Note(str(a), str(b), int(c)) for a, b, c in zip(levels, texts, counts, strict=True)
        ),
        "reference": str(d.attrs["reference"]),
    }
