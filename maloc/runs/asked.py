"""Of the detections read, those that the options ask for, and those that they rule out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from maloc.errors import InputError
from maloc.runs.options import TrackOptions

if TYPE_CHECKING:
    from maloc.data import Detections, Receivers

__all__ = ["ROW", "sync_tags", "tags_to_fit", "too_soon"]

ROW = "row in the detections as read"  # extra column that survives the synchronisation


def tags_to_fit(options: TrackOptions, detections: Detections, receivers: Receivers) -> list[str]:
    """Full ids of the tags to fit: those named, or all that are not sync tags."""
    if options.tags and "all" not in options.tags:
        return list(dict.fromkeys(detections.find_tag(t) for t in options.tags))
    sync = sync_tags(detections, receivers)
    tags = [t for t in detections.tags if t not in sync]
    if not tags:
        raise InputError("all tags in the detections are sync tags", mend="name one with --tag")
    return tags


def sync_tags(detections: Detections, receivers: Receivers) -> set[str]:
    """Full ids of the sync tags that are among the detections."""
    wanted = {str(s) for s in receivers.sync_tag if s}
    return {t for t in detections.tags if any(t == s or t.endswith(f"-{s}") for s in wanted)}


def too_soon(options: TrackOptions, detections: Detections, tags: Sequence[str]) -> dict[int, str]:
    """Rows of detections that follow another at their receiver sooner than the tag pings, and why.

    The shortest interval is that of the command line, or else of the table of tags.
    """
    from maloc.data import prepare

    schedule = options.schedule()
    shortest, longest = schedule.shortest, 2 * schedule.mean - schedule.shortest
    table = options.reading.tags()
    limits = {}
    for tag in tags:
        known = (shortest, longest) if shortest > 0 else table and table.limits(tag)
        if known:
            limits[tag] = known
    if not limits:
        return {}
    found = prepare(detections, limits=limits)
    rows = np.flatnonzero(found.too_soon)
    return dict(zip(rows.tolist(), found.why[rows].tolist(), strict=True))
