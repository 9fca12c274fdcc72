#!/usr/bin/env bash
# Arrival times lose their microseconds in GIS files, and some are written with a 60th second.
#
# Guess: GeoPandas writes datetimes to GeoPackage, GeoJSON or FlatGeobuf and reads the same ones,
# or says what it drops.
# What happens: written the usual way times are cut to milliseconds without a word: up to 1 ms, or
# 1.5 m of sound in water. Written with `use_arrow=True` they are rounded instead, and
# 12:00:59.9997 becomes the text "12:00:60"; on reading, pandas cannot parse it, and the whole
# column comes back as text with a warning.
# Versions: geopandas 1.2.0, pyogrio 0.13.0, pandas 3.1.1. Seen on 30 November 2026.
# Who is hurt: whoever passes synchronised detections through a GIS; 1 time in 120 000 falls in the
# last half millisecond of a minute, and a season's table has more rows than that.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 pyarrow==26.0.1 \
    pyogrio==0.13.0 geopandas==1.2.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import geopandas as gpd
import pandas as pd
from shapely.geometry import Point

times = pd.to_datetime(["2026-03-01T12:00:00.123456Z", "2026-03-01T12:00:59.999700Z"])
points = gpd.GeoDataFrame({"time": times}, geometry=[Point(5, 60), Point(5, 61)], crs=4326)
for driver, name in (("GPKG", "a.gpkg"), ("GeoJSON", "a.geojson"), ("FlatGeobuf", "a.fgb")):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points.to_file(name, driver=driver)
        read = gpd.read_file(name).time.sort_values()
    lost = ((times - pd.DatetimeIndex(read)) / pd.Timedelta("1us")).tolist()
    print(f"{driver}: {[str(t) for t in read]}, microseconds lost: {lost}")
    assert lost == [456, 700]

points.to_file("b.gpkg", use_arrow=True)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    read = gpd.read_file("b.gpkg").time
print(f"GPKG by Arrow: {read.tolist()}, type {read.dtype}")
assert not pd.api.types.is_datetime64_any_dtype(read)
assert "12:00:60" in read[1]
assert any("original strings are returned" in str(w.message) for w in said)
EOF
