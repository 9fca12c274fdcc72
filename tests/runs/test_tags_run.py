"""Jobs of independent tags: failures, kill -9, Dask; and what `maloc track` makes of them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import polars as pl
import pytest

from maloc.errors import FitError
from maloc.runs.tags import Job, key_of, run_each
from tests.cli.test_cli import detections_csv, engine, receivers_csv, run  # noqa: F401


def square(log: Path, n: int) -> dict[str, bytes]:
    """A job: notes that it was done; fails for 3, breaks for 4."""
    with log.open("a") as file:
        file.write(f"{n}\n")
    if n == 3:
        raise FitError("three cannot be fitted")
    if n == 4:
        raise ZeroDivisionError("four breaks")
    threads = os.environ.get("OMP_NUM_THREADS"), os.environ.get("MALLOC_TRIM_THRESHOLD_")
    record = {"n": n, "environment": threads}
    return {"value.txt": str(n * n).encode(), "record.json": json.dumps(record).encode()}


def jobs(log: Path, numbers, version=0):
    return [Job(f"T{n}", key_of(n, version), square, (log, n)) for n in numbers]


def test_each_job_is_done_once_and_failures_stop_no_other(tmp_path):
    log, folder = tmp_path / "log", tmp_path / "kept"
    done = run_each(jobs(log, [1, 3, 4, 5]), folder, quiet=True)
    assert [d.failed for d in done] == [
        None, "three cannot be fitted", "ZeroDivisionError: four breaks", None,
    ]  # fmt: skip
    assert [(d.folder / "value.txt").read_text() for d in done if not d.failed] == ["1", "25"]
    run_each(jobs(log, [1, 3, 4, 5, 6]), folder, quiet=True)
    assert log.read_text().split() == ["1", "3", "4", "5", "6"]
    run_each(jobs(log, [1], version=1), folder, quiet=True)  # something else was asked
    assert log.read_text().split()[-1] == "1"


def test_kill_9_and_go_on(tmp_path):
    log, folder = tmp_path / "log", tmp_path / "kept"
    code = f"""
        import sys, time
        from pathlib import Path
        sys.path[:0] = {[str(p) for p in Path(__file__).parents[:3]]!r}
        from test_tags_run import Job, key_of, run_each, square
        def slow(log, n):
            time.sleep(0.2)
            return square(log, n)
        log = Path({str(log)!r})
        made = [Job(str(n), key_of(n, 0), slow, (log, n)) for n in range(10, 18)]
        run_each(made, Path({str(folder)!r}), quiet=True)
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)])
    while len(list(folder.glob("*/record.json"))) < 3:
        assert child.poll() is None
        time.sleep(0.02)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    ready = len([p for p in folder.glob("*/record.json") if not p.parent.name.startswith(".")])
    done = run_each(jobs(log, range(10, 18)), folder, quiet=True)
    assert [(d.folder / "value.txt").read_text() for d in done] == [
        str(n * n) for n in range(10, 18)
    ]
    times = [log.read_text().split().count(str(n)) for n in range(10, 18)]
    assert times[:ready] == [1] * ready and sum(times) in (8, 9)  # one may have been under way


def test_dask_does_the_same(tmp_path):
    pytest.importorskip("distributed")
    log, folder = tmp_path / "log", tmp_path / "kept"
    run_each(jobs(log, [1]), folder, quiet=True)
    done = run_each(jobs(log, [1, 2, 3, 5, 6, 7, 8, 9]), folder, workers=2, quiet=True)
    assert [d.record.get("n") for d in done] == [1, 2, None, 5, 6, 7, 8, 9]
    assert done[2].failed == "three cannot be fitted"
    assert sorted(log.read_text().split()) == ["1", "2", "3", "5", "6", "7", "8", "9"]
    # one thread, and memory kept: Dask's own setting doubles the time of a fit
    assert [d.record["environment"] for d in done[-4:]] == [["1", None]] * 4


# -- maloc track ----------------------------------------------------------------------------------

TAGS = ("A69-1-11", "A69-1-12", "A69-1-13")


@pytest.fixture
def command(tmp_path):
    found = detections_csv(tmp_path, TAGS)
    args = ["track", found, "--receivers", receivers_csv(tmp_path), "--sound-speed", "1500"]
    return [*args, "--tag", "all", "--out", tmp_path / "out", "--quiet"]


def wrapped(monkeypatch, tag, problem):
    """The engine with a problem at one tag, once."""
    from maloc import infer

    usual, left = infer.laplace, [problem]

    def laplace(model, toa, **how):
        if toa.tag == tag and left:
            raise left.pop()
        return usual(model, toa, **how)

    monkeypatch.setattr(infer, "laplace", laplace)


def test_one_tag_that_fails_loses_no_other(tmp_path, engine, monkeypatch, command):  # noqa: F811
    wrapped(monkeypatch, TAGS[1], FitError("the mode was not found"))
    result = run(*command)
    assert result.exit_code == 1
    assert "1 of 3 tags failed (A69-1-12: the mode was not found)" in result.stderr
    out = tmp_path / "out"
    table = pl.read_csv(out / "tags.csv")
    assert table["status"].to_list() == ["done", "failed", "done"]
    assert table["why"].to_list() == [None, "the mode was not found", None]
    assert pl.read_csv(out / "track.csv")["tag"].unique().sort().to_list() == [TAGS[0], TAGS[2]]
    assert json.loads((out / "summary.json").read_text())["failed_tags"] == {
        TAGS[1]: "the mode was not found"
    }
    assert not (tmp_path / ".out.tags").exists()


def test_an_interrupted_run_goes_on(tmp_path, engine, monkeypatch, command):  # noqa: F811
    wrapped(monkeypatch, TAGS[2], KeyboardInterrupt())
    result = run(*command)
    assert result.exit_code != 0 and "2 tags are done and kept" in result.stderr
    assert not (tmp_path / "out").exists() and len(engine) == 2
    assert run(*command).exit_code == 0
    assert len(engine) == 3
    again = [*command[:-2], tmp_path / "whole", "--quiet"]
    assert run(*again).exit_code == 0
    for name in ("track.csv", "arrivals.csv", "parameters.csv", "posterior_A69-1-13.nc"):
        assert (tmp_path / "out" / name).stat().st_size
        if name.endswith("csv"):
            one, other = (tmp_path / f / name for f in ("out", "whole"))
            assert one.read_bytes() == other.read_bytes()


def test_workers_go_with_tags_that_are_fitted_one_by_one(tmp_path, engine, command):  # noqa: F811
    more = ["--model", "joint", "--workers", 2, "--interval", 20, 40]
    result = run(*command, *more)
    assert result.exit_code == 2 and "leave --workers out" in result.stderr


def test_workers_keep_their_memory_after_a_cluster_of_somebody_elses(monkeypatch):
    """What Dask leaves in a process that had a cluster before is not handed on; a user's own is."""
    from maloc.runs.threads import one_thread

    name = "MALLOC_TRIM_THRESHOLD_"
    for value, inside in (("65536", None), ("1000000", "1000000")):
        monkeypatch.setenv(name, value)
        with one_thread():
            assert os.environ.get(name) == inside
        assert os.environ[name] == value
    monkeypatch.delenv(name)
    with one_thread():
        assert name not in os.environ
    assert name not in os.environ
