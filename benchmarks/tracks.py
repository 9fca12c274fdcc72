"""Fit every arrival-time matrix of a folder and score it: ``python -m benchmarks.tracks FOLDER``.

Each CSV of FOLDER with the truth in columns x, y is fitted; receivers come from ``--receivers``,
or from FOLDER's receivers.csv or receivers_NN.csv where NN stands in the file's name. With
``--peer`` a results table (columns file, mean, ...) is printed beside. ``--simulate N`` makes N
canal tracks instead. Compilation is paid before, on the first file, and printed apart.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from scipy.stats import spearmanr

import maloc
from maloc._jax import jax
from maloc.errors import FitError
from maloc.infer._diagnostics import ess_bulk, r_hat

_TRUTH = ("x", "y", "top")


class Case(NamedTuple):
    """One arrival-time matrix with its true positions (P, 2)."""

    name: str
    toa: maloc.ArrivalTimes
    truth: np.ndarray


class Row(NamedTuple):
    """Scores of one fit; sampler columns are NaN for Laplace."""

    file: str
    mean: float
    median: float
    p95: float
    cover: float
    rho: float
    expected: float
    start: float
    theta: float
    sample: float
    ess_x: float
    ess_u: float
    r_hat: float
    divergent: float
    warned: str


def folder_cases(folder: Path, receivers: Path | None, interval, stable) -> Iterator[Case]:
    """Cases of a folder."""
    schedule = maloc.Schedule()
    if interval:
        schedule = maloc.Schedule("random", *interval)
    if stable:
        schedule = maloc.Schedule("stable", *stable)
    for path in sorted(folder.glob("*.csv")):
        head = path.read_text().split("\n", 1)[0].strip().split(",")
        if not {"x", "y"} <= set(head) or not any(c.startswith("toa_") for c in head):
            continue
        number = re.search(r"\d+", path.stem)
        own = folder / f"receivers_{number.group() if number else ''}.csv"
        table = receivers or (own if own.exists() else folder / "receivers.csv")
        toa = maloc.read_toa(
            path,
            maloc.read_receivers(table),
            ignore_columns=tuple(c for c in _TRUTH if c in head),
            schedule=schedule,
        )
        yield Case(path.stem, toa, pl.read_csv(path)["x", "y"].to_numpy())


def simulated_cases(n: int, seed: int) -> Iterator[Case]:
    """Canal tracks made here, missing 0 to .5, late 0 to .15 in turn."""
    from maloc.simulate import canal_toa

    cells = [(na, mp) for na in (0.0, 0.3, 0.5) for mp in (0.0, 0.06, 0.15)]
    for i in range(n):
        na, mp = cells[i % len(cells)]
        toa, truth = canal_toa(np.random.default_rng([seed, i]), p_na=na, p_mp=mp)
        name = f"sim{i:03d}_na{round(100 * na):02d}_mp{round(100 * mp):02d}"
        yield Case(name, toa, np.column_stack([truth.x, truth.y]))


def fit_case(case: Case, method: str, draws: int, seed: int, positions: str | None = None) -> Row:
    """Fit and score one case; pings that nobody heard count in no score."""
    nan = float("nan")
    fit = maloc.infer.laplace(maloc.models.toa_track, case.toa, positions=positions)
    sampler = (nan, nan, nan, nan, nan)
    if method != "laplace":
        key = jax.random.key(seed)
        fit = maloc.infer.nuts(key, fit, method=method, draws=draws, progress=False)
        spent = fit.seconds["sampling"]["cpu"] + fit.seconds["map"]["cpu"]
        places = fit.x[:, :, : fit.n_states, :2]
        worst = max(r_hat(places).max(), r_hat(fit.u).max())
        ess = np.median(ess_bulk(places)) / spent, ess_bulk(fit.u).min() / spent
        sampler = (spent, *ess, worst, float(fit.stats["diverging"].sum()))
    mean, covariance, low, high = fit.positions()
    sd = np.sqrt(np.einsum("tii->ti", covariance))
    truth = case.truth[case.toa.n_heard > 0]
    error = np.linalg.norm(mean - truth, axis=1)
    return Row(
        case.name,
        error.mean(),
        float(np.median(error)),
        float(np.quantile(error, 0.95)),
        float(np.mean((low <= truth) & (truth <= high))),
        float(spearmanr(np.hypot(*sd.T), error).statistic),  # pyright: ignore
        float(np.mean(np.hypot(*sd.T))),
        fit.seconds["initial"]["cpu"] + fit.seconds["prepare"]["cpu"],
        fit.seconds["parameters"]["cpu"],
        *sampler,
        "; ".join(fit.warnings),
    )


def _peer(path: Path | None) -> dict[str, float]:
    if path is None:
        return {}
    table = pl.read_csv(path)
    return dict(zip(table["file"].str.strip_suffix(".csv"), table["mean"], strict=True))


def print_rows(rows: list[Row], peer: dict[str, float], sampled: bool) -> None:
    """Print a row a file, then means by cell and over all."""
    head = f"{'file':24}{'mean':>7}{'median':>7}{'95 %':>7}{'cover':>7}{'rho':>6}"
    head += f"{'start s':>9}{'theta s':>8}" + (f"{'peer':>8}{'ratio':>7}" if peer else "")
    if sampled:
        head += f"{'sample s':>9}{'ESS x/s':>9}{'ESS u/s':>9}{'R-hat':>7}{'div':>4}"
    print(head)
    for r in rows:
        line = f"{r.file:24}{r.mean:>7.3f}{r.median:>7.3f}{r.p95:>7.2f}{r.cover:>7.3f}{r.rho:>6.2f}"
        line += f"{r.start:>9.2f}{r.theta:>8.2f}"
        if peer:
            other = peer.get(r.file, np.nan)
            line += f"{other:>8.3f}{r.mean / other:>7.3f}"
        if sampled:
            line += f"{r.sample:>9.1f}{r.ess_x:>9.0f}{r.ess_u:>9.0f}{r.r_hat:>7.3f}"
            line += f"{r.divergent:>4.0f}"
        print(line + (f"  ! {r.warned}" if r.warned else ""))
    cells: dict[str, list[Row]] = {}
    for r in rows:
        cells.setdefault(r.file.split("_", 1)[-1], []).append(r)
    print(f"\n{'cell':24}{'mean':>7}{'cover':>7}" + (f"{'peer':>8}{'ratio':>7}" if peer else ""))
    for name, part in [*sorted(cells.items()), ("all", rows)]:
        mean = np.mean([r.mean for r in part])
        line = f"{name:24}{mean:>7.3f}{np.mean([r.cover for r in part]):>7.3f}"
        if peer:
            other = np.mean([peer.get(r.file, np.nan) for r in part])
            line += f"{other:>8.3f}{mean / other:>7.3f}"
        print(line)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--receivers", type=Path)
    parser.add_argument("--peer", type=Path)
    parser.add_argument("--simulate", type=int, default=0)
    parser.add_argument("--method", choices=["laplace", "nuts", "hmc"], default="laplace")
    parser.add_argument("--positions", choices=["pmc"], help="start from single pings' positions")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--interval", type=float, nargs=2)
    parser.add_argument("--interval-stable", type=float, nargs=2)
    parser.add_argument("--first", type=int, default=None, help="only the first N files")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if given.simulate:
        cases = list(simulated_cases(given.simulate, given.seed))
    elif given.folder:
        found = folder_cases(given.folder, given.receivers, given.interval, given.interval_stable)
        cases = list(found)[: given.first]
    else:
        parser.error("give a FOLDER, or --simulate N")
    begin = time.perf_counter()
    fit_case(cases[0], given.method, 50, given.seed, given.positions)
    print(f"compile and first answer: {time.perf_counter() - begin:.1f} s wall\n")
    rows, failed = [], []
    for case in cases:
        try:
            rows.append(fit_case(case, given.method, given.draws, given.seed, given.positions))
        except FitError as error:
            failed.append(f"{case.name}: {error}")
    print_rows(rows, _peer(given.peer), given.method != "laplace")
    seconds = np.array([r.start + r.theta for r in rows])
    print(f"\nLaplace CPU s a track: median {np.median(seconds):.2f}, largest {seconds.max():.2f}")
    lost = [r.file for r in rows if r.mean > 3 * r.expected]
    warned = sum(bool(r.warned) for r in rows)
    print(
        f"{len(cases)} files, {len(failed)} failed, {len(lost)} lost (error > 3 x own sd), "
        f"{warned} with a warning"
    )
    for line in failed:
        print(line)


if __name__ == "__main__":
    main()
