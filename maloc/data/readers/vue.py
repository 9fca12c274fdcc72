"""Innovasea VUE detections CSV, and the one-header detections CSV of Fathom."""

from __future__ import annotations

import re

import numpy as np

from maloc.data.detections import Detections
from maloc.data.readers import _build, _clock
from maloc.data.readers._columns import plain
from maloc.data.readers._text import Table

__all__ = ["NAME", "TITLE", "is_events", "matches", "read", "zone"]

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
        if name.startswith(("date_and_time", "device_time")):
            out["time"] = k
        elif name in ("receiver", "serial_number"):
            out["receiver"] = k
        elif name in ("transmitter", "full_id"):
            out["tag"] = k
    return out


def matches(table: Table) -> bool:
    """Say whether the header is VUE's."""
    return len(_roles(table.columns)) == 3


def read(table: Table, tz: str | None = None) -> Detections:
    """Read VUE detections.

    `Receiver` is MODEL-SERIAL, split at the last dash: serial to `receiver`, model to
    ``extra["model"]``. A position of `+0, +0` is missing.

    Parameters
    ----------
    table : Table
        The file.
    tz : str, optional
        Zone of a local-time export.

    Raises
    ------
    InputError
        If a time cannot be read, or the column is local time and `tz` is not given.
    """
    roles = _roles(table.columns)
    table = _build.clean(table, [roles["time"], roles["receiver"], roles["tag"]])
    time, _ = _clock.stamps(table, roles["time"], zone(table, roles["time"], tz))
    full = table.text(roles["receiver"])
    serial = full.str.extract(r"([^-]+)$").fill_null(full)
    simple = [plain(c) for c in table.columns]
    wanted = {name: simple.index(c) for name, c in _EXTRA.items() if c in simple}
    extra = _build.extras(table, wanted)
    model = full.str.extract(r"^(.+)-[^-]+$")
    if model.null_count() < len(model):
        extra["model"] = model.to_numpy().astype(object)
    extra |= _places(table, simple)
    return _build.detections(
        table, "VUE detections CSV", time, serial, table.text(roles["tag"]), extra
    )


def _places(table: Table, simple: list[str]) -> dict[str, np.ndarray]:
    if "latitude" not in simple or "longitude" not in simple:
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
    if tz is None and said.lower() not in ("", "local"):
        raise table.error(
            f"time zone '{said}' of column '{name}' is not known",
            mend='say it, tz="Europe/Copenhagen" or tz="Etc/GMT+5" (or export in UTC)',
        )
    return tz


def is_events(table: Table) -> bool:
    """Say whether the header is that of VUE's receiver events export."""
    simple = {plain(c) for c in table.columns}
    return {"receiver", "description", "data"} <= simple and any(
        c.startswith("date_and_time") for c in simple
    )
