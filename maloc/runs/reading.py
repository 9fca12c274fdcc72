"""How files of detections are read on behalf of a command, and what the burst limits rule out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maloc.data import Detections, Receivers, Tags
    from maloc.readers._how import Clock
    from maloc.runs.load import TrackOptions

__all__ = ["Reading", "too_soon"]


@dataclass(frozen=True)
class Reading:
    """What is said of the files of detections; see `maloc.read_detections`."""

    format: str | None = None
    tz: str | None = None
    clock: Clock | None = None
    tag_table: Path | None = None

    def tags(self) -> Tags | None:
        """The table of tags, where one was given."""
        from maloc.readers import read_tags

        return None if self.tag_table is None else read_tags(self.tag_table)

    def receivers(self, path: Path, crs: str | None) -> Receivers:
        """Read the array, with the sync tags that the table of tags puts beside receivers."""
        from maloc.readers import read_receivers

        found, tags = read_receivers(path, crs=crs), self.tags()
        return found if tags is None else tags.beside(found)

    def detections(self, files: Sequence[Path]) -> Detections:
        """Read detections, by animal where there is a table of tags."""
        from maloc.readers import read_detections

        found = read_detections(*files, format=self.format, tz=self.tz, clock=self.clock)
        tags = self.tags()
        return found if tags is None else tags.apply(found)


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
