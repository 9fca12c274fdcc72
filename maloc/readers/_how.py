"""What a caller says about files that the files do not say themselves."""

from __future__ import annotations

from typing import Literal, NamedTuple

__all__ = ["CLOCKS", "Clock", "How"]

Clock = Literal["device", "corrected", "linear"]
CLOCKS = ("device", "corrected", "linear")


class How(NamedTuple):
    """Options of reading.

    Parameters
    ----------
    tz : str or None
        Zone of local times.
    clock : {"device", "corrected", "linear"} or None
        Which time of an export that has two; None = the corrected one where it is filled.
    """

    tz: str | None = None
    clock: Clock | None = None
