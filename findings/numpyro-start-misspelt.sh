#!/usr/bin/env bash
# A misspelt name in NumPyro's `init_to_value` starts the chain somewhere else, in silence.
#
# Guess: a value for a site that the model does not have is an error or at least a warning.
# What happens: it is ignored, and the site that was meant starts at a uniform draw, for a position
# within metres of the origin, wherever the array stands.
# Versions: numpyro 0.22.0, jax 0.10.2. Seen on 30 November 2026.
# Who is hurt: positions from arrival times have mirror images and local modes; the start is what
# chooses between them. After a site is renamed the old start file is read and not used.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6 scipy==1.17.1 numpyro==0.22.0
cd "$folder"
venv/bin/python - <<'EOF'
import os
import warnings

os.environ["JAX_PLATFORMS"] = "cpu"
import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro.infer import init_to_value
from numpyro.infer.util import initialize_model


def model(y):
    easting = numpyro.sample("easting", dist.Normal(0, 1000))
    numpyro.sample("y", dist.Normal(easting, 1), obs=y)


start = {}
for name in ("easting", "eastings"):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = initialize_model(
            jax.random.key(0), model, model_args=(np.full(5, 800.0),),
            init_strategy=init_to_value(values={name: 800.0}),
        )
    start[name] = float(found.param_info.z["easting"])
    print(f"init_to_value(values={{{name!r}: 800.0}}): the chain starts at {start[name]:.2f}")
assert start["easting"] == 800.0
assert abs(start["eastings"]) <= 2
EOF
