"""What makes a result of the canal study, apart from its case and its method."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from maloc.data.arrivals import Schedule
from maloc.simulate.canal import CanalDesign

__all__ = ["Settings"]


@dataclasses.dataclass(frozen=True)
class Settings:
    """What makes a job's result, apart from its case and its method.

    Parameters
    ----------
    design : CanalDesign
        Of simulated cases.
    seed, draws : int
        Draws of each of two chains, for samplers.
    receivers : Path, optional
        Table of the array; the built-in one, or the folder's own, when not given.
    folder : Path, optional
        Files to fit instead of simulated cases.
    schedule : Schedule
        What is known of the burst interval in the folder's files.
    schedules : tuple of (str, Schedule)
        The same by file's stem, where it differs.
    """

    design: CanalDesign
    seed: int = 0
    draws: int = 1000
    receivers: Path | None = None
    folder: Path | None = None
    schedule: Schedule = dataclasses.field(default_factory=Schedule)
    schedules: tuple[tuple[str, Schedule], ...] = ()

    def as_text(self) -> str:
        """JSON, to be compared with that of an earlier run in the same folder."""
        return json.dumps(dataclasses.asdict(self), indent=1, default=str) + "\n"
