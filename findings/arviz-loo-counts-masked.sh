#!/usr/bin/env bash
# Observations that NumPyro was told to leave out are counted by ArviZ's LOO, or stop it.
#
# Guess: cells under `handlers.mask(mask=False)` are not in the pointwise log likelihood that
# `az.from_numpyro` makes, so `az.loo` speaks of the 5 that were heard.
# What happens: they are there as zeros. ArviZ 0.23 takes 20 observations for 5: the standard error
# is that of 5 values of about -1.4 and 15 of 0, 2.95 where it should be 1.15, and 15 Pareto k are
# infinite. ArviZ 1.3 ends in "ValueError: All tail values are the same".
# Versions: numpyro 0.22.0 and arviz 0.23.4; arviz 1.3.0 (arviz-stats 1.3.3), which needs Python
# 3.12 or newer. Seen on 30 November 2026.
# Who is hurt: which receiver hears a ping varies, so arrays of arrival times are mostly masked;
# models are then compared with errors that hide every difference.
set -euo pipefail
python=${PYTHON:-python3}
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then
    echo "not run: needs Python 3.12 or newer; name one in PYTHON" >&2
    exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$python" -m venv old
old/bin/pip install --quiet --disable-pip-version-check \
    numpyro==0.22.0 jax==0.10.2 jaxlib==0.10.2 arviz==0.23.4 numpy==2.4.6 scipy==1.17.1 \
    pandas==3.1.1 xarray==2026.9.0
"$python" -m venv new
new/bin/pip install --quiet --disable-pip-version-check \
    arviz==1.3.0 arviz-base==1.3.1 arviz-stats==1.3.3 arviz-plots==1.3.2 numpy==2.5.5 \
    scipy==1.18.1 pandas==3.1.1 xarray==2026.9.0
JAX_PLATFORMS=cpu old/bin/python - <<'EOF'
import logging
import warnings

warnings.simplefilter("ignore")
logging.disable(logging.WARNING)
import arviz as az
import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpyro.infer import MCMC, NUTS


def model(y, heard):
    mu = numpyro.sample("mu", dist.Normal(0, 10))
    with numpyro.plate("receiver", len(y)), numpyro.handlers.mask(mask=heard):
        numpyro.sample("y", dist.Normal(mu, 1), obs=y)


heard = np.arange(20) < 5
y = np.where(heard, np.random.default_rng(1).normal(3, 1, 20), 0.0)
sampler = MCMC(NUTS(model), num_warmup=300, num_samples=1000, progress_bar=False)
sampler.run(jax.random.key(0), y, heard)
data = az.from_numpyro(sampler)
values = data.log_likelihood["y"].values
assert (values[:, :, 5:] == 0).all()
np.save("values.npy", values)
of_all = az.loo(data, pointwise=True)
of_heard = az.loo(az.from_dict(posterior={"mu": data.posterior["mu"].values},
                               log_likelihood={"y": values[:, :, :5]}))
print(f"ArviZ {az.__version__}, all cells: {of_all.n_data_points} observations, "
      f"elpd {of_all.elpd_loo:.2f}, se {of_all.se:.2f}, "
      f"{int(np.isinf(of_all.pareto_k.values).sum())} infinite k")
print(f"those heard: {of_heard.n_data_points} observations, elpd {of_heard.elpd_loo:.2f}, "
      f"se {of_heard.se:.2f}")
assert (of_all.n_data_points, of_heard.n_data_points) == (20, 5)
assert abs(of_all.elpd_loo - of_heard.elpd_loo) < 1e-6
assert of_all.se > 2 * of_heard.se
assert np.isinf(of_all.pareto_k.values[5:]).all()
EOF
new/bin/python - <<'EOF'
import arviz as az
import numpy as np

values = np.load("values.npy")
mu = np.random.default_rng(0).normal(size=values.shape[:2])
try:
    az.loo(az.from_dict({"posterior": {"mu": mu}, "log_likelihood": {"y": values}}))
except ValueError as error:
    print(f"ArviZ {az.__version__}: ValueError: {error}")
    assert "tail values are the same" in str(error)
else:
    raise AssertionError("masked cells no longer stop it")
EOF
