"""YAPS's model on this engine beside YAPS itself: ``python -m benchmarks.yaps FOLDER``.

Each arrival-time matrix of FOLDER with the truth in columns x, y (see `benchmarks.tracks`) is
fitted by ``maloc.models.yaps`` and Laplace; FOLDER's yaps_results.csv has what YAPS made of it
(columns file, mean, median in metres; user_s, its CPU seconds). Where both burst intervals are
given, files with "sbi" in their name have the stable one. A first fit of each shape, which pays
for compilation, is not timed.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

import maloc
from benchmarks.tracks import Case, folder_cases
from maloc.model_data import to_model_data

_LOST = 1.5  # times the error of the same model's optimum here: YAPS has found another one


class Row(NamedTuple):
    """Errors (m) and CPU seconds of a file, ours and YAPS's."""

    file: str
    mean: float
    median: float
    cpu: float
    yaps_mean: float
    yaps_median: float
    yaps_cpu: float
    warned: str

    @property
    def lost(self) -> bool:
        """Whether YAPS ended somewhere else."""
        return self.yaps_mean > _LOST * self.mean


def cases(folder: Path, receivers: Path | None, interval, stable) -> Iterator[Case]:
    """Cases of a folder, each with its kind of burst interval."""
    steady = folder_cases(folder, receivers, None, stable)
    random = folder_cases(folder, receivers, interval, None)
    for a, b in zip(steady, random, strict=True):
        yield a if stable and ("sbi" in a.name or not interval) else b


def fit_case(case: Case, peer: dict) -> Row:
    """Fit and score one case; pings that nobody heard count in no score."""
    begin = time.process_time()
    fit = maloc.infer.laplace(maloc.models.yaps, case.toa)
    cpu = time.process_time() - begin
    error = np.linalg.norm(fit.positions()[0] - case.truth[case.toa.n_heard > 0], axis=1)
    theirs = peer["mean"], peer["median"], peer["user_s"]
    warned = "; ".join(fit.warnings)
    return Row(case.name, float(error.mean()), float(np.median(error)), cpu, *theirs, warned)


def _numbers(rows: list[Row]) -> str:
    mean = np.mean([r[1:7] for r in rows], axis=0)
    star = "*" if any(r.lost for r in rows) else " "
    return (
        f"{mean[0]:>8.3f}{mean[3]:>8.3f}{mean[0] / mean[3]:>8.3f}{star}"
        f"{mean[1]:>8.3f}{mean[4]:>8.3f}{mean[2]:>8.2f}{mean[5]:>8.1f}{mean[5] / mean[2]:>8.1f}x"
    )


def print_rows(rows: list[Row]) -> None:
    """Print a row a file, a row a cell, and all."""
    cells: dict[str, list[Row]] = {}
    for row in rows:
        cells.setdefault(row.file.split("_", 1)[-1], []).append(row)
    head = f"{'mean':>8}{'YAPS':>8}{'ratio':>8} {'median':>8}{'YAPS':>8}"
    head += f"{'CPU s':>8}{'YAPS':>8}{'faster':>9}"
    print(f"{'file':24}{head}")
    for row in rows:
        print(f"{row.file:24}{_numbers([row])}" + (f"  ! {row.warned}" if row.warned else ""))
    print(f"\n{'cell':24}{head}")
    for name, part in sorted(cells.items()):
        print(f"{name:24}{_numbers(part)}")
    print(f"{'all':24}{_numbers(rows)}")
    found = [row for row in rows if not row.lost]
    if found and len(found) < len(rows):
        print(f"{'without *':24}{_numbers(found)}")
        print(f"\n* {len(rows) - len(found)} file(s) on which YAPS's error is over {_LOST} times")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--receivers", type=Path)
    parser.add_argument("--peer", type=Path, help="default: FOLDER/yaps_results.csv")
    parser.add_argument("--interval", type=float, nargs=2, metavar=("MIN", "MAX"))
    parser.add_argument("--interval-stable", type=float, nargs=2, metavar=("MEAN", "SD"))
    given = parser.parse_args()
    table = pl.read_csv(given.peer or given.folder / "yaps_results.csv")
    peer = {row["file"].removesuffix(".csv"): row for row in table.iter_rows(named=True)}
    rows, compiled, spent = [], set(), 0.0
    for case in cases(given.folder, given.receivers, given.interval, given.interval_stable):
        data = to_model_data(case.toa)
        if (shape := (data.schedule, data.range.shape)) not in compiled:
            compiled.add(shape)
            spent += fit_case(case, peer[case.name]).cpu
        rows.append(fit_case(case, peer[case.name]))
    if not rows:
        parser.error(f"{given.folder} has no arrival times with a truth")
    print_rows(rows)
    print(f"\ncompile and first answers, {len(compiled)} shape(s): {spent:.1f} CPU s apart")


if __name__ == "__main__":
    main()
