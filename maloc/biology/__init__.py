"""What a biologist asks of a track, answered from whole-track draws: each answer with its interval.

Everything here takes `maloc.infer.TrackDraws`, is worked out draw by draw, and summarised last. A
mean track is shorter, smoother and sharper than any track the animal may have taken.

Comes in: `TrackDraws`.
Goes out: estimates with their intervals.
Start reading: `travel.py`, then `space.py` and `selection.py`.
The page: docs/after.md.
"""

from __future__ import annotations

from maloc.biology.estimate import Estimate, summarise
from maloc.biology.selection import Selection, resource_selection
from maloc.biology.space import Residence, Utilisation, residence, utilisation
from maloc.biology.travel import distance_travelled, speed

__all__ = [
    "Estimate",
    "Residence",
    "Selection",
    "Utilisation",
    "distance_travelled",
    "residence",
    "resource_selection",
    "speed",
    "summarise",
    "utilisation",
]
