"""How well a fit went: parameters, what was heard, uncertainty over time, chains."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._residuals import draw_arrivals, draw_residuals
from maloc.plots._source import Track, posterior, track_of
from maloc.plots._style import CYCLE, INK, LATE, TRACK, legend_above, new_axes, tidy, time_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["diagnostics", "heard", "intervals", "parameters", "spread", "trace"]


def diagnostics(
    fit: Any,
    table: Any = None,
    names: tuple[str, ...] | None = None,
    *,
    title: str = "",
    figure: Any = None,
) -> np.ndarray:
    """Draw six panels: residuals, arrivals by receiver, parameters, heard, spread, chains.

    Parameters
    ----------
    fit : Fit
        A fitted arrival-time model.
    table : DataFrame, optional
        The table of track.csv, which has the unheard pings too.
    names : tuple of str, optional
        Receivers' names, one a column of the arrival-time matrix.
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
    draws, residual, p_direct = posterior(fit), fit.residuals(), fit.p_direct()
    time = draws["emission_time"].mean((0, 1))
    draw_residuals(time, residual, p_direct, ax=axes[0, 0])
    draw_arrivals(residual, p_direct, names, ax=axes[0, 1])
    _draw_parameters(draws, fit.parameters(), axes[0, 2])
    track = track_of(fit if table is None else table)
    n_heard = None if table is None else np.asarray(table["n_receivers"].to_numpy())
    if n_heard is None:
        n_heard = np.isfinite(residual).sum(1)
    heard(track.time, n_heard, ax=axes[1, 0])
    spread(track, ax=axes[1, 1])
    if getattr(fit, "method", "laplace") == "laplace":
        intervals(time, ax=axes[1, 2])
    else:
        _draw_trace(draws, [p["name"] for p in fit.parameters()], axes[1, 2])
    if title:
        figure.suptitle(title, x=0.05, ha="left", fontsize="large", fontweight="bold", color=INK)
    return axes


def heard(time: np.ndarray, n_receivers: np.ndarray, *, ax: Any = None) -> Axes:
    """Number of receivers that heard each ping (T,), over time (T,) s; unheard ones marked."""
    ax = new_axes(ax)
    since, label = time_axis(time)
    n = np.asarray(n_receivers)
    ax.vlines(since[n > 0], 0, n[n > 0], color=TRACK, lw=0.8, alpha=0.5, zorder=2)
    ax.plot(since[n > 0], n[n > 0], ".", color=TRACK, ms=4, zorder=3)
    ax.plot(since[n == 0], n[n == 0], "x", color=LATE, ms=4, zorder=3)
    ax.set_ylim(bottom=-0.4)
    ax.yaxis.get_major_locator().set_params(integer=True)
    return tidy(ax, label, "receivers", f"Receivers a ping ({int((n == 0).sum())} unheard)")


def spread(track: Track, *, ax: Any = None) -> Axes:
    """Posterior standard deviation of x and y (m) over time, logarithmic where it varies much."""
    ax = new_axes(ax)
    since, label = time_axis(track.time)
    for axis, colour, name in ((0, CYCLE[0], "x"), (1, CYCLE[4], "y")):
        sd = np.sqrt(track.cov[:, axis, axis])
        ax.plot(since, sd, "-", color=colour, lw=1.0, zorder=3, label=name)
        ax.plot(since[~track.heard], sd[~track.heard], "o", mfc="none", mec=colour, ms=4, zorder=3)
    sd = np.sqrt(np.concatenate([track.cov[:, 0, 0], track.cov[:, 1, 1]]))
    sd = sd[np.isfinite(sd) & (sd > 0)]
    if len(sd) and sd.max() > 5 * sd.min():
        ax.set_yscale("log", subs=[2, 5])
        ax.yaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
    tidy(ax, label, "sd (m)", "Posterior sd (circles: unheard)")
    return legend_above(ax)


def intervals(time: np.ndarray, *, ax: Any = None) -> Axes:
    """Histogram of the intervals between successive heard pings' emission times (T,) s."""
    ax = new_axes(ax)
    gap = np.diff(np.asarray(time, float))
    gap = gap[np.isfinite(gap)]
    if len(gap):
        top = np.quantile(gap, 0.98) * 1.05
        ax.hist(gap[gap <= top], bins=40, color=TRACK, zorder=3)
    return tidy(ax, "interval (s)", "pings", "Intervals between heard pings")


def parameters(fit: Any, *, ax: Any = None) -> Axes:
    """Posterior density of every parameter, each on its own scale, with mean and 95 %."""
    return _draw_parameters(posterior(fit), fit.parameters(), new_axes(ax))


def trace(fit: Any, *, ax: Any = None) -> Axes:
    """Chains of every parameter, standardised and stacked: what mixes well looks like noise."""
    return _draw_trace(posterior(fit), [p["name"] for p in fit.parameters()], new_axes(ax))


def _draw_parameters(draws: dict[str, np.ndarray], rows: list[dict], ax: Axes) -> Axes:
    for i, row in enumerate(reversed(rows)):
        low, high, mean = row["q2.5"], row["q97.5"], row["mean"]
        half = max(high - low, 1e-12 * max(abs(mean), 1.0))
        values = draws.get(row["name"])
        edges = np.linspace(low - 0.5 * half, high + 0.5 * half, 41)
        if values is not None and values.ndim == 2 and high > low:
            count = np.histogram(values.ravel(), edges)[0].astype(float)
            height = np.repeat(0.6 * count / max(count.max(), 1.0), 2)
            where = np.repeat((edges - low) / half, 2)[1:-1]
            ax.fill_between(where, i, i + height, color=TRACK, alpha=0.35, lw=0, zorder=2)
        ax.plot([0, 1], [i, i], color=TRACK, lw=2.5, solid_capstyle="butt", zorder=3)
        ax.plot((mean - low) / half, i, "o", color=TRACK, ms=5, zorder=4)
        unit = f" {row['unit']}" if row.get("unit") else ""
        mean, low, high = _digits(mean, low, high)
        text = f"{row['name']}  {mean}{unit}  ({low} to {high})"
        ax.text(-0.5, i + 0.68, text, fontsize=8, color=INK, va="bottom")
    ax.set_ylim(-0.4, max(len(rows), 1) + 0.1)
    ax.set_xlim(-0.55, 1.55)
    tidy(ax, "", "", "Parameters: density, mean, 95 %")
    ax.grid(False)
    ax.set_yticks([])
    ax.set_xticks([])
    ax.spines[["left", "bottom"]].set_visible(False)
    return ax


def _draw_trace(draws: dict[str, np.ndarray], names: list[str], ax: Axes) -> Axes:
    shown = [n for n in names if n in draws and draws[n].ndim == 2]
    for i, name in enumerate(reversed(shown)):
        values = draws[name]
        scale = max(float(values.std()), 1e-300)
        for c, chain in enumerate(values):
            z = i + 0.5 + 0.12 * (chain - values.mean()) / scale
            ax.plot(z, color=CYCLE[c % len(CYCLE)], lw=0.4, alpha=0.8, zorder=3)
    ax.set_yticks(np.arange(len(shown)) + 0.5, list(reversed(shown)), fontsize=8)
    tidy(ax, "draw", "", "Chains (standardised)")
    return ax


def _digits(mean: float, low: float, high: float) -> tuple[str, str, str]:
    """Three numbers, written to two digits of their range."""
    spread = max(high - low, 1e-12)
    places = max(0, 1 - int(np.floor(np.log10(spread))))
    mean_text, low_text, high_text = (f"{v:.{places}f}" for v in (mean, low, high))
    return mean_text, low_text, high_text
