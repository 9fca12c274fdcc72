#!/usr/bin/env bash
# A closed Dask cluster leaves its settings in the process, and they beat the next one's.
#
# Guess: `distributed.nanny.pre-spawn-environ` is for workers; the process that starts them keeps
# its environment, and a second cluster obeys the configuration at that time.
# What happens: the variables (MALLOC_TRIM_THRESHOLD_, OMP_NUM_THREADS, ...) are put into the
# starting process's own environment and stay there after the cluster is closed. Since variables of
# the environment beat the configuration, a second cluster that sets others, or none, gets the
# first one's; so does every other program started from there.
# Versions: dask and distributed 2026.8.0. Seen on 30 November 2026.
# Who is hurt: a session that first fits many tags with one thread each and then one large model
# runs that one, started as a process, on one BLAS thread; the remedy for slow memory in workers,
# given in the configuration, does nothing when any cluster ran before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    dask==2026.8.0 distributed==2026.8.0
cd "$folder"
venv/bin/python - <<'EOF'
import os
import subprocess
import sys
from pathlib import Path

Path("twice.py").write_text('''
import os

import dask
from distributed import Client, LocalCluster

NAMES = "MALLOC_TRIM_THRESHOLD_", "OMP_NUM_THREADS"


def setting():
    return [os.environ.get(name) for name in NAMES]


def in_worker():
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            return client.submit(setting).result()


if __name__ == "__main__":
    print(setting(), in_worker(), setting(), sep="|")
    dask.config.set({"distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 4}})
    print(in_worker(), setting(), sep="|")
''')
unset = {k: v for k, v in os.environ.items()
         if not k.startswith("MALLOC_") and not k.endswith("_NUM_THREADS")}
run = subprocess.run([sys.executable, "twice.py"], env=unset, check=True, capture_output=True,
                     text=True)
before, first, after, second, last = run.stdout.strip().replace("\n", "|").split("|")
print("process before:", before, "first cluster's worker:", first, "process after:", after)
print("second cluster's worker, told 4 threads and no malloc setting:", second)
assert before == "[None, None]"
assert first == after == second == last == "['65536', '1']"
EOF
