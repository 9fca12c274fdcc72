"""What a method of the canal study says, and how points become it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.data._limits import Z95

if TYPE_CHECKING:
    from maloc.points.result import Points

__all__ = ["Located", "of_points"]


class Located(NamedTuple):
    """What a method says of P pings; NaN where it says nothing.

    ``position``, ``sd``, ``low`` and ``high`` (P, 2) m: estimate, standard deviation and central
    95 %; ``warnings``; ``cpu``: seconds of the fit, NaN where its own clock is not the job's.
    """

    position: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    warnings: tuple[str, ...] = ()
    cpu: float = float("nan")


def of_points(points: Points) -> Located:
    """Positions and widths of located pings; limits are the method's own where it has them."""
    sd = np.where(points.located[:, None], points.sd, np.nan)
    low = points.extra.get("lo", points.position - Z95 * sd)
    high = points.extra.get("hi", points.position + Z95 * sd)
    return Located(points.position, sd, low, high)
