#!/usr/bin/env bash
# Dask's workers run plain NumPy several times slower than the process that starts them.
#
# Guess: a Dask worker with one thread computes as fast as a script does.
# What happens: Dask sets MALLOC_TRIM_THRESHOLD_=65536 for its workers to give memory back. In
# glibc setting it also switches off the growing of the threshold from which a block is mapped on
# its own: every temporary array above 128 KiB is mapped, faulted in and unmapped again. Adding
# and multiplying arrays of 160 KB takes some 9 times the CPU time; arrays of 64 KB are as fast.
# Without the entry of `distributed.nanny.pre-spawn-environ` (as below) workers are as fast.
# Versions: dask and distributed 2026.8.0, numpy 2.4.6, glibc 2.36. Seen on 30 November 2026.
# Who is hurt: many tags are fitted in parallel, one a worker, with arrays of just this size
# (pings by receivers); a fit took twice as long in a worker as alone.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    dask==2026.8.0 distributed==2026.8.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'EOF'
import os
import subprocess
import sys
from pathlib import Path

Path("times.py").write_text('''
import os
import sys
import time

import dask
import numpy as np
from distributed import Client, LocalCluster


def work(size):
    x, y = np.ones(size), 0.0
    start = time.process_time()
    for _ in range(1000):
        y = (x * 1.5 + 1.0) * 2 + y * 0.5
    return time.process_time() - start


def setting():
    return os.environ.get("MALLOC_TRIM_THRESHOLD_")


if __name__ == "__main__":
    if sys.argv[1] == "without":
        dask.config.set({"distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1}})
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            best = [
                min(client.submit(work, size, pure=False).result() for _ in range(5))
                for size in (8000, 20000)
            ]
            print(client.submit(setting).result(), *best)
''')
environ = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")}
found = {}
for how in ("default", "without"):
    run = subprocess.run([sys.executable, "times.py", how], env=environ, check=True,
                         capture_output=True, text=True).stdout.split()
    found[how] = run[0], float(run[1]), float(run[2])
    print(f"{how}: MALLOC_TRIM_THRESHOLD_ {run[0]}; CPU seconds, 64 KB: {run[1]}, 160 KB: {run[2]}")
ratios = [a / b for a, b in zip(found["default"][1:], found["without"][1:])]
print("ratios:", [round(r, 2) for r in ratios])
assert (found["default"][0], found["without"][0]) == ("65536", "None")
assert ratios[1] > 2
assert ratios[0] < 1.5
EOF
