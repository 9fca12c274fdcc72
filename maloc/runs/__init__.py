"""What a command does, from files to a finished folder.

Comes in: checked options (`options.py`).
Goes out: a folder, whole or not at all, and a line a tag.
Start reading: `track.py`, then `load.py` (files to arrival times), `fit_tag.py`, `write.py`;
    `encounters.py` is the same walk for detections and the joint model.
The page: docs/architecture.md, "The walk of a datum".
"""

__all__: list[str] = []
