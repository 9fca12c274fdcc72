"""Times as int64 ns since 1970 UTC: writing them, never through a float."""

from __future__ import annotations

import numpy as np

NS = 1_000_000_000  # nanoseconds in a second
OPEN_START = int(np.iinfo(np.int64).min)
OPEN_END = int(np.iinfo(np.int64).max)


def iso(ns: int, digits: int = 3) -> str:
    """Return "2021-06-01 10:00:00.217" for ns since 1970; more digits where they are needed."""
    if ns == OPEN_START or ns == OPEN_END:
        return "open"
    whole, fraction = divmod(int(ns), NS)
    tail = f"{fraction:09d}"
    keep = max(digits, len(tail.rstrip("0")))
    stamp = str(np.datetime64(whole, "s")).replace("T", " ")
    return f"{stamp}.{tail[:keep]}" if keep else stamp


def duration(seconds: float) -> str:
    """Return a length of time in words: "3.2 s", "45 min", "7.5 h", "12 days"."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if abs(seconds) >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"
