"""The classical chain beside the posterior of arrival times: ``python -m benchmarks.kalman``.

CPU seconds of Kalman filter and smoother on many positions; then simulated canal tracks
(reflections, missed arrivals): mean error of least squares, of what a speed filter leaves of it, of
filter and smoother after that, of EK-TOA and of `toa_track` on the same arrivals.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time

import numpy as np

import maloc
from maloc.classical import ek_toa, kalman, speed_filter
from maloc.points import Points, locate
from maloc.simulate import canal_toa

SPEED = 2.0  # m/s; the filter's limit


def walk(n: int, seed: int) -> Points:
    """Positions of a made-up walk, every 30 s, sd 2 m."""
    rng = np.random.default_rng(seed)
    position = np.cumsum(rng.normal(0, 3, (n, 2)), axis=0) + rng.normal(0, 2, (n, 2))
    return Points(
        position=position,
        covariance=np.tile(4 * np.eye(2), (n, 1, 1)),
        emission=30.0 * np.arange(n),
        n_used=np.full(n, 4),
        inlier=np.ones((n, 4), bool),
        ambiguous=np.zeros(n, bool),
        alternative=np.full((n, 2), np.nan),
        residual_rms=np.zeros(n),
        method="made up",
        why=np.full(n, ""),
    )


def chain(seed: int, missing: float, late: float) -> tuple[list[float], int]:
    """Mean errors (m) of one track, of each step of the chain; positions filtered out."""
    toa, truth = canal_toa(np.random.default_rng(seed), p_na=missing, p_mp=late)
    true = np.column_stack([truth.x, truth.y])
    found = locate(toa, method="least-squares")
    keep = found.located & np.isfinite(found.emission)
    rows = np.flatnonzero(keep)
    passed = speed_filter(found.emission[rows], found.position[rows], SPEED).keep
    keep[rows[~passed]] = False

    def error(xy: np.ndarray, rows: np.ndarray) -> float:
        return float(np.mean(np.linalg.norm(xy - true[rows], axis=1)))

    track = kalman(found, keep=keep)
    mine = rows[np.searchsorted(found.emission[rows], track.time)]
    heard = np.flatnonzero(toa.n_heard > 0)
    fit = maloc.infer.laplace(maloc.models.toa_track, toa)
    kept = np.flatnonzero(keep)
    return [
        error(found.position[rows], rows),
        error(found.position[kept], kept),
        error(track.filtered.mean[:, :2], mine),
        error(track.smoothed.mean[:, :2], mine),
        error(ek_toa(toa).smoothed.mean[:, :2], heard),
        error(fit.moments()[0][:, :2], heard),
    ], int((~passed).sum())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--tracks", type=int, default=3, help="0: only the time")
    given = parser.parse_args()
    known = {"sigma_vel": 0.3, "t05": 260.0}
    points = walk(given.points, 0)
    kalman(walk(100, 0), parameters=known)
    spent = []
    for _ in range(3):  # the first waits for memory as well
        start = time.process_time()
        kalman(points, parameters=known)
        spent.append(f"{time.process_time() - start:.2f}")
    print(f"{given.points} positions: {', '.join(spent)} CPU s, filter and smoother")
    if not given.tracks:
        return
    print("mean error, m")
    print("missing late   least squares  kept  filtered  smoothed  EK-TOA  toa_track   out")
    for missing, late in ((0.0, 0.0), (0.1, 0.02), (0.2, 0.06)):
        found = [chain(seed, missing, late) for seed in range(given.tracks)]
        errors = np.mean([e for e, _ in found], axis=0)
        out = np.mean([n for _, n in found])
        print(f"{missing:7g} {late:4g}", *(f"{e:13.2f}" for e in errors), f"{out:6.1f}")


if __name__ == "__main__":
    main()
