"""Data: validated containers, and the grouping of detections into pings.

Nothing here needs JAX; polars is imported only when a table is made or read.

Comes in: arrays.
Goes out: containers that checked themselves once and never change, and one container made of
    another: `preparation.py` and `grouping.py` (detections to pings), `encounter_grouping.py`.
Start reading: `detections.py`, `receivers.py`, `arrivals.py`. Knows no file format and no model.
The page: docs/architecture.md, "Data to arrival times".
"""

from typing import TYPE_CHECKING, Any

from maloc._package import moved

__all__ = [
    "ArrivalHistory",
    "ArrivalTimes",
    "ClockReferences",
    "Detections",
    "EncounterHistory",
    "Events",
    "Note",
    "Positions",
    "Prepared",
    "ReadReport",
    "Receivers",
    "Schedule",
    "SetAside",
    "SoundProfile",
    "Tags",
    "WaterColumn",
    "arrival_history",
    "collinear",
    "correct_clocks",
    "encounter_history",
    "match_tag",
    "prepare",
    "sensor_values",
    "toa_matrix",
]

_HOME = {
    "ArrivalHistory": "joint_history",
    "ArrivalTimes": "arrivals",
    "ClockReferences": "events",
    "Detections": "detections",
    "EncounterHistory": "encounters",
    "Events": "events",
    "Note": "report",
    "Positions": "positions",
    "Prepared": "preparation",
    "ReadReport": "report",
    "Receivers": "receivers",
    "Schedule": "arrivals",
    "SetAside": "arrivals",
    "SoundProfile": "sound_profile",
    "Tags": "tags",
    "WaterColumn": "water_column",
    "arrival_history": "joint_history",
    "collinear": "receivers",
    "correct_clocks": "events",
    "encounter_history": "encounter_grouping",
    "match_tag": "_tags",
    "prepare": "preparation",
    "sensor_values": "tags",
    "toa_matrix": "grouping",
}

if TYPE_CHECKING:
    from maloc.data._tags import match_tag
    from maloc.data.arrivals import ArrivalTimes, Schedule, SetAside
    from maloc.data.detections import Detections
    from maloc.data.encounter_grouping import encounter_history
    from maloc.data.encounters import EncounterHistory
    from maloc.data.events import ClockReferences, Events, correct_clocks
    from maloc.data.grouping import toa_matrix
    from maloc.data.joint_history import ArrivalHistory, arrival_history
    from maloc.data.positions import Positions
    from maloc.data.preparation import Prepared, prepare
    from maloc.data.receivers import Receivers, collinear
    from maloc.data.report import Note, ReadReport
    from maloc.data.sound_profile import SoundProfile
    from maloc.data.tags import Tags, sensor_values
    from maloc.data.water_column import WaterColumn
else:

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first asked for (PEP 562)."""
        if name not in _HOME:
            return moved.name_of(__name__, name)
        from importlib import import_module

        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
