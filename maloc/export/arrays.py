"""Exports that are arrays: NetCDF and Zarr, whole tracks included."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maloc.errors import needs
from maloc.export.finished import Finished, dated

__all__ = ["netcdf", "zarr"]

_UNITS = {"x": "m", "y": "m", "sd_x": "m", "sd_y": "m", "cov_xy": "m2", "t": "s"}
_UNITS |= {"x_lo": "m", "x_hi": "m", "y_lo": "m", "y_hi": "m", "vx": "m/s", "vy": "m/s"}
_UNITS |= {"sd_vx": "m/s", "sd_vy": "m/s", "longitude": "degrees_east", "latitude": "degrees_north"}


def _dataset(run: Finished):
    """The table as variables along ``obs``; whole tracks as ``draw_x`` (draw, obs), ..."""
    import xarray as xr

    table, variables = run.table, {}
    for name in table.columns:
        column = table[name]
        if name == "time":
            if column.null_count():
                continue
            values = dated(table, "netcdf").dt.replace_time_zone(None).to_numpy()
            variables[name] = ("obs", values.astype("datetime64[ns]"))
        elif name == "tag":
            tags = column.fill_null("").to_list()
            names = list(dict.fromkeys(tags))
            meaning = " ".join(n.replace(" ", "_") for n in names)
            known = {"flag_values": np.arange(len(names)), "flag_meanings": meaning}
            variables[name] = ("obs", np.array([names.index(t) for t in tags]), known)
        else:
            values = column.to_numpy()
            unit = {"units": _UNITS[name]} if name in _UNITS else {}
            variables[name] = ("obs", values, unit)
    if run.draws is not None:
        parts = run.draws.partition_by("tag", maintain_order=True)
        n = run.draws["draw"].n_unique()
        for name in ("x", "y", "vx", "vy"):
            if name in run.draws.columns:
                whole = np.concatenate([p[name].to_numpy().reshape(n, -1) for p in parts], axis=1)
                variables[f"draw_{name}"] = (("draw", "obs"), whole, {"units": _UNITS[name]})
    attrs = {"Conventions": "CF-1.11", "featureType": "trajectory", "source": "maloc"}
    return xr.Dataset(variables, attrs=attrs | ({"crs": run.crs} if run.crs else {}))


def netcdf(run: Finished, path: Path) -> None:
    """Write arrays as NetCDF."""
    _dataset(run).to_netcdf(path, engine="h5netcdf")


def zarr(run: Finished, path: Path) -> None:
    """Write the same in Zarr."""
    try:
        import zarr  # noqa: F401
    except ImportError as problem:
        raise needs("export to zarr", "Zarr", "geo", problem) from None
    _dataset(run).to_zarr(path, mode="w", consolidated=False)
