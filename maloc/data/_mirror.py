"""The mirror image that receivers on one line cannot tell from the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.receivers import Receivers, collinear

__all__ = ["Line", "mirror_line", "reflect"]


class Line(NamedTuple):
    """A line in the plane: a point on it (2,) m and its direction (2,), length 1."""

    point: np.ndarray
    direction: np.ndarray


def mirror_line(receivers: Receivers, used: np.ndarray | None = None) -> Line | None:
    """Return the line on which all receivers stand, None when they do not.

    Parameters
    ----------
    receivers : Receivers
        At least one deployment in use.
    used : array (D,) of bool, optional
        Deployments that heard the tag; only these tell where it was.

    Returns
    -------
    Line or None
        None also where all stand at one place, which has no direction.
    """
    heard = receivers if used is None else receivers.subset(np.asarray(used, bool))
    if not len(heard) or not collinear(heard):
        return None
    centred = heard.xy - heard.xy.mean(0)
    _, size, axes = np.linalg.svd(centred, full_matrices=False)
    if size[0] <= 1e-9:
        return None
    return Line(heard.xy.mean(0), axes[0])


def reflect(xy: np.ndarray, line: Line) -> np.ndarray:
    """Return the mirror images of points (..., 2) in a line."""
    offset = np.asarray(xy, float) - line.point
    along = (offset @ line.direction)[..., None] * line.direction
    return line.point + 2 * along - offset
