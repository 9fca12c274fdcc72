"""Slant ranges of starts: horizontal distances, and the depths where the data have them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from maloc.world.depth import bottom_at, depth_of, path_at

if TYPE_CHECKING:
    from maloc.infer._model import ChainModel
    from maloc.model_data.joint import JointData
    from maloc.model_data.toa import ToaData

__all__ = ["depth_at", "put_depth", "slant_ranges"]


def slant_ranges(
    data: ToaData | JointData, xy: np.ndarray, depth: np.ndarray | None = None
) -> np.ndarray:
    """Distances (T, ..., R) m from positions (T, ..., 2) to the receivers, at depths (T,) m.

    Horizontal where the data are flat; depths by default as sensed.
    """
    away = np.linalg.norm(xy[..., None, :] - np.asarray(data.receiver_xy), axis=-1)
    if data.depth is None:
        return away
    down = np.asarray(data.depth.square(data.depth.initial if depth is None else depth))
    return np.sqrt(away**2 + down.reshape(len(down), *[1] * (xy.ndim - 2), -1))


def depth_at(data: ToaData | JointData, xy: np.ndarray, values: dict) -> np.ndarray | None:
    """Depths (T,) m of a path, given its sites' values and positions (T, 2)."""
    if data.depth is None or "depth_path" not in values:
        return None
    path = np.asarray(values["depth_path"])[:, 0]
    return np.asarray(depth_of(path, bottom_at(data.depth, xy)))


def put_depth(cm: ChainModel, x: np.ndarray, data) -> None:
    """Write depths as sensed into the flat path (T, d), in place."""
    for site in cm.chain:
        if site.name == "depth_path":
            water = data.depth
            x[:, site.columns.start] = path_at(water.initial, water.bottom)
