#!/usr/bin/env bash
# The column elpd_diff of `az.compare` has the other sign in ArviZ 1.x; ess_tail is of other tails.
#
# Guess: a comparison of models and a summary keep their columns' meaning from ArviZ 0.23 to 1.x.
# What happens: in 0.23 the worse model's elpd_diff is above 0 (how much it loses), in 1.3 below 0,
# under the same name, and no warning says so. The ess_tail of `az.summary` is that of the 5 % and
# 95 % quantiles in 0.23; in 1.3 it is another number, as is its interval (89 %, equal tails, where
# it was 94 %, highest density). `az.ess(method="tail", prob=(.05, .95))` is the same in both.
# Versions: arviz 0.23.4 and 1.3.0 (arviz-stats 1.3.3). Seen on 30 November 2026, Python 3.13.
# Who is hurt: whoever keeps models by elpd_diff > 2 dse in a script, or compares a paper's ESS with
# last year's: movement and error models are chosen by just these columns.
set -euo pipefail
python="${PYTHON:-python3}"
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))'; then
    echo "not run: ArviZ 1.x needs Python 3.12 or newer (PYTHON=python3.13 names one)"
    exit 77
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >seen.py <<'EOF'
import warnings

warnings.simplefilter("ignore")
import arviz as az
import numpy as np
import xarray as xr

rng = np.random.default_rng(1)
groups = {}
for name, scale in (("near", 1.0), ("far", 2.0)):
    value = rng.normal(0.0, 0.1, (4, 250, 40)) - scale
    walk = rng.normal(size=(4, 250)).cumsum(axis=1) * 0.1 + rng.normal(size=(4, 250))
    groups[name] = {
        "posterior": xr.Dataset({"x": (("chain", "draw"), walk)}),
        "log_likelihood": xr.Dataset({"y": (("chain", "draw", "ping"), value)}),
    }
old = az.__version__.startswith("0.")
make = (lambda g: az.InferenceData(**g)) if old else xr.DataTree.from_dict
data = {name: make(g) for name, g in groups.items()}
table = az.compare(data)
assert list(table.index) == ["near", "far"]
behind = float(table.loc["far", "elpd_diff"])
summary = az.summary(data["near"], round_to="none").iloc[0]
tail = float(az.ess(groups["near"]["posterior"], method="tail", prob=(0.05, 0.95))["x"])
same = abs(float(summary["ess_tail"]) / tail - 1) < 1e-6
print(f"arviz {az.__version__}: elpd_diff of the worse model {behind:+.1f}; ess_tail of the summary "
      f"{float(summary['ess_tail']):.1f}, of the 5 and 95 % quantiles {tail:.1f}")
assert (behind > 30) if old else (behind < -30)
assert same == old
EOF
for pins in "arviz==0.23.4" "arviz==1.3.0 arviz-base==1.3.1 arviz-plots==1.3.2 arviz-stats==1.3.3"; do
    "$python" -m venv --clear venv
    # shellcheck disable=SC2086
    venv/bin/pip install --quiet --disable-pip-version-check $pins xarray==2026.9.0 pandas==3.1.1
    venv/bin/python seen.py
done
