"""That a track has depth: how deep the water is, and how well the tag knows its own depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from maloc.errors import InputError

__all__ = ["WaterColumn", "flat_warning"]

_TELL = 0.5  # m; receivers whose depths differ by less make no difference


@dataclass(frozen=True)
class WaterColumn:
    """That a track has depth: how deep the water is, and how well the tag knows its own depth.

    Parameters
    ----------
    bottom : float or terrain, optional
        Depth of the water, m; or what has ``depth_at(xy, crs)``, such as
        `maloc.points.altitude.Terrain`. By default that of the deepest receiver, or of the deepest
        sensed depth where that is deeper.
    sensor_sd : float
        Standard deviation of the error of the tag's sensed depths, m; 0: they are exact.

    Raises
    ------
    InputError
        If a bottom is not below the surface, or an sd is negative.
    """

    bottom: Any = None
    sensor_sd: float = 1.0

    def __post_init__(self) -> None:
        if self.bottom is not None and not hasattr(self.bottom, "depth_at"):
            if not (np.isfinite(self.bottom) and self.bottom > 0):
                raise InputError(f"a bottom at {self.bottom:g} m is not below the surface")
        if not (np.isfinite(self.sensor_sd) and self.sensor_sd >= 0):
            raise InputError(f"a depth sensor's sd of {self.sensor_sd:g} m is negative")


def flat_warning(toa: Any) -> str | None:
    """What a flat track leaves out where the receivers that heard the tag differ in depth.

    Parameters
    ----------
    toa : ArrivalTimes or ArrivalHistory
        Of anything else nothing is known: None.
    """
    toa = getattr(toa, "toas", (toa,))[0]
    if not hasattr(toa, "column") or toa.column is not None:
        return None
    depth = toa.receivers.depth[toa.heard.any(axis=0) & np.isfinite(toa.receivers.depth)]
    if len(depth) and np.ptp(depth) > _TELL:
        down = float(np.ptp(depth))
        long = float(np.hypot(100.0, down) - 100.0)
        return (
            f"receivers' depths differ by up to {down:.3g} m ({depth.min():.3g} to "
            f"{depth.max():.3g}) and the track is flat: at 100 m a range is up to {long:.2g} m off"
        )
    return None
