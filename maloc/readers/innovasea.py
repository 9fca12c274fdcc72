"""Innovasea's detections with one header line: `Device Time (UTC)`, `Full ID`, `Serial Number`.

The detection records of a Fathom/VDAT log have the same columns and are read by the same rules.
"""

from __future__ import annotations

import numpy as np

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.data.report import Note
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table
from maloc.readers.vue import zone

__all__ = ["CORRECTED_TIMES", "DEVICE_TIMES", "NAME", "TITLE", "matches", "read"]

NAME = "innovasea"
TITLE = "Innovasea CSV (Device Time (UTC), Full ID, Serial Number, ...)"
CORRECTED_TIMES = "corrected times, "
DEVICE_TIMES = "device times, no clock correction was applied"
_EXTRA = {
    "model": "model",
    "channel": "channel",
    "detection_type": "detection_type",
    "transmitter_serial": "transmitter_serial",
    "signal": "signal_strength_db",
    "noise": "noise_db",
    "gain": "gain_db",
    "quality": "quality_score",
    "station": "station_name",
    "transmitter_type": "transmitter_type",
    "sensor_function": "sensor_function",
    "sensor": "sensor_value",
    "sensor_unit": "sensor_unit",
    "latitude": "latitude",
    "longitude": "longitude",
    "hdop": "gps_hdop",
}
_KNOWN = ("id", "raw_data", "time_offset_h", "time_correction_s", "time", "decoder",
          "sensor_precision", "definition_source", "record_type")  # fmt: skip


def _roles(table: Table) -> dict[str, int]:
    out = {}
    for k, name in reversed(list(enumerate(map(plain, table.columns)))):
        if name.startswith("device_time"):
            out["time"] = k
        elif name == "serial_number":
            out["receiver"] = k
        elif name == "full_id":
            out["tag"] = k
    return out


def matches(table: Table) -> bool:
    """Say whether the three columns are there."""
    return len(_roles(table)) == 3


def read(table: Table, how: How, title: str = "Innovasea CSV") -> Detections:
    """Read a table of detections.

    Parameters
    ----------
    table : Table
        The file, or the records of one type.
    how : How
        `clock`: "corrected" insists on the column `Time`, "device" and "linear" on the device's;
        the corrected time where there is one if None.
    title : str
        What the format is called in the report.

    Raises
    ------
    InputError
        If a time cannot be read, or a corrected time is insisted on and lacking.
    """
    roles = _roles(table)
    simple = [plain(c) for c in table.columns]
    table = _build.clean(table, list(roles.values()))
    device, _ = _clock.stamps(table, roles["time"], zone(table, roles["time"], how.tz))
    time, notes = _chosen(table, simple, device, how)
    wanted = {name: simple.index(c) for name, c in _EXTRA.items() if c in simple}
    extra = _build.extras(table, wanted)
    used = [k for k, c in enumerate(simple) if c in _KNOWN or c.endswith("_desc")]
    used += [*roles.values(), *wanted.values()]
    table = _build.merge_notes(table, *notes)
    receiver, tag = (Ids.of(table.text(roles[r])) for r in ("receiver", "tag"))
    return _build.detections(table, title, time, receiver, tag, extra, used)


def _chosen(
    table: Table, simple: list[str], device: np.ndarray, how: How
) -> tuple[np.ndarray, list[Note]]:
    """Return the times that are used, and what there is to say of them."""
    k = simple.index("time") if "time" in simple else None
    shift = _offset(table, simple)
    if k is None or not len(table):
        corrected, known = device, np.zeros(len(table), bool)
    else:
        corrected, known = _clock.stamps(table, k, "UTC")
        corrected = corrected - shift
    if how.clock in ("device", "linear"):
        n = int(known.sum())
        text = f"device times used as asked, {n} corrected ones left aside"
        return device, [table.note("info", text, n)] if n else []
    if how.clock == "corrected" and not known.all():
        raise table.error(
            "no corrected time (the log was made without time correction)",
            int(np.flatnonzero(~known)[0]),
            "Time",
            "leave --clock out, or let --clock linear correct it from the log's clock checks",
        )
    notes = []
    if known.any() and not known.all():
        n = int((~known).sum())
        text = (
            f"{n} of {len(known)} rows have no corrected time: device times are mixed in, which "
            "may be seconds off; --clock device or --clock linear treats all alike"
        )
        notes.append(table.note("warning", text, n, int(table.line[~known][0])))
    elif len(known) and not known.any():
        notes.append(table.note("info", DEVICE_TIMES, len(known)))
    elif len(known):
        moved = (corrected - device)[known] / NS
        text = f"{CORRECTED_TIMES}{moved.min():+.3g} to {moved.max():+.3g} s from the device's"
        notes.append(table.note("info", text, len(known)))
    if (moved := shift[known] != 0).any():
        hours = ", ".join(f"{h / 3600 / NS:+g}" for h in np.unique(shift[known]))
        text = f"'Time' was shifted by {hours} h when the log was made: taken back, to UTC"
        notes.append(table.note("info", text, int(moved.sum())))
    return np.where(known, corrected, device), notes


def _offset(table: Table, simple: list[str]) -> np.ndarray:
    """Hours (as ns) by which `Time` was shifted to a zone when the log was made."""
    if "time_offset_h" not in simple:
        return np.zeros(len(table), np.int64)
    hours = np.nan_to_num(table.numbers(simple.index("time_offset_h")))
    return np.rint(hours * 3600).astype(np.int64) * NS
