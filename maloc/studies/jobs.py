"""Jobs of a simulation study: in processes of one thread each, one Parquet file a job, resumable.

A file that is there is not made again; processes have one thread, so that CPU seconds can be
compared.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from maloc.errors import InputError
from maloc.runs.threads import one_thread

if TYPE_CHECKING:
    import polars as pl

__all__ = ["claim", "put", "run_jobs"]


def claim(out: Path, settings: str) -> None:
    """Make the folder, or see that an earlier run in it was of the same study."""
    out.mkdir(parents=True, exist_ok=True)
    note = out / "study.json"
    if note.exists():
        if note.read_text() != settings:
            raise InputError(
                "holds results of other settings", file=note, mend="give another --out"
            )
    elif any(out.iterdir()):
        raise InputError(
            "is neither empty nor a study's folder", file=out, mend="give another --out"
        )
    else:
        note.write_text(settings)


def put(found: pl.DataFrame, path: Path) -> None:
    """Put a job's file in place whole or not at all."""
    beside = path.with_suffix(f".{os.getpid()}.part")
    found.write_parquet(beside)
    beside.replace(path)


def run_jobs(
    work: Callable[..., str],
    jobs: Sequence[tuple],
    files: Sequence[Path],
    *,
    workers: int = 1,
    quiet: bool = False,
) -> pl.DataFrame:
    """Do the jobs whose file is not there yet; return what all files hold.

    Parameters
    ----------
    work : callable
        Called in a process with a job's arguments; writes its file and returns what went wrong,
        which is warned of, or nothing.
    jobs : sequence of tuple
    files : sequence of Path
        One a job.
    workers : int
        Processes, of one thread each.
    quiet : bool
        No progress bar.
    """
    import multiprocessing
    import warnings
    from concurrent.futures import ProcessPoolExecutor, as_completed

    import polars as pl
    from tqdm import tqdm

    from maloc.errors import MalocWarning

    todo = [job for job, file in zip(jobs, files, strict=True) if not file.exists()]
    spawn = multiprocessing.get_context("spawn")
    with (
        one_thread(),
        ProcessPoolExecutor(min(workers, max(len(todo), 1)), mp_context=spawn) as pool,
        tqdm(total=len(jobs), initial=len(jobs) - len(todo), disable=quiet, unit="fit") as bar,
    ):
        running = [pool.submit(work, *job) for job in todo]
        try:
            for done in as_completed(running):
                if problem := done.result():
                    warnings.warn(problem, MalocWarning, stacklevel=3)
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return pl.concat([pl.read_parquet(file) for file in files], how="diagonal_relaxed")
