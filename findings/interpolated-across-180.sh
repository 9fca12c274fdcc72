#!/usr/bin/env bash
# Between two fixes either side of 180 degrees an animal is put off West Africa.
#
# Guess: tools that measure geodesic lengths across 180 degrees (these two do, to the metre) also
# interpolate there.
# What happens: MovingPandas' `get_position_at` and Trajan's `gridtime` interpolate longitude as a
# number: halfway from 179.99 to -179.99 is 0, the Greenwich meridian. No warning.
# Versions: movingpandas 0.23.0, trajan 0.12.1, geopandas 1.2.0, xarray 2026.9.0.
# Seen on 30 November 2026.
# Who is hurt: tracks in the Bering Sea, off Fiji or New Zealand's Chathams: regular resampling,
# the first step of most movement models, throws one point 12 000 km off and two steps with it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 xarray==2026.9.0 \
    geopandas==1.2.0 movingpandas==0.23.0 trajan==0.12.1
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import geopandas as gpd
import movingpandas as mpd
import numpy as np
import pandas as pd
import trajan  # noqa: F401
import xarray as xr
from pyproj import Geod
from shapely.geometry import Point

warnings.simplefilter("ignore")
lon, lat = np.array([179.99, -179.99]), np.array([52.0, 52.0])
times = pd.to_datetime(["2026-03-01T12:00", "2026-03-01T12:20"])
true = Geod(ellps="WGS84").inv(lon[0], lat[0], lon[1], lat[1])[2]

points = gpd.GeoDataFrame(
    {"id": 1}, geometry=[Point(*place) for place in zip(lon, lat)], index=times, crs=4326
)
track = mpd.Trajectory(points, 1)
middle = track.get_position_at(times[0] + pd.Timedelta("10min"), "interpolated")
print(f"MovingPandas: length {track.get_length():.0f} m (true {true:.0f}), middle {middle}")
assert abs(track.get_length() - true) < 1
assert (middle.x, middle.y) == (0.0, 52.0)

dims = ("trajectory", "obs")
drift = xr.Dataset(
    {
        "lon": (dims, lon[None], {"standard_name": "longitude"}),
        "lat": (dims, lat[None], {"standard_name": "latitude"}),
        "time": (dims, times.values[None].astype("datetime64[ns]"), {"standard_name": "time"}),
    },
    {"trajectory": ("trajectory", ["a"], {"cf_role": "trajectory_id"})},
)
grid = drift.traj.gridtime("10min")
length = float(drift.traj.length().values.ravel()[0])
print(f"Trajan: length {length:.0f} m, longitudes on a grid {grid.lon.values.ravel()}")
assert abs(length - true) < 1
assert np.allclose(grid.lon.values.ravel(), [179.99, 0, -179.99])
EOF
