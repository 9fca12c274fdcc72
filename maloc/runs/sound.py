"""Arrival times with the sound speed that a table or a profile of the water foretells."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maloc.runs.load import Source
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.speed import water_table

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes
    from maloc.readers.medium import MediumTable

__all__ = ["with_sound"]

_LEVEL = 1.0  # m; depths of a table that differ by more were perhaps meant as a profile


def with_sound(source: Source, options: TrackOptions, log: Log) -> Source:
    """Arrival times with the speed of --sound-speed TABLE.csv, by depth where that is a profile.

    Depths go first (`maloc.runs.depth.with_depth`).

    Raises
    ------
    InputError
        If the table lacks something, or is of another time.
    """
    given = options.speed()
    if not isinstance(given, Path):
        return source
    from maloc.world.medium import sound_profile, with_sound_speed

    with log.stage("read"):
        read, sd = water_table(given), options.speed_sd()
        _say(read, log)
        table = sound_profile(read, sd=sd) if read.by_depth else read
        toas = [with_sound_speed(toa, table, sd=sd) for toa in source.toas]
    if read.by_depth:
        log.notice(repr(table))
        for toa in toas:
            if (text := _how(toa)) is not None:
                log.notice(text)
    return source._replace(toas=toas)


def _say(read: MediumTable, log: Log) -> None:
    """Which equation is used, and what a table with depths is taken for."""
    if "sound_speed" not in read.values:
        log.notice("sound speed from temperature and salinity by Chen & Millero (1977)")
    elif "temperature" in read.values:
        log.notice(f"{read.table.file}: its sound_speed is used, its temperature is not")
    depth = read.values.get("depth")
    if depth is not None and not read.by_depth and float(np.ptp(depth)) > _LEVEL:
        log.notice(
            f"{read.table.file}: one depth at each time, so these are a logger's depths; a profile "
            "has one time in all rows of a cast"
        )


def _how(toa: ArrivalTimes) -> str | None:
    """In one line, what becomes of a profile where the track has no depth."""
    if toa.column is not None:
        return None
    name = f"tag {toa.tag or '(no name)'}"
    if toa.depth is not None and np.isfinite(toa.depth).any():
        return f"{name}: sound speed by the profile at the sensed depths"
    return (
        f"{name}: depth neither sensed nor estimated, so its sound speed is the water column's, "
        f"{float(np.mean(toa.sound_speed)):.1f} m/s give or take {toa.sound_speed_sd or 0.0:.1f} "
        "(--depth sensor or 3d goes by the profile)"
    )
