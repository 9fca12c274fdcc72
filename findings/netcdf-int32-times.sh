#!/usr/bin/env bash
# Times with fractions, added to a file that counts seconds in 32 bits, are written as 1969.
#
# Guess: a file whose times are `int seconds since 1970-01-01` can be read, extended by detections
# with milliseconds and written again; xarray widens the type or refuses.
# What happens: the variable keeps the file's encoding. xarray warns that it takes milliseconds
# instead of seconds, but keeps 32 bits, which hold milliseconds for 25 days: the counts wrap and
# every time, the old ones too, is read back weeks around 1970.
# Versions: xarray 2026.9.0, netCDF4 1.7.4. Seen on 30 November 2026.
# Who is hurt: loggers and older archives count whole seconds in 32 bits; joining them with a
# receiver that writes fractions gives a file without one right time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 netCDF4==1.7.4
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import netCDF4
import numpy as np
import xarray as xr

seconds = np.array([1_772_366_400, 1_772_366_410], "i4")
with netCDF4.Dataset("logger.nc", "w", format="NETCDF4_CLASSIC") as file:
    file.createDimension("ping", 2)
    time = file.createVariable("ping", "i4", ("ping",))
    time.units, time.calendar = "seconds since 1970-01-01", "standard"
    time[:] = seconds

old = xr.load_dataset("logger.nc")
assert (old.ping.values == seconds.astype("datetime64[s]")).all()
new = xr.Dataset(coords={"ping": np.array(["2026-03-01T12:00:20.250"], "datetime64[ns]")})
both = xr.concat([old, new], "ping")
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    both.to_netcdf("both.nc", engine="netcdf4")
read = xr.load_dataset("both.nc", engine="netcdf4")
print("written:", both.ping.values)
print("read:   ", read.ping.values, read.ping.encoding["dtype"], read.ping.encoding["units"])
assert read.ping.encoding["dtype"] == np.int32
assert read.ping.encoding["units"].startswith("milliseconds since 1970-01-01")
milliseconds = both.ping.values.astype("datetime64[ms]").astype("i8").astype("i4")
assert (read.ping.values == milliseconds.astype("datetime64[ms]")).all()
assert (np.abs(read.ping.values.astype("datetime64[D]").astype(int)) < 26).all()
assert any("Serializing with units 'milliseconds" in str(w.message) for w in said)
EOF
