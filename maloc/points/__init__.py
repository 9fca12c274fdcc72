"""One ping at a time: positions from the arrivals of a single emission, that know when they err.

`locate` is the one entry; it needs no movement model and no neighbouring ping, and says of every
ping where it was, how surely, which arrivals were used, and where a second place fits as well.

Comes in: `ArrivalTimes`.
Goes out: `Points`, a row a ping.
Start reading: `locate.py`, then `_methods.py` and one method, `_robust.py` say.
The mathematics: docs/points.md.
"""

from __future__ import annotations

from maloc.points.altitude import Terrain, read_terrain
from maloc.points.ambiguity import Rules, resolve
from maloc.points.beacons import locate_by_beacons
from maloc.points.expected import ErrorMap, expected_error, gdop
from maloc.points.locate import locate
from maloc.points.region import read_region
from maloc.points.result import Points

__all__ = [
    "ErrorMap",
    "Points",
    "Rules",
    "Terrain",
    "expected_error",
    "gdop",
    "locate",
    "locate_by_beacons",
    "read_region",
    "read_terrain",
    "resolve",
]
