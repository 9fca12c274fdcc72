"""Clock synchronisation: raw receiver clocks to one common time, by sync tags.

`fit` makes a `ClockSync`; its ``apply`` puts detections on the common clock. `rough` does with the
animals' own tags, to about a second. `connectivity`, `latency` and `find_sync_order` show how an
array hangs together.

Comes in: raw `Detections`, `Receivers` with sync tags.
Goes out: a `ClockSync`.
Start reading: `_fit.py`, then `_prepared.py` (coarse alignment), `_model.py` (the joint fit),
    `_outcome.py` (what it says). Draws no figure and writes no folder.
The mathematics: docs/sync.md.
"""

from maloc.sync._anchor_file import Anchors, read_anchors
from maloc.sync._fit import fit
from maloc.sync._rough import rough
from maloc.sync.clocks import ClockJumps, ClockSync, SyncResiduals
from maloc.sync.connect import (
    Connectivity,
    SyncOrder,
    connectivity,
    find_sync_order,
    latency,
    sync_pair,
)
from maloc.sync.windows import WindowOffsets, window_offsets

__all__ = [
    "Anchors",
    "ClockJumps",
    "ClockSync",
    "Connectivity",
    "SyncOrder",
    "SyncResiduals",
    "WindowOffsets",
    "connectivity",
    "find_sync_order",
    "fit",
    "latency",
    "read_anchors",
    "rough",
    "sync_pair",
    "window_offsets",
]
