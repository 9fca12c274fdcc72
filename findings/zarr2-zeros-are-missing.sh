#!/usr/bin/env bash
# Counts of zero in a Zarr store of format 2 are read as missing; in format 3 they are zeros.
#
# Guess: what zarr-python writes, xarray reads: [0, 3, 0, 5] detections are [0, 3, 0, 5].
# What happens: zarr-python gives an array the fill value 0, and xarray takes format 2's fill value
# for "missing": [nan, 3, nan, 5], in floating point. The same lines with format 3 give the zeros.
# Versions: xarray 2026.9.0, zarr 3.1.6. Seen on 30 November 2026.
# Who is hurt: "nobody heard" is the evidence of a presence-only or spatial capture model; as
# missing values the silent receivers drop out of the likelihood, and a mean over the array rises.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 zarr==3.1.6
cd "$folder"
venv/bin/python - <<'EOF'
import numpy as np
import xarray as xr
import zarr

counts = np.array([0, 3, 0, 5], "i4")
read = {}
for zarr_format in (2, 3):
    group = zarr.open_group(f"{zarr_format}.zarr", mode="w", zarr_format=zarr_format)
    names = {} if zarr_format == 2 else {"dimension_names": ["receiver"]}
    array = group.create_array("detections", shape=(4,), dtype="i4", **names)
    if zarr_format == 2:
        array.attrs["_ARRAY_DIMENSIONS"] = ["receiver"]
    array[:] = counts
    assert (array[:] == counts).all()
    read[zarr_format] = xr.open_zarr(f"{zarr_format}.zarr", consolidated=False).detections.values
    print(f"format {zarr_format}: {read[zarr_format]}, mean {np.nanmean(read[zarr_format]):g}")
assert np.isnan(read[2][[0, 2]]).all() and (read[2][[1, 3]] == [3, 5]).all()
assert (read[3] == counts).all()
EOF
