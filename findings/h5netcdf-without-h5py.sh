#!/usr/bin/env bash
# h5netcdf 1.8 installs nothing that can write a file.
#
# Guess: `pip install xarray h5netcdf` is enough for `to_netcdf(engine="h5netcdf")`, as it was.
# What happens: since 1.8 the HDF5 library is a choice of the user and h5py no longer comes along.
# The package imports and xarray lists the engine "h5netcdf" as there; writing ends in an
# ImportError that asks for h5py. With h5py installed beside it the same lines work.
# Versions: h5netcdf 1.8.2, xarray 2026.9.0, h5py 3.16.0. Seen on 30 November 2026.
# Who is hurt: ArviZ and others write NetCDF by this engine; the error comes at the end of a long
# fit, when the posterior is saved.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 h5netcdf==1.8.2
cd "$folder"
venv/bin/python - <<'EOF'
import importlib.util
import subprocess
import sys

import h5netcdf
import xarray as xr

draws = xr.Dataset({"x": (("chain", "draw"), [[1.0, 2.0]])})
assert importlib.util.find_spec("h5py") is None
assert "h5netcdf" in xr.backends.list_engines()
print(f"h5netcdf {h5netcdf.__version__}: engine listed, h5py not installed")
try:
    draws.to_netcdf("posterior.nc", engine="h5netcdf")
except ImportError as error:
    print(f"{type(error).__name__}: {error}")
else:
    raise AssertionError("it writes without h5py now")
subprocess.run([sys.executable, "-m", "pip", "install", "--quiet",
                "--disable-pip-version-check", "h5py==3.16.0"], check=True)
again = "import xarray as xr; xr.Dataset({'x': 1.0}).to_netcdf('posterior.nc', engine='h5netcdf')"
subprocess.run([sys.executable, "-c", again], check=True)
print("with h5py 3.16.0: written")
EOF
