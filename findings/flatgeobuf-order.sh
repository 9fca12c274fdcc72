#!/usr/bin/env bash
# FlatGeobuf gives a track's points back in another order.
#
# Guess: a file format keeps the order of rows, as GeoPackage, GeoJSON and GeoParquet do.
# What happens: the writer sorts points along a space-filling curve for its index, and the reader
# gives that order; nothing is said. The option `SPATIAL_INDEX="NO"` keeps the order.
# Versions: geopandas 1.2.0, pyogrio 0.13.0. Seen on 30 November 2026.
# Who is hurt: a track is its order. Lines drawn, steps and speeds taken from the rows as read
# jump about: a straight swim of 900 m is more than twice as long.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 pyogrio==0.13.0 geopandas==1.2.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import geopandas as gpd
import numpy as np
from shapely.geometry import Point

warnings.simplefilter("error")
steps = np.arange(10)
places = [Point(100 * i, 30 * (i % 2)) for i in steps]
track = gpd.GeoDataFrame({"ping": steps}, geometry=places, crs=32632)


def length(points):
    return float(np.hypot(np.diff(points.geometry.x), np.diff(points.geometry.y)).sum())


for name, options, kept in (("a.gpkg", {}, True), ("a.geojson", {}, True), ("a.fgb", {}, False),
                            ("b.fgb", {"SPATIAL_INDEX": "NO"}, True)):
    track.to_file(name, **options)
    read = gpd.read_file(name)
    print(f"{name} {options}: order {read.ping.tolist()}, {length(read):.0f} m")
    assert (read.ping.tolist() == steps.tolist()) == kept
    assert sorted(read.ping) == steps.tolist()
    if not kept:
        assert length(read) > 2 * length(track)
EOF
