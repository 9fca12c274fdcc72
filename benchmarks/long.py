"""Long tracks: ``python -m benchmarks.long --pings 1000 10000 100000``.

Simulated canal tracks, each fitted in a process of its own: CPU seconds without compilation (paid
before, on a short track and, for windows, on a track just long enough), CPU milliseconds a ping,
peak memory, mean error. ``--seams N`` fits N pings in one piece as well, from a start of its own,
and prints how far positions and emission times are from those by windows, in posterior sds.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import importlib
import multiprocessing
import resource
import time

import numpy as np

import maloc
from maloc.simulate import canal_toa


def _fit(toa, *, windows: bool = True):
    """Laplace fit of a track, in one piece or as its length asks."""
    from maloc.models import toa_track

    engine = importlib.import_module("maloc.infer.laplace")
    usual = engine.long_arguments
    if not windows:
        engine.long_arguments = lambda *args: None
    try:
        return maloc.infer.laplace(toa_track, toa)
    finally:
        engine.long_arguments = usual


def measure(pings: int, seed: int) -> dict[str, float]:
    """Fit one track after what it compiles has been paid for."""
    from maloc.infer.long import LONG, SIZE

    toa, truth = canal_toa(np.random.default_rng(seed), n_pings=pings)
    ready = pings if pings <= LONG * SIZE else LONG * SIZE + SIZE
    _fit(canal_toa(np.random.default_rng(seed + 1), n_pings=ready)[0])
    begun = time.process_time()
    fit = _fit(toa)
    mean, _, low, high = fit.positions()
    spent = time.process_time() - begun
    where = np.column_stack([truth.x, truth.y])[toa.n_heard > 0]
    return {
        "cpu": spent,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        "error": float(np.linalg.norm(mean - where, axis=1).mean()),
        "cover": float(np.mean((low <= where) & (where <= high))),
        "converged": float(not fit.warnings),
    }


def seams(pings: int, seed: int) -> np.ndarray:
    """Distance of states by windows from those in one piece, (T, d) sds; in one process."""
    toa, _ = canal_toa(np.random.default_rng(seed), n_pings=pings)
    (a, spread), (b, _) = (_fit(toa, windows=w).moments() for w in (False, True))
    return np.abs(a - b) / np.sqrt(np.einsum("tii->ti", spread))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, nargs="+", default=[300])
    parser.add_argument("--seams", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    print(f"{'pings':>8}{'CPU s':>9}{'ms/ping':>9}{'GB':>6}{'mean m':>8}{'cover':>7}  all well")
    for pings in given.pings:
        with spawn.Pool(1) as pool:
            row = pool.apply(measure, (pings, given.seed))
        print(
            f"{pings:>8}{row['cpu']:>9.1f}{1e3 * row['cpu'] / pings:>9.2f}{row['memory']:>6.2f}"
            f"{row['error']:>8.2f}{row['cover']:>7.3f}  {'yes' if row['converged'] else 'no'}",
            flush=True,
        )
    if given.seams:
        off = seams(given.seams, given.seed)
        worst = off.max(axis=1)
        print(
            f"windows against one piece, {given.seams} pings: largest difference "
            f"{off.max():.4f} sd, {int((worst > 0.05).sum())} states beyond .05 sd"
        )


if __name__ == "__main__":
    main()
