#!/usr/bin/env bash
# `az.InferenceData` is still there in ArviZ 1.3, and is not InferenceData.
#
# Guess: a program that must work with ArviZ 0.2x and 1.x can ask `hasattr(az, "InferenceData")`.
# What happens: the name exists (1.0 lacked it) and is xarray's DataTree; asking for it warns. Built
# from groups, `az.InferenceData(posterior=...)`, it fails with a TypeError about an unexpected
# keyword; `isinstance` is true for any tree that never came from ArviZ. `az.psislw` is gone.
# Versions: arviz 1.3.0 (arviz-base 1.3.1), xarray 2026.9.0 on Python 3.12 or newer.
# Seen on 30 November 2026.
# Who is hurt: packages that return posteriors guard by this name (written for 1.0); the guard lets
# them through, and a finished fit ends in a TypeError from inside xarray.
set -euo pipefail
python=${PYTHON:-python3}
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then
    echo "not run: needs Python 3.12 or newer; name one in PYTHON" >&2
    exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    arviz==1.3.0 arviz-base==1.3.1 arviz-stats==1.3.3 arviz-plots==1.3.2 numpy==2.5.5 \
    scipy==1.18.1 pandas==3.1.1 xarray==2026.9.0
cd "$folder"
venv/bin/python - <<'EOF'
import warnings

import arviz as az
import xarray as xr

with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    present = hasattr(az, "InferenceData")
    kind = az.InferenceData
print(f"arviz {az.__version__}: InferenceData there: {present}, it is {kind}")
print("warned:", str(said[0].message).split("\n")[0])
assert present and said
assert kind is xr.DataTree
posterior = xr.Dataset({"x": (("chain", "draw"), [[1.0, 2.0]])})
try:
    kind(posterior=posterior)
except TypeError as error:
    print(f"TypeError: {error}")
    assert "posterior" in str(error)
else:
    raise AssertionError("groups as keywords are taken now")
assert isinstance(xr.DataTree(xr.Dataset()), kind)
assert not hasattr(az, "psislw")
EOF
