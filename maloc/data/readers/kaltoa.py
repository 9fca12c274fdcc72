"""kaltoa's detection tables: `timestamp, detect_id, type`, one file a receiver, zone not in it."""

from __future__ import annotations

from pathlib import PurePath

import polars as pl

from maloc.data.detections import Detections
from maloc.data.readers import _build, _clock
from maloc.data.readers._columns import plain
from maloc.data.readers._text import Table

__all__ = ["NAME", "TITLE", "matches", "read"]

NAME = "kaltoa"
TITLE = "kaltoa table (timestamp, detect_id, type; one file a receiver)"


def matches(table: Table) -> bool:
    """Say whether the header is kaltoa's."""
    return {"timestamp", "detect_id"} <= {plain(c) for c in table.columns}


def read(table: Table, tz: str | None = None) -> Detections:
    """Read a kaltoa table; the receiver is the file's name without its ending.

    Raises
    ------
    InputError
        If `tz` is not given: the table does not say its zone (kaltoa's own example is CET).
    """
    simple = [plain(c) for c in table.columns]
    when, tag = simple.index("timestamp"), simple.index("detect_id")
    table = _build.clean(table, [when, tag])
    receiver = PurePath(table.file).name.split(".")[0] or "receiver"
    table = _build.merge_notes(
        table, table.note("info", f"the table names no receiver: '{receiver}' from the file's name")
    )
    time, _ = _clock.stamps(table, when, tz)
    extra = _build.extras(table, {"type": simple.index("type")} if "type" in simple else {})
    names = pl.Series([receiver] * len(table), dtype=pl.String)
    return _build.detections(table, "kaltoa table", time, names, table.text(tag), extra)
