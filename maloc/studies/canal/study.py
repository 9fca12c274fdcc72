"""The thesis's canal study: cases times methods, each one job of `maloc.studies.jobs`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maloc.errors import FitError
from maloc.evaluate.scores import centre_of, ping_scores, track_scores
from maloc.studies.canal.cases import Address, Case, read_case, simulate_case
from maloc.studies.canal.methods import check_methods, timed
from maloc.studies.canal.settings import Settings
from maloc.studies.jobs import claim, put, run_jobs

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Settings", "case_of", "fit_job", "run_canal"]


def case_of(settings: Settings, address: Address) -> Case:
    """Read or simulate a case."""
    if settings.folder is not None:
        schedule = dict(settings.schedules).get(address.name, settings.schedule)
        return read_case(address, settings.folder, settings.receivers, schedule)
    import maloc

    table = settings.receivers
    receivers = None if table is None else maloc.read_receivers(table)
    return simulate_case(address, settings.seed, settings.design, receivers)


_LAST: dict[tuple[str, Address], Case] = {}


def _case(settings: Settings, address: Address) -> Case:
    """The same object for every method of a case, so that they share what they have in common."""
    key = settings.as_text(), address  # settings hold NaN, which is not even equal to itself
    if key not in _LAST:
        _LAST.clear()
        _LAST[key] = case_of(settings, address)
    return _LAST[key]


def fit_job(settings: Settings, address: Address, method: str) -> pl.DataFrame:
    """Fit one case by one method and score it.

    Returns
    -------
    polars.DataFrame
        Rows of sections "position" (a ping each: ping, n_heard, x, y, the scores of
        `maloc.evaluate.scores.ping_scores`), "run" (name, value: cpu, seconds; and the scores of
        the heard pings' track), "warning" (name).
    """
    import polars as pl

    case = _case(settings, address)
    found = timed(method, case, settings)
    n_heard = case.toa.n_heard
    parts = found.position, found.sd, found.low, found.high
    scores = ping_scores(case.truth, *parts, centre_of(case.toa.receivers.xy))
    keep = np.isfinite(scores["error"]) & (n_heard > 0)
    whole = track_scores(
        case.truth[keep], found.position[keep], scores["error"][keep], scores["expected"][keep]
    )
    run = {"cpu": found.cpu, **whole}
    columns = {"ping": case.toa.ping, "n_heard": n_heard, "x": found.position[:, 0]}
    tables = [
        _rows("position", columns | {"y": found.position[:, 1]} | scores),
        _rows("run", {"name": list(run), "value": list(run.values())}),
    ]
    if found.warnings:
        tables.append(_rows("warning", {"name": list(found.warnings)}))
    return _about(pl.concat(tables, how="diagonal_relaxed"), address, method)


def _rows(section: str, columns: dict) -> pl.DataFrame:
    import polars as pl

    return pl.DataFrame({**columns}).with_columns(pl.lit(section).alias("section"))


def _about(table: pl.DataFrame, address: Address, method: str) -> pl.DataFrame:
    import polars as pl

    names = ("case", *address._fields[1:])
    marks = [pl.lit(value).alias(name) for name, value in zip(names, address, strict=True)]
    return table.select(*marks, pl.lit(method).alias("method"), pl.all())


def _job(settings: Settings, address: Address, method: str, out: Path) -> str:
    """Do one job and put its file in place; return what went wrong, or nothing."""
    problem = ""
    try:
        found = fit_job(settings, address, method)
    except FitError as error:
        problem = f"{address.name}, {method}: {error}"
        found = _about(_rows("failed", {"name": [str(error)]}), address, method)
    put(found, _job_file(out, address, method))
    return problem


def _job_file(out: Path, address: Address, method: str) -> Path:
    return out / f"{address.name}_{method}.parquet"


def run_canal(
    settings: Settings,
    cases: Sequence[Address],
    methods: tuple[str, ...],
    out: Path,
    *,
    workers: int = 1,
    quiet: bool = False,
) -> pl.DataFrame:
    """Do what is not done yet, and return the results of all cases and methods asked for.

    Parameters
    ----------
    settings : Settings
    cases : sequence of Address
        `maloc.studies.canal.cases.own_cases` or `folder_cases`.
    methods : tuple of str
        Some of `maloc.studies.canal.methods.METHODS`.
    out : Path
        Folder of the results; an earlier run with the same settings is gone on with.
    workers : int
        Processes, of one thread each.
    quiet : bool
        No progress bar.

    Raises
    ------
    InputError
        If a method is unknown, a file cannot be read, or the folder holds something else.
    """
    check_methods(methods)
    case_of(settings, cases[0])  # what cannot be read is said before anything is begun
    claim(out, settings.as_text())
    jobs = [(settings, c, m, out) for c in cases for m in methods]
    files = [_job_file(out, c, m) for c in cases for m in methods]
    return run_jobs(_job, jobs, files, workers=workers, quiet=quiet)
