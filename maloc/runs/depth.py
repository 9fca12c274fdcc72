"""Arrival times with the depth that `--depth`, `--depth-sd` and `--bottom` ask for."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc.errors import InputError
from maloc.runs.load import Source
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions, metres

__all__ = ["with_depth"]


def with_depth(source: Source, options: TrackOptions, log: Log) -> Source:
    """Arrival times with the depth that was asked for; what is left out of flat ones is said.

    Raises
    ------
    InputError
        If no depth was sent where --depth sensor needs one, or a receiver has none.
    """
    from maloc.data import WaterColumn

    if options.depth == "flat":
        sent = sum(int(np.isfinite(t.depth).sum()) for t in source.toas if t.depth is not None)
        if sent:
            log.notice(f"depths of {sent} pings are not used: the track is flat (--depth sensor)")
        return source
    own = source.receivers.depth
    if not np.isfinite(own).all():
        raise InputError(
            f"receiver {source.receivers.receiver[np.flatnonzero(~np.isfinite(own))[0]]} has no "
            f"depth, which --depth {options.depth} needs",
            file=options.receivers,
            mend="fill the column depth",
        )
    fixed = metres(options.depth)
    water = WaterColumn(_bottom(options), 0.0 if np.isfinite(fixed) else options.depth_sd)
    toas = []
    for toa in source.toas:
        if np.isfinite(fixed):
            toa = toa.replace(depth=np.full(len(toa), fixed))
        sent = 0 if toa.depth is None else int(np.isfinite(toa.depth).sum())
        if options.depth == "sensor" and not sent:
            raise InputError(
                f"tag {toa.tag or '(no name)'} sent no depths",
                mend="--tag-table with slope and intercept, or --depth 3d to find them",
            )
        if not np.isfinite(fixed):
            log.notice(f"tag {toa.tag or '(no name)'}: {sent} of {len(toa)} pings with a depth")
        toas.append(toa.replace(column=water))
    return source._replace(toas=toas)


def _bottom(options: TrackOptions) -> Any:
    """Depth of the water, m, a terrain that knows it, or None."""
    if options.bottom is None or np.isfinite(metres(options.bottom)):
        return None if options.bottom is None else metres(options.bottom)
    from maloc.points.altitude import read_terrain

    return read_terrain(options.bottom)
