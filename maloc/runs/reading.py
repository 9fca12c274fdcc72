"""How files of detections are read on behalf of a command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maloc.data import Detections, Receivers, Tags
    from maloc.readers._how import Clock

__all__ = ["Reading"]


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

    def receivers(self, path: Path, crs: str | None, sd: float | None = None) -> Receivers:
        """Read the array, with the sync tags that the table of tags puts beside receivers."""
        from maloc.readers import read_receivers

        found, tags = read_receivers(path, crs=crs, position_sd=sd), self.tags()
        return found if tags is None else tags.beside(found)

    def detections(self, files: Sequence[Path]) -> Detections:
        """Read detections, by animal where there is a table of tags."""
        from maloc.readers import read_detections

        found = read_detections(*files, format=self.format, tz=self.tz, clock=self.clock)
        tags = self.tags()
        return found if tags is None else tags.apply(found)
