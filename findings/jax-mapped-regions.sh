#!/usr/bin/env bash
# Every shape that JAX compiles for keeps about a dozen of the process's memory mappings.
#
# Guess: compiled functions cost memory only, of which there is plenty; with the persistent
# compile cache not even time.
# What happens: on Linux a small scan compiled for 100 lengths adds more than 1000 lines to
# /proc/self/maps, persistent cache warm or cold, and they stay until `jax.clear_caches()`. Linux
# allows a process 65530 mappings by default (vm.max_map_count), so some 5000 compiled shapes use
# that up while memory is all but free.
# Versions: jax and jaxlib 0.10.2. Seen on 30 November 2026; 0.12.0.1 (Python 3.13) alike.
# Who is hurt: track after track has another number of pings, so another shape; a loop over some
# hundred tags, or a long run of tests, ends there. Padding to few shapes or clearing helps.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6 scipy==1.17.1
cd "$folder"
venv/bin/python - <<'EOF'
import gc
import os
import sys
import warnings
from pathlib import Path

if not Path("/proc/self/maps").exists():
    sys.exit("not run: /proc/self/maps is Linux's")
os.environ["JAX_PLATFORMS"] = "cpu"
import jax
import jax.numpy as jnp
import numpy as np

warnings.simplefilter("ignore")
jax.config.update("jax_compilation_cache_dir", "cache")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def mappings():
    return Path("/proc/self/maps").read_text().count("\n")


@jax.jit
def filter_like(x):
    def step(carry, y):
        return jnp.sin(carry) + y, carry * y

    return jax.lax.scan(step, 0.0, x)[1].sum() + jnp.linalg.norm(x)


filter_like(np.ones(3, "f"))
before = mappings()
for state in ("cold", "warm"):
    for n in range(10, 110):
        filter_like(np.ones(n, "f"))
    added = mappings() - before
    print(f"persistent cache {state}: 100 shapes add {added} mappings; "
          f"65530 hold some {65530 * 100 // added} shapes")
    assert 500 < added < 5000
    jax.clear_caches()
    gc.collect()
    left = mappings() - before
    print(f"after jax.clear_caches(): {left} more than before")
    assert left < 100
EOF
