"""What the canal study fits: simulated tracks of its own, or a folder's files, with the truth."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes, Schedule
    from maloc.data.receivers import Receivers
    from maloc.simulate.canal import CanalDesign

__all__ = [
    "Address",
    "Case",
    "folder_cases",
    "own_cases",
    "read_case",
    "read_schedules",
    "simulate_case",
]

_TRUTH = ("x", "y", "top")  # columns of a file that are no arrivals: position, emission time


class Address(NamedTuple):
    """Where a case is: its name, its track's number, and its cell (-1: not said by its name)."""

    name: str
    track: int
    p_na: float
    p_mp: float


class Case(NamedTuple):
    """One arrival-time matrix with its truth: positions (P, 2) m, emission times (P,) s or NaN."""

    name: str
    toa: ArrivalTimes
    truth: np.ndarray
    emission: np.ndarray


def own_cases(
    tracks: int, missing: tuple[float, ...], late: tuple[float, ...]
) -> tuple[Address, ...]:
    """Every track at every pair of shares."""
    for share in (*missing, *late):
        if not 0 <= share < 1:
            raise InputError(f"{share} is no share of arrivals", mend="from 0 to below 1")
    return tuple(
        Address(f"track{i:03d}_na{100 * na:02.0f}_mp{100 * mp:02.0f}", i, na, mp)
        for i in range(tracks)
        for na in missing
        for mp in late
    )


def simulate_case(
    address: Address, seed: int, design: CanalDesign, receivers: Receivers | None
) -> Case:
    """One simulated case; a track's number and the seed are all that its chance depends on."""
    from maloc.simulate.canal import simulate_canal

    rng = np.random.default_rng([seed, address.track])
    toa, truth = simulate_canal(rng, address.p_na, address.p_mp, receivers, design)
    return Case(address.name, toa, np.column_stack([truth.x, truth.y]), truth.time)


def folder_cases(folder: Path) -> tuple[Address, ...]:
    """CSV files of a folder that have arrivals (toa_...) and the truth (x, y).

    Track and cell are read off names such as track01_na30_mp06.
    """
    found = []
    for i, path in enumerate(sorted(folder.glob("*.csv"))):
        head = path.read_text(encoding="utf-8").split("\n", 1)[0].strip().split(",")
        if not {"x", "y"} <= set(head) or not any(c.startswith("toa_") for c in head):
            continue
        shares = re.search(r"_na(\d+)_mp(\d+)", path.stem)
        na, mp = (int(s) / 100 for s in shares.groups()) if shares else (-1.0, -1.0)
        number = _number(path.stem)
        found.append(Address(path.stem, int(number) if number else i, na, mp))
    if not found:
        raise InputError(
            "has no CSV with columns x, y and toa_... (truth and arrival times)", file=folder
        )
    return tuple(found)


def read_case(address: Address, folder: Path, receivers: Path | None, schedule: Schedule) -> Case:
    """One file of a folder, with the array in ``receivers``.

    Without: that in the folder's receivers_NN.csv, NN the first number in the file's name, or in
    its receivers.csv.
    """
    import polars as pl

    import maloc

    path = folder / f"{address.name}.csv"
    own = folder / f"receivers_{_number(address.name)}.csv"
    table = receivers or (own if own.exists() else folder / "receivers.csv")
    whole = pl.read_csv(path)
    toa = maloc.read_toa(
        path,
        maloc.read_receivers(table),
        ignore_columns=tuple(c for c in _TRUTH if c in whole.columns),
        schedule=schedule,
    )
    emission = whole["top"].to_numpy() if "top" in whole.columns else np.full(len(toa), np.nan)
    return Case(address.name, toa, whole["x", "y"].to_numpy(), emission)


def read_schedules(path: Path) -> tuple[tuple[str, Schedule], ...]:
    """Burst intervals by file's stem: a CSV with columns file, kind (random, stable), lo, hi."""
    import polars as pl

    from maloc.data.arrivals import Schedule

    if not path.exists():
        raise InputError("does not exist", file=path)
    table = pl.read_csv(path)
    if missing := {"file", "kind", "lo", "hi"} - set(table.columns):
        raise InputError(f"has no column {sorted(missing)[0]}", file=path)
    rows = table.with_columns(pl.col("file").str.strip_suffix(".csv"))
    return tuple(
        (r["file"], Schedule(r["kind"], float(r["lo"]), float(r["hi"]))) for r in rows.to_dicts()
    )


def _number(stem: str) -> str:
    found = re.search(r"\d+", stem)
    return found.group() if found else ""
