"""Where an array locates well: maps of GDOP, expected error, and chance of a position."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from maloc.plots._style import INK, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.data import Receivers
    from maloc.points.expected import ErrorMap

__all__ = ["gdop"]

_TITLES = {
    "gdop": "Dilution of precision (m of error a m of arrival error)",
    "error": "Expected error of a position (m)",
    "located": "Share of pings that can be located",
}


def gdop(
    found: ErrorMap,
    receivers: Receivers | None = None,
    *,
    what: Literal["gdop", "error", "located"] = "gdop",
    ax: Any = None,
) -> Axes:
    """Draw a map of `maloc.points.expected.expected_error`.

    Parameters
    ----------
    found : ErrorMap
    receivers : Receivers, optional
        Drawn on top.
    what : {"gdop", "error", "located"}
        Which of its three grids; "error" has a dashed line where half of the pings are located.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        Equal aspect, metres.
    """
    from matplotlib.colors import LogNorm

    ax = new_axes(ax, (8.0, 6.5))
    value = np.asarray(getattr(found, what), float)
    shown = np.ma.masked_invalid(value)
    norm: Any = None
    finite = value[np.isfinite(value)]
    if what != "located" and finite.size:
        low = max(float(finite.min()), 1e-6)
        norm = LogNorm(low, max(float(np.quantile(finite, 0.95)), 1.05 * low))
    limits = {"vmin": 0.0, "vmax": 1.0} if what == "located" else {"norm": norm}
    colours = "viridis" if what == "located" else "viridis_r"
    mesh = ax.pcolormesh(found.x, found.y, shown, cmap=colours, shading="nearest", **limits)
    ax.figure.colorbar(mesh, ax=ax, extend="neither" if what == "located" else "max")
    half = found.located
    if what == "error" and half.min() < 0.5 < half.max():
        ax.contour(found.x, found.y, half, [0.5], colors=[INK], linestyles="dashed")
    if receivers is not None:
        ax.plot(*receivers.xy.T, "^", color="white", mec=INK, ms=7, ls="none", zorder=5)
    ax.set_aspect("equal", adjustable="box")
    ax.ticklabel_format(useOffset=False, style="plain")
    return tidy(ax, "x (m)", "y (m)", _TITLES[what])
