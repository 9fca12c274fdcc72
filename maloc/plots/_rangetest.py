"""Figure of a range test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._style import INK, LATE, TRACK, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.detection.rangetest import RangeTest

__all__ = ["detection_curve"]


def detection_curve(test: RangeTest, edges: Any = None, ax: Any = None) -> Axes:
    """Draw a detection curve with its 95 % band, and the observed shares by distance.

    Parameters
    ----------
    test : maloc.rangetest.RangeTest
    edges : (B + 1,) array, optional
        Edges of the distance bins, m; 20 bins of equal size by default.
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (7.0, 4.5))
    bins = test.bins(edges)
    grid = np.linspace(0, 1.05 * bins.distance[-1], 300)
    p, low, high = test.curve(grid)
    ax.fill_between(grid, low, high, color=TRACK, alpha=0.2, linewidth=0)
    ax.plot(grid, p, color=TRACK, label=f"{test.kind} curve, 95 % band")
    error = np.abs(np.stack([bins.share - bins.low, bins.high - bins.share]))
    ax.errorbar(
        bins.distance, bins.share, error, fmt="o", markersize=4, color=LATE, linewidth=1,
        label="heard, 95 % interval",
    )  # fmt: skip
    reach = test.reach(0.5)[0]
    if 0 < reach < grid[-1]:
        ax.axvline(reach, color=INK, linewidth=0.8, linestyle=":", label=f"p = .5 at {reach:.0f} m")
    ax.set_ylim(0, 1)
    ax.set_xlim(0, grid[-1])
    ax.legend(loc="lower left", frameon=False, fontsize="small")
    return tidy(ax, "distance (m)", "probability that a ping is heard", "Range test")
