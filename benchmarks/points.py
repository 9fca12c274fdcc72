"""Point positions: speed and truth, ``python -m benchmarks.points [--canal FOLDER]``.

Tables, each on one thread, compilation apart: CPU time a localization; outliers told from inliers;
both roots of three receivers; the covariance against Monte Carlo; and, with ``--canal``, errors on
the canal's late arrivals beside plain least squares, and how often 95 % sets hold the truth.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.tracks import folder_cases
from maloc import ArrivalTimes, Receivers
from maloc.points import Points, locate, resolve
from maloc.points.expected import gdop

# name -> method and options; the last column: how many pings are enough to time it
METHODS = {
    "closed-form": ("closed-form", {}, 100_000),
    "interpolation": ("closed-form", {"kind": "interpolation"}, 100_000),
    "least-squares": ("least-squares", {}, 100_000),
    "consensus": ("consensus", {}, 100_000),
    "cluster": ("cluster", {}, 2_000),
    "pmc": ("pmc", {"reflected": 0.1}, 5_000),  # 500 particles, 5 iterations
    "dm-pmc": ("dm-pmc", {"reflected": 0.1}, 5_000),
    "differential-evolution": ("differential-evolution", {}, 50),
}
SPEED = 1500.0


def study(
    rng: np.random.Generator, pings: int, receivers: int, size: float, sd: float, wild: float
) -> tuple[ArrivalTimes, np.ndarray, np.ndarray]:
    """Pings all over a random array; share `wild` of arrivals late by 50 to 300 m.

    Returns arrival times, truth (P, 2) m, and which arrivals (P, R) are late.
    """
    places = rng.uniform(-size, size, (receivers, 2))
    truth = rng.uniform(-size, size, (pings, 2))
    reach = np.linalg.norm(truth[:, None] - places, axis=-1)
    reach = reach + rng.normal(0, sd, reach.shape)
    late = rng.random(reach.shape) < wild
    reach = reach + late * rng.uniform(50, 300, reach.shape)
    names = np.array([f"R{i}" for i in range(receivers)])
    toa = reach / SPEED + 60.0 * np.arange(pings)[:, None]
    table = Receivers(names, places[:, 0], places[:, 1])
    return ArrivalTimes(toa, table, np.full(pings, SPEED)), truth, late


def thinned(rng: np.random.Generator, toa: ArrivalTimes, least: int) -> ArrivalTimes:
    """Each ping heard by `least` to all receivers, uniformly."""
    n, r = toa.toa.shape
    keep = np.argsort(rng.random((n, r)), axis=1) < rng.integers(least, r + 1, (n, 1))
    return toa.replace(toa=np.where(keep, toa.toa, np.nan))


def first(toa: ArrivalTimes, n: int) -> ArrivalTimes:
    """The first n pings."""
    return toa.replace(toa=toa.toa[:n], sound_speed=toa.sound_speed[:n], ping=toa.ping[:n])


def error(points: Points, truth: np.ndarray) -> np.ndarray:
    """Distance (P,) from the truth, m."""
    return np.linalg.norm(points.position - truth, axis=1)


def speeds(pings: int) -> None:
    """CPU milliseconds a localization, all of `locate` counted."""
    rng = np.random.default_rng(1)
    toa, _, _ = study(rng, pings, 16, 800.0, 1.0, 0.1)
    toa = thinned(rng, toa, 5)
    print(f"\n{'method':24}{'pings':>8}{'CPU ms':>9}{'wall ms':>9}   5 to 16 receivers")
    for name, (method, options, enough) in METHODS.items():
        part = first(toa, min(pings, enough))
        locate(part, method, sigma=1.0, **options)  # compiles
        wall, cpu = time.perf_counter(), time.process_time()
        locate(part, method, sigma=1.0, **options)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        each = 1e3 / len(part)
        print(f"{name:24}{len(part):>8}{cpu * each:>9.4f}{wall * each:>9.4f}")


def outliers(pings: int, seed: int = 0) -> None:
    """Shares of inliers kept and of outliers beyond 5 sigma rejected: 30 %, 8 receivers."""
    rng = np.random.default_rng(2 + 1000 * seed)
    print(f"\n{'30 % outliers':24}{'kept':>8}{'rejected':>10}{'settled':>9}{'off > 10 m':>12}")
    for name in ("consensus", "cluster"):
        kept = rejected = right = wrong = settled = 0.0
        for _ in range(4):  # four arrays
            toa, truth, late = study(rng, pings // 4, 8, 500.0, 1.0, 0.3)
            points = locate(toa, name, sigma=1.0)
            kept, right = kept + points.inlier[~late].sum(), right + (~late).sum()
            rejected, wrong = rejected + (~points.inlier[late]).sum(), wrong + late.sum()
            sure = points.located & ~points.ambiguous
            settled += sure.sum()
            off = np.mean(error(points, truth)[sure] > 10)
        share = kept / right, rejected / wrong, settled / (pings // 4 * 4)
        print(f"{name:24}{share[0]:>8.4f}{share[1]:>10.4f}{share[2]:>9.4f}{off:>12.4f}")


def two_roots(pings: int) -> None:
    """Three receivers without noise: the truth among the places, and whether that is flagged."""
    rng = np.random.default_rng(3)
    print(f"\n{'three receivers':24}{'truth in':>9}{'two fit':>9}{'flagged':>9}")
    for name in ("closed-form", "consensus", "cluster"):
        among = two = flagged = 0
        for _ in range(10):
            toa, truth, _ = study(rng, pings // 10, 3, 500.0, 0.0, 0.0)
            points = locate(toa, name, sigma=0.5, reach=1e9)
            other = np.linalg.norm(points.alternative - truth, axis=1)
            among += int((np.fmin(error(points, truth), other) < 0.1).sum())
            second = np.isfinite(other)
            two += int(second.sum())
            flagged += int(points.ambiguous[second].sum())
        n = pings // 10 * 10
        print(f"{name:24}{among / n:>9.5f}{two / n:>9.5f}{flagged / max(two, 1):>9.5f}")


def covariance(geometries: int, pings: int = 1000) -> None:
    """Standard deviation that `locate` states over that of its errors, GDOP below 10."""
    rng = np.random.default_rng(4)
    ratio = []
    while len(ratio) < geometries:
        toa, truth, _ = study(rng, 1, int(rng.integers(5, 11)), 500.0, 0.0, 0.0)
        if not gdop(truth, toa.receivers.xy)[0] < 10:
            continue
        noise = rng.normal(0, 1.0, (pings, len(toa.receivers))) / SPEED
        many = toa.replace(
            toa=toa.toa + noise + 60.0 * np.arange(pings)[:, None],
            sound_speed=np.full(pings, SPEED),
            ping=np.arange(pings),
        )
        # nothing is late, so nothing is set aside; the truth chooses between two places
        points = locate(many, sigma=1.0, delta=8.0, prior=np.repeat(truth, pings, axis=0))
        stated = np.sqrt(np.nanmean(points.sd**2, axis=0))
        ratio.append(stated / np.sqrt(np.nanmean((points.position - truth) ** 2, axis=0)))
    each = np.array(ratio)
    share = ((each > 0.9) & (each < 1.1)).all(axis=1).mean()
    low, middle, high = np.quantile(each, [0.025, 0.5, 0.975])
    print(
        f"\n{'sd stated / sd of errors':24}{'.9 to 1.1':>10}{'2.5 %':>8}{'median':>8}{'97.5 %':>8}"
    )
    print(f"{f'{geometries} geometries':24}{share:>10.3f}{low:>8.3f}{middle:>8.3f}{high:>8.3f}")


def canal(folder: Path, least: int = 4) -> None:
    """Errors (m) on pings of `least` receivers or more, by share missing, multipath .15.

    "same": mean over the pings that all robust methods place; "cover": share of the truth inside
    the 95 % sets of population Monte Carlo.
    """
    names = ("consensus", "pmc", "dm-pmc", "cluster", "closed-form", "differential-evolution")
    names += ("least-squares",)
    told = "consensus, resolved"
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    covered: dict[tuple[str, str], list[np.ndarray]] = {}
    for case in folder_cases(folder, None, None, None):
        if not case.name.endswith("mp15"):
            continue
        name_of_cell = case.name.split("_")[1]
        cell = found.setdefault(name_of_cell, {n: [] for n in (told, *names)})
        enough = case.toa.n_heard >= least
        for name in names:
            points = locate(case.toa, name)
            cell[name].append(error(points, case.truth)[enough])
            if name == "consensus":
                cell[told].append(error(resolve(points), case.truth)[enough])
            if "radius" in points.extra:
                step = points.position - case.truth
                far = np.einsum("pi,pij,pj->p", step, np.linalg.inv(points.covariance), step)
                inside = (far <= points.extra["radius"])[enough]
                covered.setdefault((name_of_cell, name), []).append(inside)
    for cell, methods in found.items():
        head = f"{'mean':>9}{'same':>9}{'median':>9}{'95 %':>9}{'no place':>10}{'cover':>8}"
        print(f"\n{f'canal {cell}_mp15':24}{head}")
        off = {name: np.concatenate(parts) for name, parts in methods.items()}
        same = np.isfinite([off[n] for n in ("consensus", "pmc", "dm-pmc")]).all(axis=0)
        for name, e in off.items():
            row = np.nanmean(e), np.nanmean(e[same]), np.nanmedian(e), np.nanquantile(e, 0.95)
            line = (
                f"{name:24}" + "".join(f"{v:>9.2f}" for v in row) + f"{np.isnan(e).mean():>10.3f}"
            )
            sets = covered.get((cell, name))
            print(line + (f"{np.concatenate(sets).mean():>8.3f}" if sets else ""))


def main() -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=100_000, help="pings to time")
    parser.add_argument("--trials", type=int, default=10_000, help="pings with known truth")
    parser.add_argument("--seed", type=int, default=0, help="of the arrays with outliers")
    parser.add_argument("--canal", type=Path, help="folder of canal matrices with truth")
    options = parser.parse_args()
    speeds(options.pings)
    outliers(options.trials, options.seed)
    two_roots(options.trials)
    covariance(max(options.trials // 20, 10))
    if options.canal:
        canal(options.canal)


if __name__ == "__main__":
    main()
