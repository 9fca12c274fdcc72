"""Plain NumPyro models, one a file; ``maloc.models.toa_track`` is the function itself.

Comes in: arrays of `maloc.model_data`.
Goes out: sample statements, made of the parts in `maloc.movement`, `maloc.arrival`,
    `maloc.schedule`, `maloc.detection` and `maloc.world`.
Start reading: `toa_track.py`.
The mathematics: docs/architecture.md.
"""

from __future__ import annotations

from maloc.models.clock_sync import clock_sync
from maloc.models.detection_only import detection_only
from maloc.models.independent import independent
from maloc.models.joint import joint
from maloc.models.known_interval import known_interval
from maloc.models.toa_track import toa_track
from maloc.models.unknown_interval import unknown_interval
from maloc.models.yaps import yaps

__all__ = [
    "clock_sync",
    "detection_only",
    "independent",
    "joint",
    "known_interval",
    "toa_track",
    "unknown_interval",
    "yaps",
]
