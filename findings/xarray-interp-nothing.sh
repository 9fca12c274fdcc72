#!/usr/bin/env bash
# A track from a table, interpolated at the times of a NetCDF file, is all NaN.
#
# Guess: xarray compares times as times, whatever unit they are held in; `sel` and `reindex` do.
# What happens: a table's times are in microseconds since pandas 3, a NetCDF file's are decoded to
# nanoseconds. `interp` takes the bare integers of both: every time asked for lies a thousandfold
# beyond the track, so the answer is NaN throughout, and with `fill_value="extrapolate"` finite
# positions 1000 times too far out. No warning. The other way round, nanoseconds interpolated at
# microseconds, is right.
# Versions: xarray 2026.9.0, pandas 3.1.1. Seen on 30 November 2026.
# Who is hurt: tide, temperature or sound speed stand in NetCDF and tracks in tables; NaN at every
# time reads as "the animal was not there", and extrapolated ones look like positions.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 xarray==2026.9.0 h5netcdf==1.8.2 \
    h5py==3.16.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

rows = "".join(f"2026-03-01 12:0{i}:00,{60.0 * i}\n" for i in range(4))
Path("track.csv").write_text("time,x\n" + rows)
table = pd.read_csv("track.csv", parse_dates=["time"]).set_index("time")
x = table["x"].to_xarray()
asked = pd.date_range("2026-03-01T12:00:30", periods=3, freq="60s")
xr.Dataset({"tide": ("time", [0.1, 0.2, 0.3])}, {"time": asked}).to_netcdf("tide.nc")
tide = xr.load_dataset("tide.nc")
assert (x.time.dtype, tide.time.dtype) == (np.dtype("M8[us]"), np.dtype("M8[ns]"))

with warnings.catch_warnings():
    warnings.simplefilter("error")
    plain = x.interp(time=tide.time).values
    beyond = x.interp(time=tide.time, kwargs={"fill_value": "extrapolate"}).values
    same_unit = x.interp(time=tide.time.astype("M8[us]")).values
    turned = x.assign_coords(time=x.time.astype("M8[ns]")).interp(time=asked.as_unit("us")).values
    nearest = x.reindex(time=tide.time, method="nearest").values
print("microseconds at nanoseconds:", plain, "extrapolated:", beyond)
print("in one unit:", same_unit, "nanoseconds at microseconds:", turned, "reindex:", nearest)
assert np.isnan(plain).all()
assert np.allclose(beyond, [30_000.0, 90_000.0, 150_000.0])
assert np.allclose(same_unit, [30.0, 90.0, 150.0]) and np.allclose(turned, same_unit)
assert np.isfinite(nearest).all()
EOF
