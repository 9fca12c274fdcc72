#!/usr/bin/env bash
# NumPyro's `obs_mask` for missing observations makes NUTS hundreds of times dearer.
#
# Guess: `numpyro.sample(..., obs=y, obs_mask=m)` costs a little more than leaving missing values
# out of the likelihood with `handlers.mask`, for the missing values are sampled too.
# What happens: a latent value is made for EVERY cell, and those of observed cells have no density
# at all. NUTS never finds a U-turn along them: every draw takes the greatest tree, 1023 steps of
# the gradient, where the masked likelihood takes about 3; those latents walk off to 1e15. The
# parameter's posterior agrees, and no warning or divergence tells.
# Versions: numpyro 0.22.0, jax 0.10.2. Seen on 30 November 2026.
# Who is hurt: arrival times of a receiver that did not hear a ping are the missing data of this
# field, and this argument is documented for missing data.
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
from numpyro.infer import MCMC, NUTS


def by_obs_mask(y, heard):
    mu = numpyro.sample("mu", dist.Normal(0, 10))
    with numpyro.plate("receiver", len(y)):
        numpyro.sample("y", dist.Normal(mu, 1), obs=y, obs_mask=heard)


def by_handler(y, heard):
    mu = numpyro.sample("mu", dist.Normal(0, 10))
    with numpyro.plate("receiver", len(y)), numpyro.handlers.mask(mask=heard):
        numpyro.sample("y", dist.Normal(mu, 1), obs=y)


heard = np.arange(20) < 15
y = np.where(heard, np.random.default_rng(1).normal(3, 1, 20), 0.0)
steps, mean = [], []
for model in (by_obs_mask, by_handler):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sampler = MCMC(NUTS(model), num_warmup=300, num_samples=300, progress_bar=False)
        sampler.run(jax.random.key(0), y, heard, extra_fields=("num_steps", "diverging"))
    extra, draws = sampler.get_extra_fields(), sampler.get_samples()
    steps.append(float(np.median(extra["num_steps"])))
    mean.append(float(draws["mu"].mean()))
    print(f"{model.__name__}: {steps[-1]:.0f} steps a draw (median), mu {mean[-1]:.2f}, "
          f"{int(extra['diverging'].sum())} divergences")
    if model is by_obs_mask:
        latent = np.abs(np.asarray(draws["y_unobserved"]))[:, heard].max()
        print(f"largest latent value of an observed cell: {latent:.1e}")
        assert latent > 1e6
assert steps[0] == 1023 and steps[1] <= 7
assert abs(mean[0] - mean[1]) < 0.1
EOF
