#!/usr/bin/env bash
# Detections of a second day appended to a Zarr store come back in another year.
#
# Guess: xarray's `to_zarr(append_dim=...)` writes times in the store's own unit, or refuses.
# What happens: where the first day's times are whole seconds the store counts seconds. Appending
# times with milliseconds, xarray warns that it serializes in milliseconds "instead", writes those
# counts and leaves the store's unit at seconds: 12:00:00.250 of 2 March 2026 is read as a day in
# November 2028, in the formats 2 and 3 of Zarr alike.
# Versions: xarray 2026.9.0, zarr 3.1.6. Seen on 30 November 2026.
# Who is hurt: whoever stores receivers' detections day by day; arrival times have fractions, and a
# first block that happens to have none sets the trap.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 zarr==3.1.6
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import numpy as np
import xarray as xr


def day(*times):
    ping = np.array(times, "datetime64[ns]")
    return xr.Dataset({"receiver": ("ping", [1, 2])}, {"ping": ping})


first = day("2026-03-01T12:00:00", "2026-03-01T12:00:10")
second = day("2026-03-02T12:00:00.250", "2026-03-02T12:00:10.250")
for zarr_format in (2, 3):
    store = f"{zarr_format}.zarr"
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        first.to_zarr(store, zarr_format=zarr_format, consolidated=False)
        second.to_zarr(store, append_dim="ping", consolidated=False)
    about_units = [str(w.message) for w in said if "units 'milliseconds since" in str(w.message)]
    read = xr.open_zarr(
        store, consolidated=False, decode_times=xr.coders.CFDatetimeCoder(time_unit="s")
    )
    times = read.ping.values
    print(f"Zarr format {zarr_format}: unit {read.ping.encoding['units']!r}, read back {times}")
    assert read.ping.encoding["units"] == "seconds since 2026-03-01 12:00:00"
    assert (times[:2] == first.ping.values).all()
    right = second.ping.values - first.ping.values[0]
    wrong = times[2:] - first.ping.values[0].astype("datetime64[s]")
    assert (wrong / np.timedelta64(1, "s") == right / np.timedelta64(1, "ms")).all(), wrong
    assert len(about_units) == 1, said
EOF
