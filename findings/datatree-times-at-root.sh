#!/usr/bin/env bash
# Ping times kept once at the root of a DataTree are lost when ArviZ 0.23 reads the file.
#
# Guess: a coordinate that all groups share can stand at the root, as xarray's DataTree intends
# (groups inherit it, and its NetCDF file is read back so); ArviZ 0.23 reads the same file.
# What happens: it reads group by group without the root: the posterior has a dimension `ping`
# without a coordinate, so pings are numbered from 0. No warning, and the root's attributes do
# arrive. With `write_inherited_coords=True` each group brings its times and all is well.
# Versions: arviz 0.23.4, xarray 2026.9.0, h5netcdf 1.8.2, h5py 3.16.0. Seen on 30 November 2026.
# Who is hurt: whoever writes with ArviZ 1.x's form and shares files with colleagues on 0.2x; track
# and posterior are then joined by row number.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 xarray==2026.9.0 arviz==0.23.4 \
    h5netcdf==1.8.2 h5py==3.16.0
cd "$folder"
venv/bin/python - <<'EOF'
import logging
import warnings

import numpy as np
import xarray as xr

warnings.simplefilter("ignore")  # importing arviz 0.23 says that 1.0 is coming
logging.disable(logging.INFO)
import arviz as az

ping = np.array(["2026-03-01T12:00:00.250", "2026-03-01T12:00:10"], "datetime64[ns]")
x = xr.Dataset({"x": (("chain", "draw", "ping"), np.zeros((2, 5, 2)))})
root = xr.Dataset(coords={"ping": ping}, attrs={"tag": "17"})
tree = xr.DataTree.from_dict({"/": root, "posterior": x})
assert (tree["posterior"]["ping"].values == ping).all()
for options, kept in (({}, False), ({"write_inherited_coords": True}, True)):
    tree.to_netcdf(f"{kept}.nc", engine="h5netcdf", **options)
    again = xr.load_datatree(f"{kept}.nc", engine="h5netcdf")
    assert (again["posterior"]["ping"].values == ping).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = az.from_netcdf(f"{kept}.nc")
    print(f"{options}: ArviZ {az.__version__} reads coordinates {list(read.posterior.coords)}, "
          f"pings {read.posterior['ping'].values}, attributes {read.attrs}")
    assert read.attrs["tag"] == "17"
    assert ("ping" in read.posterior.coords) == kept
EOF
