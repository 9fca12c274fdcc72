"""Figures of a clock synchronisation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._style import CYCLE, LATE, TRACK, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.sync import ClockSync

__all__ = ["clocks", "sync_residuals"]

HOUR = 3600.0


def sync_residuals(sync: ClockSync, ax: Any = None) -> Axes:
    """Draw the residuals of sync arrivals over time; late ones beyond the edge are drawn on it.

    Parameters
    ----------
    sync : ClockSync
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (9.0, 4.5))
    r = sync.residuals
    hours = (r.time - sync.origin) * 1e-9 / HOUR
    edge = 8e3 * sync.sigma
    fits = np.isfinite(r.p_direct)
    late = fits & ~r.used
    style = {"s": 5, "linewidths": 0, "rasterized": True}
    ax.scatter(
        hours[r.used], 1e3 * r.residual[r.used], color=TRACK, alpha=0.4, label="direct", **style
    )
    if late.any():
        beyond = np.clip(1e3 * r.residual[late], -edge, edge)
        label = f"not direct ({late.sum()})"
        ax.scatter(hours[late], beyond, color=LATE, alpha=0.6, label=label, **style)
    ax.set_ylim(-edge * 1.08, edge * 1.08)
    ax.legend(loc="upper right", frameon=False, markerscale=3)
    title = f"Sync arrivals: residual sd {1e3 * sync.residual_sd:.2f} ms"
    return tidy(ax, "recorded time since the first detection (h)", "residual (ms)", title)


def clocks(sync: ClockSync, ax: Any = None) -> Axes:
    """Draw every clock's offset less its own straight line, with twice its standard error.

    Parameters
    ----------
    sync : ClockSync
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (9.0, 4.5))
    hours = sync.knots / HOUR
    shown = np.flatnonzero(sync.synced)
    for n, i in enumerate(shown):
        line = np.polyval(np.polyfit(sync.knots, sync.values[i], 1), sync.knots)
        bend, sd = 1e3 * (sync.values[i] - line), 1e3 * sync.values_sd[i]
        colour = CYCLE[n % len(CYCLE)]
        name = sync.receivers.names[i]
        drift = 1e6 * np.polyfit(sync.knots, sync.values[i], 1)[0]
        ax.plot(hours, bend, color=colour, linewidth=1.0, label=f"{name} ({drift:+.1f} ppm)")
        ax.fill_between(hours, bend - 2 * sd, bend + 2 * sd, color=colour, alpha=0.15, linewidth=0)
    if len(shown):
        columns = 1 + len(shown) // 14
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small",
                  ncols=columns)  # fmt: skip
    title = f"Clocks against {sync.reference}, straight drift taken out"
    return tidy(ax, "common time since the first detection (h)", "offset (ms)", title)
