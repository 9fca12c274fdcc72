"""VUE's export of receiver events: PC time, initialisation, temperature, daily counts."""

from __future__ import annotations

import numpy as np

from maloc.data._time import NS, iso
from maloc.data.events import ClockReferences, Events
from maloc.data.report import Note, ReadReport
from maloc.readers import _build, _clock, vue
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["NAME", "TITLE", "matches", "read"]

NAME = "vue-events"
TITLE = "VUE receiver events CSV (clock checks and diagnostics, no detections)"
ANOTHER_ZONE_S = 900.0  # clocks further apart than this are in different zones, or not set
_SETTING_S = 120.0  # an initialisation and its PC Time are this near one another


def matches(table: Table) -> bool:
    """Say whether the header is that of VUE's receiver events export."""
    simple = {plain(c) for c in table.columns}
    return {"receiver", "description", "data"} <= simple and any(
        c.startswith("date_and_time") for c in simple
    )


def read(table: Table, how: How) -> Events:
    """Read receiver events; comparisons with the PC's clock become `references`.

    Parameters
    ----------
    table : Table
        The file.
    how : How
        `tz`: zone of a local-time export.

    Raises
    ------
    InputError
        If a time cannot be read, or the column is local time and no zone is given.
    """
    simple = [plain(c) for c in table.columns]
    when = next(k for k, c in enumerate(simple) if c.startswith("date_and_time"))
    who, what, data = (simple.index(c) for c in ("receiver", "description", "data"))
    table = _build.clean(table, [when, who, what])
    time, _ = _clock.stamps(table, when, vue.zone(table, when, how.tz))
    receiver = _build.Ids.of(table.text(who)).to(vue.serial_number).array()
    kind = _build.Ids.of(table.text(what)).array()
    value = table.text(data).fill_null("")
    unit = table.text(simple.index("units")).fill_null("") if "units" in simple else None
    units = np.asarray([""] * len(table) if unit is None else unit.to_list(), str)
    references, notes = _references(table, data, time, receiver, kind)
    report = ReadReport(TITLE, (table.file,), len(table), (*table.notes, *notes))
    text = np.asarray(value.to_list(), str)
    return Events(time, receiver, kind, text, units, references, report)


def _references(
    table: Table, data: int, time: np.ndarray, receiver: np.ndarray, kind: np.ndarray
) -> tuple[ClockReferences, list[Note]]:
    is_pc = np.char.lower(kind) == "pc time"
    begun = np.char.lower(kind) == "initialization"
    external = np.zeros(len(time), np.int64)
    if is_pc.any():
        external[is_pc], known = _clock.stamps(table.rows(is_pc), data, "UTC")
        is_pc[np.flatnonzero(is_pc)[~known]] = False
    behind = np.where(is_pc, (external - time) / NS, 0.0)
    notes = []
    far = is_pc & (np.abs(behind) > ANOTHER_ZONE_S)
    if far.any():
        i = int(np.flatnonzero(far)[0])
        text = (
            f"{int(far.sum())} comparisons with the PC's clock are {behind[i] / 3600:+.2g} h off "
            f"(first: {receiver[i]} at {iso(int(time[i]), 0)}): the PC was in another zone, or "
            "the receiver's clock was never set; not used"
        )
        notes.append(table.note("warning", text, int(far.sum()), int(table.line[i])))
        is_pc &= ~far
    rows, fresh = np.flatnonzero(is_pc), np.zeros(int(is_pc.sum()), bool)
    alone = []
    for i in np.flatnonzero(begun):
        near = (receiver[rows] == receiver[i]) & (np.abs(time[rows] - time[i]) < _SETTING_S * NS)
        fresh |= near
        if not near.any():
            alone.append(i)
    rows = np.concatenate([rows, np.array(alone, np.int64)]).astype(np.int64)
    fresh = np.concatenate([fresh, np.ones(len(alone), bool)])
    source = np.where(fresh, "initialisation", "PC time")
    found = ClockReferences(receiver[rows], time[rows], behind[rows], source, fresh)
    return found, notes
