#!/usr/bin/env bash
# A track in local metres without a reference system is 24 000 km long in MovingPandas.
#
# Guess: points without a system, as read from GeoParquet with `"crs": null`, are taken for a
# plane; MovingPandas even has a warning for it ("Computations will use Euclidean distances").
# What happens: its argument `crs` is EPSG:4326 when not given, so the warning never comes, metres
# are degrees of longitude and latitude, and 247 m are 24 342 km, speeds alike. No message of it.
# Versions: movingpandas 0.23.0, geopandas 1.2.0, pyarrow 26.0.1. Seen on 30 November 2026.
# Who is hurt: acoustic arrays are surveyed in local metres, which have no EPSG code. Giving such
# points an engineering system (ENGCRS, Cartesian, metre) makes the length right, as shown.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 pyarrow==26.0.1 \
    geopandas==1.2.0 movingpandas==0.23.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import geopandas as gpd
import movingpandas as mpd
import pandas as pd
from shapely.geometry import Point

LOCAL = (
    'ENGCRS["local frame",EDATUM["array"],CS[Cartesian,2],'
    'AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
)
places = [Point(0, 0), Point(100, 0), Point(200, 50), Point(235, 50)]
times = pd.date_range("2026-03-01", periods=4, freq="60s")
lengths, said = {}, []
for name, crs in (("none", None), ("engineering", LOCAL)):
    gpd.GeoDataFrame({"id": 1, "time": times}, geometry=places, crs=crs).to_parquet("track.parquet")
    points = gpd.read_parquet("track.parquet").set_index("time")
    assert (points.crs is None) == (crs is None)
    with warnings.catch_warnings(record=True) as here:
        warnings.simplefilter("always")
        lengths[name] = mpd.Trajectory(points, 1).get_length()
    said += [str(w.message) for w in here if "CRS" in str(w.message)]
    print(f"system: {name}, length {lengths[name]:.1f}, warnings of it: {said}")
assert abs(lengths["engineering"] - 246.8) < 0.1
assert 24_341_000 < lengths["none"] < 24_343_000
assert not said
EOF
