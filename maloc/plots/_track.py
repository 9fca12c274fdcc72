"""The map of a posterior track."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._map import draw_map
from maloc.plots._source import track_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.data.receivers import Receivers

__all__ = ["track"]


def track(
    source: Any,
    receivers: Receivers | None = None,
    *,
    truth: np.ndarray | None = None,
    truth_label: str = "truth",
    label: str = "track",
    colour: str | None = None,
    title: str = "",
    ax: Any = None,
) -> Axes:
    """Map of a track: posterior mean, 95 % ellipses, receivers.

    Parameters
    ----------
    source : Fit, InferenceData, DataTree or DataFrame
        A fit, what its `to_inference_data` gives, or the table of track.csv (which has the unheard
        pings too).
    receivers : Receivers, optional
        The array.
    truth : array (K, 2), optional
        True or GPS positions, m, in the receivers' frame.
    truth_label, label, title : str
        For legend and heading.
    colour : str, optional
        Of line and ellipses.
    ax : Axes, optional
        Axes to draw on (several tracks may share one); new ones where None.

    Returns
    -------
    Axes

    Raises
    ------
    InputError
        If `source` holds no positions.
    """
    found = track_of(source)
    return draw_map(
        found.mean,
        found.cov,
        np.empty((0, 2)) if receivers is None else receivers.xy,
        heard=found.heard,
        time=found.time if colour is None else None,
        names=None if receivers is None else receivers.labels,
        mirror=found.mirror,
        truth=truth,
        truth_label=truth_label,
        label=label,
        colour=colour,
        title=title,
        ax=ax,
    )
