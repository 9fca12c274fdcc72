#!/usr/bin/env bash
# Trajan cuts the time between two fixes to whole seconds: speeds are infinite or half too high.
#
# Guess: `traj.speed()` is distance over time for whatever times xarray holds.
# What happens: `time_to_next` is cast to whole seconds, rounding down. 1.5 m in 1.5 s is 1.5 m/s
# instead of 1; fixes .5 s apart have infinite speed. The distances are right. No warning.
# Versions: trajan 0.12.1, xarray 2026.9.0. Seen on 30 November 2026.
# Who is hurt: fine-scale acoustic positioning has a fix every 1 to 3 s, at times with fractions:
# every speed is biased upwards, by a third on average for gaps between 1 and 2 s.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 pyproj==3.7.2 xarray==2026.9.0 trajan==0.12.1
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import numpy as np
import trajan  # noqa: F401
import xarray as xr

warnings.simplefilter("ignore")
seconds = np.array([0.0, 1.5, 2.0, 4.9, 6.9])
metre = 1 / 111_319.490793  # degrees of longitude at the equator
dims = ("trajectory", "obs")
time = np.datetime64("2026-03-01T12:00:00", "ns") + (seconds * 1e9).astype("timedelta64[ns]")
drift = xr.Dataset(
    {
        "lon": (dims, seconds[None] * metre, {"standard_name": "longitude"}),
        "lat": (dims, np.zeros((1, 5)), {"standard_name": "latitude"}),
        "time": (dims, time[None], {"standard_name": "time"}),
    },
    {"trajectory": ("trajectory", ["a"], {"cf_role": "trajectory_id"})},
)
distance = drift.traj.distance_to_next().values[0, :4]
gap = drift.traj.time_to_next().values[0, :4]
speed = drift.traj.speed().values[0, :4]
print("seconds apart:", np.diff(seconds), "as used:", gap, "metres:", distance.round(3))
print("speed of an animal at 1 m/s:", speed.round(3))
assert np.allclose(distance, np.diff(seconds), atol=1e-3)
assert gap.astype("timedelta64[ms]").astype(int).tolist() == [1000, 0, 2000, 2000]
assert np.isinf(speed[1]) and np.allclose(speed[[0, 2, 3]], [1.5, 1.45, 1.0], atol=1e-3)
EOF
