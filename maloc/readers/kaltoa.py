"""kaltoa's detection tables: `timestamp, detect_id, type`, one file a receiver, zone not in it."""

from __future__ import annotations

from pathlib import PurePath

import numpy as np

from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["NAME", "TITLE", "matches", "read"]

NAME = "kaltoa"
TITLE = "kaltoa table (timestamp, detect_id, type; one file a receiver)"


def matches(table: Table) -> bool:
    """Say whether the header is kaltoa's."""
    return {"timestamp", "detect_id"} <= {plain(c) for c in table.columns}


def read(table: Table, how: How) -> Detections:
    """Read a kaltoa table; the receiver is the file's name without its ending.

    Raises
    ------
    InputError
        If `how.tz` is not given: the table does not say its zone (kaltoa's own example is CET).
    """
    simple = [plain(c) for c in table.columns]
    when, tag = simple.index("timestamp"), simple.index("detect_id")
    table = _build.clean(table, [when, tag])
    receiver = PurePath(table.file).name.split(".")[0] or "receiver"
    table = _build.merge_notes(
        table, table.note("info", f"the table names no receiver: '{receiver}' from the file's name")
    )
    time, _ = _clock.stamps(table, when, how.tz)
    extra = _build.extras(table, {"type": simple.index("type")} if "type" in simple else {})
    name = _build.Ids([receiver], np.zeros(len(table), np.int64))
    used = [when, tag, *(simple.index(c) for c in ("type",) if c in simple)]
    ids = _build.Ids.of(table.text(tag))
    return _build.detections(table, "kaltoa table", time, name, ids, extra, used)
