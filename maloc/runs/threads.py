"""The environment of a process of one thread, which libraries read when they are first imported."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["ONE_THREAD", "one_thread"]

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "POLARS_MAX_THREADS": "1",
    "NPROC": "1",  # the pool of XLA, whose flags leave it one thread a core
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
}
# Dask's for its workers: memory is given back at once, and asked for again at twice the time
_TRIM, _DASKS = "MALLOC_TRIM_THRESHOLD_", "65536"


@contextmanager
def one_thread() -> Iterator[None]:
    """Let processes that start meanwhile have one thread each, and keep their memory."""
    before = {name: os.environ.get(name) for name in (*ONE_THREAD, _TRIM)}
    if before[_TRIM] == _DASKS:  # left by a cluster that this process had before
        del os.environ[_TRIM]
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
