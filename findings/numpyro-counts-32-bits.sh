#!/usr/bin/env bash
# Overdispersed counts of detections: NumPyro's likelihood, in 32 bits, is highest at no
# overdispersion at all.
#
# Guess: in JAX's default 32 bits a log density is right to some 1e-3 a count.
# What happens: `NegativeBinomial2` takes differences of log gamma functions of the concentration.
# From 1e7 on digits cancel, and from 1e9 the term that stays is missing whole: each count's
# log density is too high by its mean. 200 hourly counts of mean 30 drawn with concentration 3 have
# their greatest likelihood from 1e9 on, by thousands of log units. In 64 bits it is near 3.
# Versions: numpyro 0.22.0, jax 0.10.2. Seen on 30 November 2026.
# Who is hurt: detections an hour are the commonest overdispersed count of the field; an optimizer
# or a long-tailed prior on the concentration that meets that region stays in it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6 scipy==1.17.1 numpyro==0.22.0
cd "$folder"
venv/bin/python - <<'EOF'
import os

os.environ["JAX_PLATFORMS"] = "cpu"
import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from scipy import stats

counts = stats.nbinom(3, 3 / (3 + 30)).rvs(200, random_state=np.random.default_rng(0))
grid = np.array([0.3, 1, 3, 10, 100, 1e4, 1e6, 1e8, 1e9, 1e10])
exact = np.array([stats.nbinom(k, k / (k + 30.0)).logpmf(counts).sum() for k in grid[:5]])
exact = np.append(exact, stats.poisson(30).logpmf(counts).sum())  # the limit
best = {}
for bits in (32, 64):
    jax.config.update("jax_enable_x64", bits == 64)
    found = [float(dist.NegativeBinomial2(30.0, k).log_prob(jnp.asarray(counts)).sum())
             for k in grid]
    best[bits] = float(grid[np.argmax(found)])
    print(f"{bits} bits: greatest at concentration {best[bits]:g};",
          ", ".join(f"{k:g}: {v:.0f}" for k, v in zip(grid, found)))
    if bits == 32:
        assert found[-1] - exact.max() > 1000
        assert abs(found[-1] - exact[-1] - 30 * len(counts)) < 60
    else:
        assert np.allclose(found[:5], exact[:5], rtol=1e-6)
assert best[32] >= 1e9 and best[64] == 3.0
EOF
