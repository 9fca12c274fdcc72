#!/usr/bin/env bash
# In a reference system that counts feet, MovingPandas converts speeds to metres but not lengths.
#
# Guess: `get_length(units="m")` and `add_speed(units=("m", "s"))` both convert from the unit of
# the reference system, as the documentation says of known units.
# What happens: 5 feet in 10 s are .1524 m/s in the speeds, and a length of "5.0 m": lengths are
# divided by the wanted unit and never multiplied by that of the system.
# Versions: movingpandas 0.23.0, geopandas 1.2.0. Seen on 30 November 2026.
# Who is hurt: United States rivers and reservoirs are mapped in State Plane feet; a fish's daily
# distance comes out 3.28 times too long, beside speeds that are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 geopandas==1.2.0 movingpandas==0.23.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import geopandas as gpd
import movingpandas as mpd
import pandas as pd
from shapely.geometry import Point

warnings.simplefilter("ignore")
times = pd.date_range("2026-03-01", periods=2, freq="10s")
points = gpd.GeoDataFrame({"id": 1}, geometry=[Point(0, 0), Point(3, 4)], index=times, crs=2225)
assert points.crs.axis_info[0].unit_name == "US survey foot"
track = mpd.Trajectory(points, 1)
track.add_speed(units=("m", "s"))
speed, length = track.df["speed"].iloc[-1], track.get_length(units="m")
print(f"5 US survey feet in 10 s: {speed:.4f} m/s, {length} m")
assert abs(speed - 5 * 1200 / 3937 / 10) < 1e-9
assert length == 5.0
EOF
