"""Innovasea VUE detections CSV."""

from __future__ import annotations

import re

import numpy as np

from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["NAME", "TITLE", "matches", "read", "serial_number", "zone"]

NAME = "vue"
TITLE = "VUE detections CSV (Date and Time (UTC), Receiver, Transmitter, ...)"
_EXTRA = {
    "transmitter_name": "transmitter_name",
    "transmitter_serial": "transmitter_serial",
    "sensor": "sensor_value",
    "sensor_unit": "sensor_unit",
    "station": "station_name",
    "transmitter_type": "transmitter_type",
    "signal": "signal_strength_db",
    "noise": "noise_db",
    "quality": "quality_score",
}


def _roles(columns: tuple[str, ...]) -> dict[str, int]:
    simple = [plain(c) for c in columns]
    out = {}
    for k, name in reversed(list(enumerate(simple))):
        if name.startswith("date_and_time"):
            out["time"] = k
        elif name == "receiver":
            out["receiver"] = k
        elif name == "transmitter":
            out["tag"] = k
    return out


def matches(table: Table) -> bool:
    """Say whether the header is VUE's."""
    return len(_roles(table.columns)) == 3


def read(table: Table, how: How) -> Detections:
    """Read VUE detections.

    `Receiver` is MODEL-SERIAL, split at the last dash: serial to `receiver`, model to
    ``extra["model"]``. A position of `+0, +0` is missing.

    Parameters
    ----------
    table : Table
        The file.
    how : How
        `tz`: zone of a local-time export.

    Raises
    ------
    InputError
        If a time cannot be read, or the column is local time and `tz` is not given.
    """
    roles = _roles(table.columns)
    table = _build.clean(table, [roles["time"], roles["receiver"], roles["tag"]])
    time, _ = _clock.stamps(table, roles["time"], zone(table, roles["time"], how.tz))
    full = Ids.of(table.text(roles["receiver"]))
    simple = [plain(c) for c in table.columns]
    wanted = {name: simple.index(c) for name, c in _EXTRA.items() if c in simple}
    extra = _build.extras(table, wanted)
    models = [n.rpartition("-")[0] or None for n in full.names]
    if any(models):
        extra["model"] = np.array([*models, None], dtype=object)[full.code]
    extra |= _places(table, simple)
    used = [*roles.values(), *wanted.values()]
    used += [simple.index(c) for c in ("latitude", "longitude", "sensor_precision") if c in simple]
    serial, tag = full.to(serial_number), Ids.of(table.text(roles["tag"]))
    return _build.detections(table, "VUE detections CSV", time, serial, tag, extra, used)


def serial_number(name: str) -> str:
    """Return the serial in MODEL-SERIAL, which begins after the last dash."""
    return name.rpartition("-")[2] or name


def _places(table: Table, simple: list[str]) -> dict[str, np.ndarray]:
    if not {"latitude", "longitude"} <= set(simple):
        return {}
    if all(table.empty(simple.index(c)) for c in ("latitude", "longitude")):
        return {}
    lat, lon = (table.numbers(simple.index(c)) for c in ("latitude", "longitude"))
    nowhere = (lat == 0) & (lon == 0)
    lat, lon = np.where(nowhere, np.nan, lat), np.where(nowhere, np.nan, lon)
    if np.isnan(lat).all() and np.isnan(lon).all():
        return {}
    return {"latitude": lat, "longitude": lon}


def zone(table: Table, k: int, tz: str | None) -> str | None:
    """Return the zone of a time column from the bracket in its name, or else from the caller.

    Raises
    ------
    InputError
        If the name does not say UTC and the caller gives no zone.
    """
    name = table.columns[k]
    inside = re.search(r"\(([^)]*)\)", name)
    said = inside.group(1).strip() if inside else ""
    if said.upper() in ("UTC", "GMT", "Z"):
        return "UTC"
    if fixed := re.fullmatch(r"(?:UTC|GMT)\s*([+-])(\d{1,2})(?::?([03]0))?", said, re.IGNORECASE):
        sign, hours, minutes = fixed.groups()
        if minutes in (None, "00") and int(hours) <= 14:
            return f"Etc/GMT{'-' if sign == '+' else '+'}{int(hours)}"
    if tz is None and said.lower() not in ("", "local"):
        raise table.error(
            f"time zone '{said}' of column '{name}' is not known",
            mend='say it, tz="Europe/Copenhagen" or tz="Etc/GMT+5" (or export in UTC)',
        )
    return tz
