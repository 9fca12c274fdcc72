"""ATLAS detections in an SQLite file: `TIME` in ms since 1970, `TAG` of 64 bits."""

from __future__ import annotations

import sqlite3

import numpy as np

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError
from maloc.readers._build import WHOLE_SECONDS, whole_seconds
from maloc.readers._clock import LATEST_S
from maloc.readers._files import File
from maloc.readers._how import How

__all__ = ["MAGIC", "NAME", "TITLE", "read_detections", "sniff"]

NAME = "atlas"
TITLE = "ATLAS SQLite (table DETECTIONS: BS, TAG, TIME, ...)"
MAGIC = b"SQLite format 3\x00"
_OPTIONAL = {"snr": "SNR", "signal": "RSSI", "gain": "GAIN", "samples_clk": "SAMPLES_CLK"}


def sniff(data: bytes) -> bool:
    """Say whether a file is an SQLite database."""
    return data.startswith(MAGIC)


def read_detections(file: File, how: How) -> Detections:
    """Read the DETECTIONS table; SAMPLES_CLK, a sample count, is kept but is not a time.

    Raises
    ------
    InputError
        If the file is no ATLAS database, or a row lacks BS, TAG or TIME.
    """
    name = file.name
    try:
        base = sqlite3.connect(":memory:")
        try:
            base.deserialize(file.data)
            there = {r[1].upper() for r in base.execute("PRAGMA table_info(DETECTIONS)")}
            lacking = [c for c in ("BS", "TAG", "TIME") if c not in there]
            if lacking:
                raise InputError(
                    "an SQLite file, but not ATLAS: it has no table DETECTIONS with BS, TAG, TIME",
                    file=name,
                )
            extra = {role: c for role, c in _OPTIONAL.items() if c in there}
            columns = ", ".join(["BS", "TAG", "TIME", *extra.values()])
            rows = base.execute(f"SELECT {columns} FROM DETECTIONS ORDER BY rowid").fetchall()
        finally:
            base.close()
    except (sqlite3.Error, OverflowError) as e:
        raise InputError(f"broken SQLite file ({e})", file=name) from None
    kept = list(dict.fromkeys(rows))
    time = [_ns(r[2], i, name) for i, r in enumerate(kept, 1)]
    for i, r in enumerate(kept, 1):
        if not (isinstance(r[0], int | str) and isinstance(r[1], int | str)):
            raise InputError("BS and TAG must be whole numbers", file=name, row=i)
    notes = []
    if gone := len(rows) - len(kept):
        notes.append(Note("info", f"{gone} exact duplicates removed", gone, name))
    if not kept:
        notes.append(Note("warning", "no detections", 0, name))
    times = np.array(time, dtype=np.int64)
    if whole_seconds(times):
        notes.append(Note("warning", WHOLE_SECONDS, len(kept), name))
    receiver, tag = (np.array([str(r[k]) for r in kept], dtype=str) for k in (0, 1))
    more = {
        role: np.array([np.nan if r[3 + k] is None else r[3 + k] for r in kept], dtype=object)
        for k, role in enumerate(extra)
    }
    more = {
        k: v.astype(float) if all(isinstance(x, int | float) for x in v) else v
        for k, v in more.items()
    }
    report = ReadReport("ATLAS SQLite", (name,), len(kept), tuple(notes))
    return Detections(times, receiver, tag, more, report)


def _ns(value: object, row: int, name: str) -> int:
    if isinstance(value, float) and np.isfinite(value):
        whole = int(value // 1)
        ns = whole * 1_000_000 + round((value - whole) * 1e6)
    elif isinstance(value, int):
        ns = value * 1_000_000
    else:
        raise InputError("TIME is not a number of ms", file=name, row=row, column="TIME")
    if not 0 <= ns < LATEST_S * NS:
        raise InputError("TIME is not in ms since 1970", file=name, row=row, column="TIME")
    return ns
