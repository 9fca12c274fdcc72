"""The map from plain arrays: ellipses, track, receivers; it knows no fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._style import CYCLE, INK, PALE, TRUTH, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_map", "ellipse_axes"]

CHI2_95 = 5.991464547107979  # 95 % point of chi-square with 2 degrees of freedom, -2 log .05


def ellipse_axes(cov: np.ndarray, level: float = 0.95) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the axes of the ellipses that hold `level` of normal distributions.

    Parameters
    ----------
    cov : array (T, 2, 2)
        Covariances, m2.
    level : float
        Share of the mass inside, between 0 and 1.

    Returns
    -------
    width, height : array (T,)
        Full lengths of the longer and the shorter axis, m.
    angle : array (T,)
        Direction of the longer axis, degrees from x towards y.
    """
    value, vector = np.linalg.eigh(np.asarray(cov, float))
    half = np.sqrt(np.maximum(value, 0.0) * -2.0 * np.log1p(-level))
    angle = np.degrees(np.arctan2(vector[:, 1, 1], vector[:, 0, 1]))
    return 2 * half[:, 1], 2 * half[:, 0], angle


def draw_map(
    mean: np.ndarray,
    cov: np.ndarray,
    receivers: np.ndarray,
    *,
    heard: np.ndarray | None = None,
    time: np.ndarray | None = None,
    names: tuple[str, ...] | None = None,
    mirror: np.ndarray | None = None,
    truth: np.ndarray | None = None,
    truth_label: str = "truth",
    label: str = "track",
    colour: str | None = None,
    title: str = "",
    ax: Any = None,
) -> Axes:
    """Draw one track with its 95 % ellipses, receivers, and what is known otherwise.

    Parameters
    ----------
    mean : array (T, 2)
        Posterior mean positions, m.
    cov : array (T, 2, 2)
        Posterior covariances, m2.
    receivers : array (R, 2)
        Receivers' positions, m; may be empty where they are on the axes already.
    heard : array (T,) of bool, optional
        Pings that nobody heard get hollow ellipses.
    time : array (T,), optional
        Colours the positions from dark (first) to light (last).
    names : tuple of str, optional
        Receivers' names; written where there are at most 40.
    mirror : array (T, 2), optional
        The mirror images of the positions, where receivers on one line cannot tell them apart.
    truth : array (K, 2), optional
        True or GPS positions, m.
    truth_label, label, title : str
        For legend and heading.
    colour : str, optional
        Of line and ellipses.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        Equal aspect, metres.
    """
    from matplotlib.collections import EllipseCollection

    ax = new_axes(ax, (7.5, 7.0))
    mean = np.asarray(mean, float).reshape(-1, 2)
    receivers = np.asarray(receivers, float).reshape(-1, 2)
    heard = np.ones(len(mean), bool) if heard is None else np.asarray(heard, bool)
    colour = colour or CYCLE[0]
    width, height, angle = ellipse_axes(cov)

    def ellipses(which: np.ndarray, **style: Any) -> None:
        if which.any():
            ax.add_collection(
                EllipseCollection(
                    width[which],
                    height[which],
                    angle[which],
                    units="xy",
                    offsets=mean[which],
                    offset_transform=ax.transData,
                    **style,
                ),
                autolim=False,
            )

    ellipses(~heard, facecolors="none", edgecolors=PALE, linewidths=0.7, zorder=2)
    ellipses(heard, facecolors=colour, edgecolors="none", alpha=0.16, zorder=2)
    if mirror is not None:
        other = np.asarray(mirror, float)
        ax.plot(*other.T, color=colour, lw=1.0, ls=(0, (3, 2)), zorder=3, label="mirror image")
    ax.plot(*mean.T, color=colour, lw=1.0, alpha=0.8, zorder=3, label=label)
    shown = mean[heard]
    if time is not None and len(shown):
        ax.scatter(*shown.T, c=np.asarray(time)[heard], cmap="viridis", s=10, lw=0, zorder=4)
    elif len(shown):
        ax.scatter(*shown.T, color=colour, s=7, lw=0, zorder=4)
    if len(mean):
        ax.plot(*mean[0], "o", mfc="white", mec=colour, ms=7, mew=1.5, zorder=5, label="first ping")
    if truth is not None and len(truth):
        ax.plot(*np.asarray(truth).T, color=TRUTH, lw=1.2, zorder=3.5, label=truth_label)
    if len(receivers):
        ax.plot(
            *receivers.T,
            "^",
            color=INK,
            ms=7,
            mec="white",
            mew=0.8,
            zorder=6,
            ls="none",
            label="receiver",
        )
        if names is not None and len(names) <= 40:
            for (x, y), name in zip(receivers, names, strict=True):
                ax.annotate(
                    name,
                    (x, y),
                    (4, 4),
                    textcoords="offset points",
                    fontsize=7,
                    color=INK,
                    zorder=7,
                )
    _frame(ax, [mean, receivers, mirror, truth], np.concatenate([width, [0.0]]).max())
    return tidy(ax, "x (m)", "y (m)", title)


def _frame(ax: Axes, points: list[Any], widest: float) -> None:
    """Equal aspect around all points, with room for the ellipses but not for wild ones."""
    xy = [np.asarray(p, float).reshape(-1, 2) for p in points if p is not None]
    known = ax.dataLim if ax.has_data() else None
    every = np.concatenate([*xy, np.asarray(known.get_points())] if known is not None else xy)
    every = every[np.isfinite(every).all(1)]
    ax.set_aspect("equal", adjustable="box")
    if not len(every):
        return
    low, high = every.min(0), every.max(0)
    span = max((high - low).max(), 1.0)
    room = 0.06 * span + min(widest / 2, 0.1 * span)
    # a long thin track still gets a readable frame
    half = np.maximum((high - low) / 2, 0.2 * span) + room
    middle = (low + high) / 2
    ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
    ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.locator_params(nbins=6)
