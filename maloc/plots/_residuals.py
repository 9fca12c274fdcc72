"""Residuals of arrivals, and which of them came late."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._source import posterior
from maloc.plots._style import LATE, TRACK, legend_above, new_axes, tidy, time_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_arrivals", "draw_residuals", "paths", "residuals"]


def residuals(fit: Any, *, ax: Any = None) -> Axes:
    """Residual of every arrival over time, coloured by its probability of the direct path.

    Parameters
    ----------
    fit : Fit
        A fitted arrival-time model.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        Milliseconds, linear around 0 and logarithmic far from it.
    """
    time = posterior(fit)["emission_time"].mean((0, 1))
    return draw_residuals(time, fit.residuals(), fit.p_direct(), ax=ax)


def paths(fit: Any, names: tuple[str, ...] | None = None, *, ax: Any = None) -> Axes:
    """Number of direct and of late arrivals at each receiver.

    Parameters
    ----------
    fit : Fit
        A fitted arrival-time model.
    names : tuple of str, optional
        Receivers' names, one a column of the arrival-time matrix.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        One stacked bar a receiver; expected numbers, sums of the probabilities.
    """
    return draw_arrivals(fit.residuals(), fit.p_direct(), names, ax=ax)


def draw_residuals(
    time: np.ndarray, residual: np.ndarray, p_direct: np.ndarray, *, ax: Any = None
) -> Axes:
    """Draw residuals (T, R) s against times (T,) s, coloured by p_direct (T, R)."""
    ax = new_axes(ax)
    since, label = time_axis(time)
    residual, p_direct = np.asarray(residual, float), np.asarray(p_direct, float)
    t, r = np.nonzero(np.isfinite(residual))
    e, p = 1e3 * residual[t, r], p_direct[t, r]
    order = np.argsort(-p, kind="stable")  # late ones on top
    points = ax.scatter(
        since[t][order],
        e[order],
        c=p[order],
        cmap=_direct_colours(),
        vmin=0.0,
        vmax=1.0,
        s=9,
        lw=0,
        alpha=0.8,
        zorder=3,
    )
    direct = np.abs(e[p > 0.5])
    ordinary = 1.4826 * np.median(direct) if len(direct) else 1.0
    limit = float(f"{max(4 * ordinary, 0.1):.1g}")
    if len(e) and np.abs(e).max() > 5 * limit:
        ax.set_yscale("symlog", linthresh=limit)
        ax.yaxis.set_major_formatter("{x:g}")
    ax.axhline(0.0, color="#777777", lw=0.8, zorder=2)
    figure = ax.get_figure()
    if figure is not None:
        bar = figure.colorbar(points, ax=ax, pad=0.01, fraction=0.05, ticks=[0, 0.5, 1])
        bar.ax.set_title("P(direct)", fontsize=7)
        bar.ax.tick_params(labelsize=7)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return tidy(ax, label, "residual (ms)", f"Residuals of {len(e)} arrivals")


def draw_arrivals(
    residual: np.ndarray,
    p_direct: np.ndarray,
    names: tuple[str, ...] | None = None,
    *,
    ax: Any = None,
) -> Axes:
    """Draw expected numbers of direct and late arrivals at each receiver from (T, R) arrays."""
    ax = new_axes(ax)
    columns = np.shape(residual)[1] if names is None else len(names)
    residual, p_direct = residual[:, :columns], p_direct[:, :columns]  # fits may pad the receivers
    heard = np.isfinite(residual)
    p = np.where(heard, np.nan_to_num(np.asarray(p_direct, float)), 0.0)
    direct, total = p.sum(0), heard.sum(0)
    place = np.arange(len(total))
    ax.bar(place, direct, color=TRACK, width=0.75, zorder=3, label="direct")
    ax.bar(place, total - direct, bottom=direct, color=LATE, width=0.75, zorder=3, label="late")
    names = tuple(str(i + 1) for i in place) if names is None else names
    step = max(1, len(place) // 25)
    ax.set_xticks(place[::step], names[::step], rotation=60, ha="right", fontsize=7)
    tidy(ax, "", "arrivals", "Arrivals at each receiver")
    ax.grid(False, axis="x")
    return legend_above(ax)


def _direct_colours() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("direct", [LATE, "#DDDDDD", TRACK])
