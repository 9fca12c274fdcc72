#!/usr/bin/env bash
# Heights from GPS "converted" to sea level are returned unchanged where the geoid's grid is absent.
#
# Guess: pyproj raises, or answers inf, when the grid for EGM96 or EGM2008 is not installed (its
# wheels bring none); surely so with `only_best=True`.
# What happens: a ballpark transformation answers the ellipsoidal height as the height above the
# sea, with `only_best=True` and `errcheck=True` too. Off Halifax the true difference is about
# 20 m. Only the text of `transformer.description` tells ("ballpark vertical").
# Versions: pyproj 3.7.2, network access off as it is by default. Seen on 30 November 2026.
# Who is hurt: receivers surveyed by GPS on a buoy or at the shore, tags' depths from pressure: the
# two verticals differ by tens of metres, which a fit takes for range.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    pyproj==3.7.2
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import pyproj

assert not pyproj.network.is_network_enabled()
lon, lat, height = -63.0, 44.5, 5.0
for name, code in (("EGM96", 5773), ("EGM2008", 3855)):
    for options in ({}, {"only_best": True}):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            to_sea = pyproj.Transformer.from_crs(
                "EPSG:4979", f"EPSG:4326+{code}", always_xy=True, **options
            )
            x, y, z = to_sea.transform(lon, lat, height, errcheck=True)
        print(f"{name}, {options}: {height} m above the ellipsoid -> {z} m above the sea; "
              f"description: {to_sea.description}")
        assert (x, y, z) == (lon, lat, height)
        assert "ballpark vertical" in to_sea.description
EOF
