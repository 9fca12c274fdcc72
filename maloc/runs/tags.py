"""Independent tags one after the other, or in parallel processes through Dask; resumable.

What a tag gives is a handful of files, made in whatever process and put in a folder of its own by
this one, whole or not at all, with a key of all that they depend on. A run that was stopped finds
them again; memory does not grow with the number of tags.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from maloc.errors import FitError, InputError, needs
from maloc.runs.threads import one_thread

__all__ = ["Done", "Job", "key_of", "run_each"]

RECORD = "record.json"
_AHEAD = 2  # jobs a worker that are handed out at a time


class Job(NamedTuple):
    """A tag's work: called with ``args`` it returns its files (name -> content)."""

    name: str
    key: str
    work: Callable[..., dict[str, bytes]]
    args: tuple


class Done(NamedTuple):
    """What there is of a tag: its name, its folder, what was recorded (a failure as "failed")."""

    name: str
    folder: Path
    record: dict[str, Any]

    @property
    def failed(self) -> str | None:
        """Why there is no result, or None."""
        return self.record.get("failed")


def key_of(*parts: Any) -> str:
    """Digest of texts, numbers and arrays: the same in every process."""
    digest = hashlib.sha256()
    for part in parts:
        content = part.tobytes() if hasattr(part, "tobytes") else repr(part).encode()
        digest.update(content + b"\0")
    return digest.hexdigest()


def run_each(
    jobs: list[Job],
    folder: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    quiet: bool = False,
) -> list[Done]:
    """Do the jobs that are not done yet; what each gave, in order.

    Parameters
    ----------
    jobs : list of Job
    folder : Path
        Holds a folder a job; made where it is missing, and kept.
    workers : int
        Processes of one thread each; with one, all is done here, without Dask.
    scheduler : str, optional
        Address of a Dask scheduler, in place of processes on this machine.
    quiet : bool
        No progress bar.

    Returns
    -------
    list of Done
        A job that failed is among them, with the reason; its failure stops no other.

    Raises
    ------
    InputError
        If Dask is needed and missing, or the scheduler does not answer.
    """
    from tqdm import tqdm

    places = [folder / job.key[:24] for job in jobs]
    todo = [i for i, place in enumerate(places) if _record(place, jobs[i].key) is None]
    total = len(jobs)
    show = not quiet and total > 1
    with tqdm(
        total=total, initial=total - len(todo), disable=not show, unit="tag", desc="tags"
    ) as bar:
        how = workers, scheduler, total == 1 and scheduler is None
        for i, files in _results([jobs[i] for i in todo], todo, *how):
            _put(files, places[i], jobs[i].key)
            bar.update()
    return [
        Done(job.name, place, _record(place, job.key) or {})
        for job, place in zip(jobs, places, strict=True)
    ]


def _record(place: Path, key: str) -> dict[str, Any] | None:
    file = place / RECORD
    if not file.exists():
        return None
    record = json.loads(file.read_text("utf-8"))
    return record if record["key"] == key else None


def _put(files: Mapping[str, bytes], place: Path, key: str) -> None:
    """Write a job's files into its folder, which appears whole or not at all."""
    place.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=".part.", dir=place.parent))
    try:
        for name, content in files.items():
            (work / name).write_bytes(content)
        record = json.loads(files.get(RECORD, b"{}")) | {"key": key}
        (work / RECORD).write_text(json.dumps(record), "utf-8")
        if place.exists():
            shutil.rmtree(place)
        os.rename(work, place)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def _tried(work: Callable[..., dict[str, bytes]], args: tuple) -> dict[str, bytes]:
    """A job's files, or a record of why there are none."""
    try:
        return work(*args)
    except (FitError, InputError) as problem:
        return _failure(str(problem))
    except Exception as problem:  # whatever it is, other tags go on
        return _failure(f"{type(problem).__name__}: {problem}")


def _failure(why: str) -> dict[str, bytes]:
    return {RECORD: json.dumps({"failed": " ".join(why.split())}).encode()}


def _results(
    jobs: list[Job], number: list[int], workers: int, scheduler: str | None, alone: bool
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Number and files of each job as it is done; of one alone whatever happens is raised."""
    if alone:
        for i, job in zip(number, jobs, strict=True):
            yield i, job.work(*job.args)
        return
    if scheduler is None and (workers == 1 or len(jobs) < 2):
        for i, job in zip(number, jobs, strict=True):
            yield i, _tried(job.work, job.args)
        return
    with _client(min(workers, len(jobs)), scheduler) as client:
        from distributed import as_completed

        waiting = list(zip(number, jobs, strict=True))[::-1]
        running: dict[Any, int] = {}

        def submit():
            i, job = waiting.pop()
            running[future := client.submit(_tried, job.work, job.args, pure=False)] = i
            return future

        slots = max(len(client.nthreads()), workers) * _AHEAD
        queue = as_completed([submit() for _ in range(min(slots, len(waiting)))])
        for future in queue:
            if waiting:
                queue.add(submit())
            problem = future.exception()  # a worker that died
            files = future.result() if problem is None else _failure(f"worker lost: {problem}")
            yield running.pop(future), files


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Dask client of a scheduler's address, or of processes on this machine."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as problem:
        without = {"otherwise": "leave --workers and --scheduler out"}
        raise needs("--workers", "Dask", "parallel", problem, **without) from None
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=30)
        except (OSError, TimeoutError, ValueError) as problem:
            raise InputError(f"no Dask scheduler answers at {scheduler} ({problem})") from problem
        with client:
            yield client
        return
    import dask.config

    how: dict[str, Any] = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "dashboard_address": None,
    }
    # Dask has its workers give memory back at once; to ask for it again doubles a fit's time
    with (
        one_thread(),
        dask.config.set({"distributed.nanny.pre-spawn-environ": {}}),
        LocalCluster(**how) as cluster,
        Client(cluster) as client,
    ):
        yield client
