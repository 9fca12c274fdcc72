#!/usr/bin/env bash
# Appending a day to a Zarr store renames the receivers of the days before.
#
# Guess: `to_zarr(append_dim="ping")` aligns the other coordinates by label, as xarray does in
# memory, or refuses a block whose receivers stand in another order.
# What happens: values go in by position, and the store's labels are overwritten by the last
# block's. With receivers 101, 102 on the first day and 102, 101 on the second, what 101 heard
# on the first day is read as 102's. No warning. In memory `xr.concat` puts both days right.
# Versions: xarray 2026.9.0, zarr 3.1.6. Seen on 30 November 2026.
# Who is hurt: whoever keeps a detections-by-receiver array and appends downloads: a detection
# moves to another receiver's place, which no later check of the file can see.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 zarr==3.1.6
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import xarray as xr

first = xr.Dataset({"heard": (("ping", "receiver"), [[5, 0]])}, {"receiver": [101, 102]})
second = xr.Dataset({"heard": (("ping", "receiver"), [[0, 7]])}, {"receiver": [102, 101]})
with warnings.catch_warnings():
    warnings.simplefilter("error")
    first.to_zarr("heard.zarr", consolidated=False)
    second.to_zarr("heard.zarr", append_dim="ping", consolidated=False)
read = xr.open_zarr("heard.zarr", consolidated=False).heard.load()
print("101 heard, by the store:", read.sel(receiver=101).values, "in truth: [5 7]")
print("102 heard, by the store:", read.sel(receiver=102).values, "in truth: [0 0]")
assert read.sel(receiver=101).values.tolist() == [0, 7]
assert read.sel(receiver=102).values.tolist() == [5, 0]
memory = xr.concat([first, second], "ping", join="outer").heard
assert memory.sel(receiver=101).values.tolist() == [5, 7]
EOF
