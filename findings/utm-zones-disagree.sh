#!/usr/bin/env bash
# "Which UTM zone?" has two answers on Norway's coast, and none at the 180th meridian.
#
# Guess: GeoPandas' `estimate_utm_crs` and the package utm choose the same zone, and both one of
# the zones next to the points.
# What happens: at Bergen (5.3 E) GeoPandas says 31N and utm 32, the exception that maps of Norway
# follow; on Svalbard they differ too. For a track across 180 degrees (Bering Sea, Fiji)
# GeoPandas takes the middle of the bounds, near longitude 0, and answers zone 31N: coordinates are
# finite, with northings of 14 200 km, counted over the pole, where zones 60N and 1N have 5 800 km.
# Versions: geopandas 1.2.0, pyproj 3.7.2, utm 0.8.1. Seen on 30 November 2026.
# Who is hurt: receivers placed by one tool and fish by the other stand 330 km apart; salmon of
# the fjords and anything tagged in the Aleutians are ordinary data of the field.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 shapely==2.2.0 pyproj==3.7.2 geopandas==1.2.0 utm==0.8.1
cd "$folder"
venv/bin/python - <<'EOF'
import geopandas as gpd
import utm
from shapely.geometry import Point


def estimate(*places):
    points = gpd.GeoSeries([Point(*place) for place in places], crs=4326)
    return points, points.estimate_utm_crs()


for name, lon, lat, theirs, ours in (("Bergen", 5.3, 60.4, "31N", 32),
                                     ("Svalbard", 20.0, 78.5, "34N", 33)):
    points, crs = estimate((lon, lat))
    easting, _, zone, _ = utm.from_latlon(lat, lon)
    print(f"{name}: {crs.name}, easting {points.to_crs(crs).x[0]:.0f}; "
          f"utm: zone {zone}, easting {easting:.0f}")
    assert crs.name.endswith("zone " + theirs) and zone == ours

ends = (179.99, 52.0), (-179.98, 52.0)
for place, zone in zip(ends, ("60N", "1N")):
    assert estimate(place)[1].name.endswith("zone " + zone)
points, crs = estimate(*ends)
plane, near = points.to_crs(crs), points.to_crs(32601)
print(f"across 180 degrees: {crs.name}, northings {plane.y.round().tolist()}; "
      f"in zone 1N {near.y.round().tolist()}")
assert crs.name.endswith("zone 31N")
assert plane.y.min() > 14e6 and 5.7e6 < near.y.max() < 5.8e6
EOF
