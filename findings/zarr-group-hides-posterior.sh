#!/usr/bin/env bash
# Adding a group to a Zarr store of format 2 makes the groups that were there vanish.
#
# Guess: `to_zarr(store, group="posterior_predictive", mode="a")` adds a group in the format that
# the store has, as it does with NetCDF.
# What happens: it is written in format 3, with a root of format 3 laid over that of format 2. From
# then on the store opens as one that has only the new group; the posterior's bytes lie there
# unseen. Of the warnings none says so; with `zarr_format=2` given both groups are seen.
# Versions: xarray 2026.9.0, zarr 3.1.6. Seen on 30 November 2026.
# Who is hurt: ArviZ 0.2x and zarr 2 write format 2. A long fit's posterior seems lost after
# predictive draws were added to it by today's packages.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    numpy==2.4.6 pandas==3.1.1 xarray==2026.9.0 zarr==3.1.6
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import xarray as xr

warnings.simplefilter("ignore")
draws = xr.Dataset({"x": (("chain", "draw"), [[1.0, 2.0]])})


def groups(store):
    return sorted(xr.open_datatree(store, engine="zarr").groups)


for given, seen in (({}, ["/", "/posterior_predictive"]),
                    ({"zarr_format": 2}, ["/", "/posterior", "/posterior_predictive"])):
    store = f"{len(given)}.zarr"
    xr.DataTree.from_dict({"posterior": draws}).to_zarr(store, zarr_format=2)
    before = groups(store)
    draws.to_zarr(store, group="posterior_predictive", mode="a", **given)
    print(f"given {given or 'no format'}: {before} before, {groups(store)} after")
    assert before == ["/", "/posterior"]
    assert groups(store) == seen
EOF
