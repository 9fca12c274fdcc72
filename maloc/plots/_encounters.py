"""How well a detection model fits: detection by distance and by receiver, missed pings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._diagnostics import _draw_parameters, _draw_trace, heard, spread
from maloc.plots._source import posterior, track_of
from maloc.plots._style import CYCLE, INK, PALE, TRACK, legend_above, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.infer.encounter_check import Expected

__all__ = ["detection_curve", "encounters", "hearing", "missed"]


def encounters(
    fit: Any,
    table: Any,
    expected: Expected,
    gaps: Any = None,
    *,
    title: str = "",
    figure: Any = None,
) -> np.ndarray:
    """Draw six panels: detection by distance, by receiver, parameters, heard, spread, gaps.

    Parameters
    ----------
    fit : Fit
        A fitted detection model.
    table : DataFrame
        The table of track.csv.
    expected : maloc.infer.encounter_check.Expected
        What the fit says of who hears what.
    gaps : DataFrame, optional
        The table of missed.csv; chains or nothing take its place where there is none.
    title : str
        Above the figure.
    figure : Figure, optional
        An empty figure to draw on; a new one where None.

    Returns
    -------
    array (2, 3) of Axes
    """
    if figure is None:
        from matplotlib import pyplot as plt

        figure = plt.figure(figsize=(14, 8))
    axes = figure.subplots(2, 3)
    figure.subplots_adjust(0.05, 0.08, 0.98, 0.89, wspace=0.24, hspace=0.42)
    detection_curve(expected, ax=axes[0, 0])
    hearing(expected, ax=axes[0, 1])
    draws = posterior(fit)
    _draw_parameters(draws, fit.parameters(), axes[0, 2])
    track = track_of(table)
    heard(track.time, np.asarray(table["n_receivers"].to_numpy()), ax=axes[1, 0])
    spread(track, ax=axes[1, 1])
    if fit.method in ("nuts", "hmc"):
        _draw_trace(draws, [p["name"] for p in fit.parameters()], axes[1, 2])
    elif gaps is not None and len(gaps):
        missed(gaps, ax=axes[1, 2])
    else:
        axes[1, 2].set_axis_off()
    if title:
        figure.suptitle(title, x=0.05, ha="left", fontsize="large", fontweight="bold", color=INK)
    return axes


def detection_curve(expected: Expected, *, ax: Any = None) -> Axes:
    """Posterior of the detection function, and shares heard of known pings by distance."""
    ax = new_axes(ax)
    x = expected.distance
    low, mean, high = expected.curve
    ax.fill_between(x, low, high, color=TRACK, alpha=0.2, lw=0, zorder=2)
    ax.plot(x, mean, color=TRACK, lw=1.6, zorder=3, label="fit, 95 %")
    away, was = expected.away, expected.was_heard
    if len(away):
        edges = np.unique(np.quantile(away, np.linspace(0, 1, 13)))
        place = np.clip(np.searchsorted(edges, away, side="right") - 1, 0, max(len(edges) - 2, 0))
        n = np.bincount(place)
        middle = np.bincount(place, away) / np.maximum(n, 1)
        share = np.bincount(place, was) / np.maximum(n, 1)
        ax.plot(
            middle[n > 0], share[n > 0], "o", color=CYCLE[1], ms=5, zorder=4, label="share heard"
        )
    ax.set_ylim(-0.02, 1.02)
    tidy(ax, "distance (m)", "probability", "Detection by distance")
    return legend_above(ax)


def hearing(expected: Expected, *, ax: Any = None) -> Axes:
    """Pings that each receiver heard, and how many the fit expects it to hear."""
    ax = new_axes(ax)
    at = np.arange(len(expected.names))
    ax.bar(at, expected.heard, color=PALE, zorder=2, label="heard")
    ax.plot(at, expected.expected, "o", color=TRACK, ms=5, zorder=3, label="expected")
    ax.set_xticks(at, list(expected.names), rotation=60, ha="right", fontsize=7)
    tidy(ax, "", "pings", "Pings a receiver")
    return legend_above(ax)


def missed(gaps: Any, *, ax: Any = None) -> Axes:
    """Missed pings of each gap, mean and 90 %, against how long it was; flagged gaps crossed."""
    ax = new_axes(ax)
    length = np.asarray(gaps["duration"].to_numpy(), float)
    n, low, high = (np.asarray(gaps[c].to_numpy(), float) for c in ("n", "n_lo", "n_hi"))
    odd = np.asarray(gaps["outside"].to_numpy(), bool)
    ax.vlines(length, low, high, color=TRACK, lw=1.0, alpha=0.6, zorder=2)
    ax.plot(length[~odd], n[~odd], "o", color=TRACK, ms=4, zorder=3)
    ax.plot(length[odd], n[odd], "x", color=CYCLE[1], ms=6, zorder=4)
    return tidy(ax, "gap (s)", "missed pings", "Missed pings a gap, 90 % (x: outside)")
