"""Emitters whose calls do not say whose they are: associate, track, score; and split a shared code.

`associate` finds which arrivals across receivers are one emission, `Tracker` follows the positions
found (Stone Soup, ``pip install "maloc[tracking]"``), `gospa` scores them. `split_same_code` tells
two transmitters with one code apart.

Comes in: arrivals without a name, or detections of a shared code.
Goes out: who sent what, tracks.
Start reading: `association.py`, `same_code.py`.
The mathematics: docs/emitters.md.
"""

from __future__ import annotations

from maloc.emitters.association import Association, associate, fuse
from maloc.emitters.metrics import Gospa, gospa, ospa
from maloc.emitters.same_code import Split, split_same_code
from maloc.emitters.sensing import Sensing
from maloc.emitters.simulate import SCENES, Scan, Scene, simulate
from maloc.emitters.simulate_code import CodeDesign, CodeScene, simulate_code
from maloc.emitters.tracking import Tracker, Tracks

__all__ = [
    "SCENES",
    "Association",
    "CodeDesign",
    "CodeScene",
    "Gospa",
    "Scan",
    "Scene",
    "Sensing",
    "Split",
    "Tracker",
    "Tracks",
    "associate",
    "fuse",
    "gospa",
    "ospa",
    "simulate",
    "simulate_code",
    "split_same_code",
]
