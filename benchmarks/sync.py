"""CPU seconds and memory of clock synchronisation by length of the record.

    python -m benchmarks.sync --days 1 3 10 30 --receivers 20

Arrays are simulated (`maloc.simulate.sync_array`): every receiver has a sync tag that pings every 8
to 12 minutes and hears 70 % of the others' pings. Each length runs in a process of its own, so that
its peak of memory is its own; simulating is not counted.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

from maloc import sync
from maloc.simulate.sync_array import sync_array


def one(days: float, receivers: int, seed: int) -> None:
    """Simulate, synchronise, print a line."""
    array = sync_array(np.random.default_rng([4, seed]), receivers, days)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    wall, cpu = time.perf_counter(), time.process_time()
    fitted = sync.fit(array.detections, array.receivers)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    n = len(array.detections)
    print(
        f"{days:>5.0f}{n:>10}{cpu:>8.1f}{wall:>8.1f}{1e6 * cpu / n:>14.1f}{before:>10.2f}"
        f"{peak:>8.2f}{1e3 * fitted.residual_sd:>10.3f}",
        flush=True,
    )


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=float, nargs="+", default=[1.0, 3.0, 10.0, 30.0])
    parser.add_argument("--receivers", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    if len(given.days) == 1:
        one(given.days[0], given.receivers, given.seed)
        return
    head = f"{'days':>5}{'arrivals':>10}{'CPU s':>8}{'wall s':>8}{'us/arrival':>14}"
    print(head + f"{'GB before':>10}{'GB':>8}{'sd ms':>10}", flush=True)
    for days in given.days:
        asked = [f"--days={days}", f"--receivers={given.receivers}", f"--seed={given.seed}"]
        subprocess.run([sys.executable, "-m", "benchmarks.sync", *asked], check=True)


if __name__ == "__main__":
    main()
