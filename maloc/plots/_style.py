"""Colours, axes and small habits that every figure shares; matplotlib is imported here lazily."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "CYCLE",
    "INK",
    "LATE",
    "PALE",
    "TRACK",
    "TRUTH",
    "legend_above",
    "new_axes",
    "tidy",
    "time_axis",
]

# Okabe and Ito's palette: told apart by all common kinds of colour vision
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
TRACK = CYCLE[0]
LATE = CYCLE[1]
TRUTH = "#D55E00"
INK = "#333333"
PALE = "#B8C4CC"


def new_axes(ax: Any = None, size: tuple[float, float] = (7.0, 5.0)) -> Axes:
    """Return `ax`, or new axes of a pyplot figure when there are none."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots(figsize=size)[1]


def tidy(ax: Axes, xlabel: str = "", ylabel: str = "", title: str = "") -> Axes:
    """Label axes, take away the box's upper and right side, lay a light grid beneath."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color="#E6E6E6", linewidth=0.6, zorder=0)
    ax.set_axisbelow(True)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    if title:
        ax.set_title(title, loc="left", fontsize="medium", fontweight="bold", color=INK)
    return ax


def legend_above(ax: Axes) -> Axes:
    """Lay a legend of two columns above the right end of the axes, where it hides nothing."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, fontsize=8)
    return ax


def time_axis(seconds: np.ndarray) -> tuple[np.ndarray, str]:
    """Return times since the first one in a readable unit, and the axis label."""
    seconds = np.asarray(seconds, float)
    start = np.nanmin(seconds) if np.isfinite(seconds).any() else 0.0
    since = seconds - start
    length = np.nanmax(since) if np.isfinite(since).any() else 0.0
    for size, unit in ((2 * 86400, "days"), (2 * 3600, "h"), (120, "min")):
        if length >= size:
            per = {"days": 86400.0, "h": 3600.0, "min": 60.0}[unit]
            return since / per, f"time since first ping ({unit})"
    return since, "time since first ping (s)"
