#!/usr/bin/env bash
# Asked for the depth outside a bathymetry, rasterio answers 0.
#
# Guess: `sample` raises, masks or gives NaN for a place that the raster does not cover.
# What happens: it gives the raster's nodata value, and where none is set, 0: the shore. A masked
# sample (`masked=True`) is right in both cases, and is not the default.
# Versions: rasterio 1.4.4. Seen on 30 November 2026.
# Who is hurt: a receiver or a fish just outside the grid stands on land with depth 0; with 20 m of
# water there, a depth likelihood rules the true place out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 rasterio==1.4.4
cd "$folder"
venv/bin/python - <<'EOF'
import numpy as np
import rasterio
from rasterio.transform import from_origin

depth = np.full((1, 5, 5), -20.0, "float32")
for nodata in (None, -9999.0):
    with rasterio.open(
        "depth.tif", "w", driver="GTiff", height=5, width=5, count=1, dtype="float32",
        crs=32632, transform=from_origin(0, 500, 100, 100), nodata=nodata,
    ) as raster:
        raster.write(depth)
    with rasterio.open("depth.tif") as raster:
        places = [(250, 250), (900, 250)]
        plain = [float(v[0]) for v in raster.sample(places)]
        masked = [bool(np.ma.getmaskarray(v)[0]) for v in raster.sample(places, masked=True)]
    print(f"nodata {nodata}: inside and outside {plain}, masked {masked}")
    assert plain == [-20.0, 0.0 if nodata is None else nodata]
    assert masked == [False, True]
EOF
