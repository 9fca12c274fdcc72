"""Single pings on a map: ellipses, and lines to second places."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._map import ellipse_axes
from maloc.plots._style import CYCLE, INK, PALE, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.data import Receivers
    from maloc.points import Points

__all__ = ["points"]


def points(
    found: Points, receivers: Receivers | None = None, *, number: int = 0, ax: Any = None
) -> Axes:
    """Draw point positions with their 95 % ellipses; ambiguous ones are tied to their second place.

    Parameters
    ----------
    found : Points
        Of `maloc.points.locate`.
    receivers : Receivers, optional
        Drawn beneath.
    number : int
        Which of several tags: its colour.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        Equal aspect, metres.
    """
    from matplotlib.collections import EllipseCollection, LineCollection

    ax = new_axes(ax, (7.5, 7.0))
    colour = CYCLE[number % len(CYCLE)]
    xy = found.position[found.located, :2]
    cov = found.covariance[found.located, :2, :2]
    sure = np.isfinite(cov).all(axis=(1, 2))
    if sure.any():
        width, height, angle = ellipse_axes(cov[sure])
        ax.add_collection(
            EllipseCollection(
                width,
                height,
                angle,
                units="xy",
                offsets=xy[sure],
                offset_transform=ax.transData,
                facecolors=colour,
                edgecolors="none",
                alpha=0.12,
                zorder=2,
            ),
            autolim=False,
        )
    other = found.alternative[found.located, :2]
    twice = found.ambiguous[found.located] & np.isfinite(other).all(axis=1)
    if twice.any():
        ties = np.stack([xy[twice], other[twice]], axis=1)
        ax.add_collection(LineCollection(list(ties), colors=PALE, linewidths=0.7, zorder=1.5))
        ax.plot(*other[twice].T, "o", mfc="none", mec=PALE, ms=4, ls="none", label="second place")
    ax.scatter(*xy.T, color=colour, s=9, lw=0, zorder=4, label=found.tag or "ping")
    if receivers is not None:
        ax.plot(*receivers.xy.T, "^", color=INK, ms=7, mec="white", ls="none", label="receiver")
        middle = receivers.xy.mean(axis=0)
        half = 1.2 * np.maximum(np.ptp(receivers.xy, axis=0), 1.0).max() / 2
        if len(xy):
            half = max(half, 1.1 * float(np.quantile(np.abs(xy - middle).max(axis=1), 0.98)))
        ax.set_xlim(middle[0] - half, middle[0] + half)
        ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.set_aspect("equal", adjustable="box")
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.legend(loc="upper right", fontsize=8, frameon=False)
    return tidy(ax, "x (m)", "y (m)", f"Point positions ({found.method})")
