"""Readers: one file a format, found by the header.

Comes in: a file of any format, or a dataframe.
Goes out: a container of `maloc.data`, with what was odd in its report.
Start reading: `read.py`, then one format, `vue.py` say; `_recognise.py` tells formats apart,
    `_merge.py` brings files together, `check.py` says what is wrong with them.
The page: docs/formats.md.
"""

from maloc.readers.read import (
    read_detections,
    read_events,
    read_positions,
    read_receivers,
    read_tags,
    read_toa,
)

__all__ = [
    "read_detections",
    "read_events",
    "read_positions",
    "read_receivers",
    "read_tags",
    "read_toa",
]
