"""Where pings were heard and where a detection model puts them: the paper's figures 2 and 3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._style import INK, TRACK, TRUTH, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.data import Receivers

__all__ = ["audibility", "localizations"]


def audibility(
    receivers: Receivers,
    p0: float,
    scale: float,
    *,
    low: np.ndarray,
    high: np.ndarray,
    title: str = "",
    ax: Any = None,
) -> Axes:
    """Map of the chance that a ping sent there is heard by one receiver or more.

    Parameters
    ----------
    receivers : Receivers
        The array.
    p0, scale : float
        Half-normal detection p0 exp(-d^2 / (2 scale^2)), scale in m.
    low, high : array (2,)
        Corners of the map, m.
    title : str
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes(ax)
    x, y = (np.linspace(low[i], high[i], 121) for i in (0, 1))
    place = np.stack(np.meshgrid(x, y), axis=-1)
    squared = ((place[:, :, None] - receivers.xy) ** 2).sum(axis=-1)
    unheard = np.prod(1 - p0 * np.exp(-squared / (2 * scale**2)), axis=-1)
    shown = ax.pcolormesh(x, y, 1 - unheard, cmap="Blues", vmin=0, vmax=1, shading="gouraud")
    ax.get_figure(root=True).colorbar(shown, ax=ax, label="chance of being heard")  # pyright: ignore
    _stations(ax, receivers, "white")
    return _square(ax, title)


def localizations(
    receivers: Receivers,
    *,
    truth: np.ndarray | None = None,
    n_heard: np.ndarray | None = None,
    draws: np.ndarray | None = None,
    title: str = "",
    ax: Any = None,
) -> Axes:
    """Map of one tag's true path, of what was heard of it, and of posterior draws.

    Parameters
    ----------
    receivers : Receivers
        The array.
    truth : array (P, 2), optional
        True positions in order of time, m.
    n_heard : array (P,) of int, optional
        How many receivers heard each ping: unheard ones are open, others grow with it.
    draws : array (D, K, 2), optional
        Posterior draws of the positions of K pings, m.
    title : str
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes(ax)
    if draws is not None:
        flat = np.reshape(draws, (-1, 2))
        ax.plot(*flat.T, ".", color=INK, ms=1.5, alpha=min(1.0, 1500 / len(flat)), zorder=1)
    if truth is not None:
        ax.plot(*truth.T, color=TRUTH, lw=1.0, zorder=3)
        n = np.ones(len(truth)) if n_heard is None else np.asarray(n_heard)
        size = 4 + 5 * n
        for rows, face in ((n > 0, TRUTH), (n == 0, "white")):
            ax.scatter(
                *truth[rows].T, s=size[rows], facecolor=face, edgecolor=TRUTH, lw=0.7, zorder=4
            )
    _stations(ax, receivers)
    return _square(ax, title)


def _stations(ax: Axes, receivers: Receivers, colour: str = TRACK) -> None:
    ax.plot(receivers.x, receivers.y, "x", color=colour, ms=4, mew=1.0, zorder=2)


def _square(ax: Axes, title: str) -> Axes:
    tidy(ax, "x (m)", "y (m)", title)
    ax.set_aspect("equal")
    return ax
