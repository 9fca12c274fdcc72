"""Input that cannot give a track is refused before any work, in one clear line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes, Detections

__all__ = ["check_usable", "check_whole_seconds"]

FEWEST = 3  # usable pings
WHOLE = "whole seconds: useless for positions by arrival times"


def check_whole_seconds(detections: Detections, files: Any) -> None:
    """Refuse times without a fraction of a second, of all receivers or of one.

    Raises
    ------
    InputError
        1 s is 1500 m: such times tell nothing about positions.
    """
    whole = detections.time % NS == 0
    mend = (
        "export again with fractions of a second, or use who heard what without the times: "
        "--model detections"
    )
    where = ", ".join(map(str, files))
    if len(whole) > 2 and whole.all():
        raise InputError(f"times are {WHOLE}", file=where, mend=mend)
    for name in detections.receivers:
        mine = detections.receiver == name
        if mine.sum() > 4 and whole[mine].all():
            raise InputError(
                f"times of receiver {name} are {WHOLE}",
                file=where,
                mend=mend,
            )


def check_usable(toa: ArrivalTimes, file: Path | None = None) -> None:
    """Refuse arrival times that cannot give a track.

    Raises
    ------
    InputError
        If one receiver alone heard the tag, fewer than three pings were heard by two receivers, or
        the arrival times are whole seconds.
    """
    name = f"tag {toa.tag}: " if toa.tag else ""
    heard = toa.heard
    names = {str(toa.receivers.receiver[j]) for j in np.flatnonzero(heard.any(0))}
    if not heard.any():
        raise InputError(f"{name}no detections", file=file)
    if len(names) < 2 or len(np.unique(toa.receivers.xy[heard.any(0)], axis=0)) < 2:
        raise InputError(
            f"{name}only 1 receiver ({', '.join(sorted(names))}) heard it: "
            "positions need at least 3 receivers",
            file=file,
        )
    usable = int((toa.n_heard >= 2).sum())
    if usable < FEWEST:
        raise InputError(
            f"{name}{usable} usable ping{'s' * (usable != 1)} (heard by two receivers or more); "
            f"a track needs at least {FEWEST}",
            file=file,
        )
    seconds = toa.toa[heard] + (0.0 if toa.origin is None else (toa.origin % NS) / NS)
    if len(seconds) > 2 and (np.abs(seconds - np.round(seconds)) < 1e-9).all():
        raise InputError(
            f"{name}arrival times are whole seconds: useless for positions",
            file=file,
            mend="give them with fractions of a second",
        )
