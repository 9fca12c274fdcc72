"""Readers: one file a format, found by the header."""

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
