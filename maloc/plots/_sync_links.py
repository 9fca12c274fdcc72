"""Figures of who hears whose sync tag, and how long that takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from maloc.plots._style import CYCLE, LATE, TRACK, new_axes, tidy

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes

    from maloc.sync.connect import Connectivity, SyncOrder

__all__ = ["sync_latency", "sync_map", "sync_matrix"]


def sync_map(found: Connectivity, ax: Any = None) -> Axes:
    """Draw receivers, coloured by how often they and the others heard each other, and the links.

    Parameters
    ----------
    found : Connectivity
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (6.0, 5.0))
    first = [int(np.flatnonzero(found.receivers.receiver == n)[0]) for n in found.receivers.names]
    xy, links = found.receivers.xy[first], found.links
    most = max(int(links.max()), 1)
    for i, j in zip(*np.nonzero(np.triu(links)), strict=True):
        width = 2.5 * links[i, j] / most
        ax.plot(*xy[[i, j]].T, color=TRACK, linewidth=width, alpha=0.4, zorder=1)
    points = ax.scatter(*xy.T, c=found.total, s=70, cmap="viridis", zorder=2)
    ax.figure.colorbar(points, ax=ax, label="sync detections shared")
    for name, at in zip(found.receivers.names, xy, strict=True):
        ax.annotate(name, at, xytext=(5, 5), textcoords="offset points", fontsize="small")
    ax.set_aspect("equal")
    return tidy(ax, "x (m)", "y (m)", "Sync-tag connectivity")


def sync_matrix(
    found: Connectivity,
    order: SyncOrder | None = None,
    kind: Literal["heard", "links"] = "heard",
    ax: Any = None,
) -> Axes:
    """Draw the detections of each pair as a matrix; pairs of a sync order are numbered.

    Parameters
    ----------
    found : Connectivity
    order : SyncOrder, optional
    kind : {"heard", "links"}
        One way (row: whose tag, column: who heard it), or both ways together.
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (6.5, 5.5))
    names, values = list(found.receivers.names), getattr(found, kind)
    image = ax.imshow(values, cmap="Blues")
    ax.figure.colorbar(image, ax=ax, label="detections")
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize="small")
    ax.set_yticks(range(len(names)), names, fontsize="small")
    for n, (controller, target) in enumerate(order.pairs if order else ()):
        at = names.index(target), names.index(controller)
        ax.annotate(str(n + 1), at, ha="center", va="center", color=LATE, fontweight="bold")
    return tidy(ax, "heard by", "sync tag beside", "Sync-tag connectivity")


def sync_latency(
    table: pl.DataFrame,
    kind: Literal["latency", "error"] = "error",
    histogram: bool = False,
    ax: Any = None,
) -> Axes:
    """Draw latencies of sync detections, or their errors, over time or as histograms, by emitter.

    Parameters
    ----------
    table : DataFrame
        Of `maloc.sync.latency`, all pairs or those wanted.
    kind : {"latency", "error"}
        The whole time, or less the expected one.
    histogram : bool
    ax : Axes, optional
        Where to draw; new axes by default.

    Returns
    -------
    Axes
    """
    ax = new_axes(ax, (9.0, 4.5))
    time = table["time"].to_physical().to_numpy()
    hours = (time - time.min(initial=np.iinfo(np.int64).max)) * 1e-9 / 3600
    value = 1e3 * table[kind].to_numpy()
    emitter = table["emitter"].to_numpy()
    low, high = np.quantile(value, [0.01, 0.99]) if len(value) else (0.0, 1.0)
    for n, name in enumerate(dict.fromkeys(sorted(emitter))):
        mine, colour = emitter == name, CYCLE[n % len(CYCLE)]
        if histogram:
            edges = np.linspace(low, max(high, low + 1e-3), 60)
            ax.hist(value[mine], edges, histtype="step", color=colour, label=name)
        else:
            ax.plot(hours[mine], value[mine], ".", ms=2, color=colour, label=name, rasterized=True)
    if len(value):
        ax.legend(title="sync tag of", loc="upper right", frameon=False, fontsize="small")
    what = f"{kind} (ms)"
    if histogram:
        return tidy(ax, what, "detections", "Sync detections")
    return tidy(ax, "time since the first (h)", what, "Sync detections")
