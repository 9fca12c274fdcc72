#!/usr/bin/env bash
# Posterior predictive draws that are the data: NumPyro's `Predictive`, called as the model was.
#
# Guess: `Predictive(model, draws)(key, y)` with the arguments of the fit gives new data.
# What happens: a site with `obs=` keeps its observation, so every "draw" is the data; ArviZ then
# shows a perfect fit (`loo_pit`, predictive p-values and plots alike). No warning. Called without
# the observations the same object gives draws.
# Versions: numpyro 0.22.0, jax 0.10.2. Seen on 30 November 2026.
# Who is hurt: models of arrival times take the data as an object that also says which receiver and
# ping a value belongs to, so it cannot be left out; the check of the model passes by construction.
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
from numpyro.infer import Predictive


def model(receiver, arrival=None):
    clock = numpyro.sample("clock", dist.Normal(0, 1).expand([3]).to_event(1))
    numpyro.sample("arrival", dist.Normal(clock[receiver], 0.1), obs=arrival)


receiver = np.array([0, 1, 2, 0])
arrival = np.array([5.0, -5.0, 5.0, -5.0], "f")  # nothing like the model
draws = {"clock": np.zeros((200, 3), "f")}
with warnings.catch_warnings():
    warnings.simplefilter("error")
    same = Predictive(model, draws)(jax.random.key(0), receiver, arrival)["arrival"]
    new = Predictive(model, draws)(jax.random.key(0), receiver)["arrival"]
print("called with the data: sd over draws", np.asarray(same).std(0), "=", np.asarray(same)[0])
print("called without:       sd over draws", np.asarray(new).std(0).round(3))
assert (np.asarray(same) == arrival).all()
assert (np.abs(np.asarray(new).std(0) - 0.1) < 0.02).all()
EOF
