"""From raw detections to everything that the joint fit of the clocks needs."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.data._time import NS
from maloc.errors import FitError, InputError
from maloc.sync import _arrivals, _model
from maloc.sync._prepare import Curve, Grouped, SyncData, alignment_notes, collect, group
from maloc.sync._progress import Tell, silent
from maloc.sync._speed import Speed, speed_of

__all__ = ["Prepared", "prepare"]


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Everything that a joint fit needs, and what its outcome is told with.

    Parameters
    ----------
    detections : Detections
    receivers : Receivers
    origin : int
        ns since 1970 of second 0.
    data : SyncData
    grouped : Grouped
    used : array (U,) of int
        Rows of `data` that are in the fit, in the order of `arrivals`.
    arrivals : Arrivals
    common : array (U,)
        Coarse common times, s.
    state : array (K, R, 2)
        Coarse clocks at the knots.
    geometry : Geometry
    grid : Grid
    speed : Speed
    notes : tuple of Note
    """

    detections: Detections
    receivers: Receivers
    origin: int
    data: SyncData
    grouped: Grouped
    used: np.ndarray
    arrivals: _arrivals.Arrivals
    common: np.ndarray
    state: np.ndarray
    geometry: _arrivals.Geometry
    grid: _model.Grid
    speed: Speed
    notes: tuple[Note, ...]


def prepare(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: Any,
    sound_speed_sd: float = 0.0,
    reference: object,
    knot_spacing: float,
    free_positions: Any,
    tell: Tell = silent,
) -> Prepared:
    """Check, pick the sync detections, align them coarsely and lay the joint fit out."""
    if len(detections) == 0:
        raise InputError("no detections to synchronise")
    if len(detections.receivers) == 1:
        only = detections.receivers[0]
        raise InputError(f"1 receiver ({only}) in the detections: no clock to compare it with")
    if not (np.isfinite(knot_spacing) and knot_spacing >= 10.0):
        raise InputError(f"knot_spacing must be at least 10, got {knot_spacing}")
    names, sd = receivers.names, np.asarray(free_positions, float)
    if not (np.isfinite(sd).all() and (sd >= 0).all()):
        raise InputError(f"free_positions must be at least 0, got {free_positions}")
    if sd.ndim and sd.shape != (len(receivers),):
        raise InputError(
            f"free_positions has shape {sd.shape}, not one number for each of the "
            f"{len(receivers)} rows of the receivers' table"
        )
    if reference is not None and str(reference) not in names:
        raise InputError(
            f"reference receiver '{reference}' is not in the receivers' table",
            mend=f"choose one of {', '.join(names)}",
        )
    origin = int(detections.time.min()) // NS * NS
    speed = speed_of(sound_speed, origin, int(detections.time.max()), sound_speed_sd)
    data, notes = collect(detections, receivers, origin)
    xyz = _coordinates(receivers)
    travel = _arrivals.distances(xyz, data.place, data.source) / speed.mean
    asked = None if reference is None else names.index(str(reference))
    grouped = group(data, travel, asked, len(names), tell)
    notes += tuple(alignment_notes(data, grouped.clocks, names))
    used = np.flatnonzero(grouped.why == "")
    ref = grouped.reference
    if len(grouped.clocks) < 2 or len(used) == 0:
        raise FitError(
            f"no clock could be aligned with that of receiver {names[ref]}: no sync ping was "
            "heard by two receivers at an offset within 26 h; check sync_tag in the receivers' "
            "table"
        )
    if ref not in grouped.clocks:
        raise FitError(
            f"the clock of the reference receiver {names[ref]} could not be aligned with the "
            f"others; choose one of {', '.join(names[j] for j in sorted(grouped.clocks))}"
        )
    used = used[np.lexsort((data.clock[used], grouped.ping[used]))]
    common = grouped.common[used]
    grid = _grid(common, knot_spacing)
    arrivals = _arrivals.Arrivals(
        data.recorded[used],
        data.clock[used],
        np.unique(grouped.ping[used], return_inverse=True)[1],
        data.place[used],
        data.source[used],
        grouped.segment[used],
    )
    geometry = _arrivals.Geometry(
        xyz, np.broadcast_to(sd, (len(receivers),)), speed.mean, speed.sd, speed.at(grid.time)
    )
    state = _start(grouped.curves, len(names), grid)
    return Prepared(
        detections, receivers, origin, data, grouped, used, arrivals, common, state, geometry,
        grid, speed, notes,
    )  # fmt: skip


def _coordinates(receivers: Receivers) -> np.ndarray:
    """Places (D, 3); depth counts only where it is known everywhere."""
    z = receivers.depth if np.isfinite(receivers.depth).all() else np.zeros(len(receivers))
    return np.column_stack([receivers.xy, z])


def _grid(common: np.ndarray, most: float) -> _model.Grid:
    first, last = float(common.min()) - 1.0, float(common.max()) + 1.0
    n = max(1, int(np.ceil((last - first) / most)))
    return _model.Grid(first, (last - first) / n, n + 1)


def _start(curves: dict[int, Curve], n_clocks: int, grid: _model.Grid) -> np.ndarray:
    """State (K, R, 2) at the knots from the coarse offsets; 0 for clocks without one."""
    state = np.zeros((grid.n, n_clocks, 2))
    for j, curve in curves.items():
        state[:, j, 0] = curve.at(grid.time)
        half = grid.spacing / 2
        state[:, j, 1] = curve.at(grid.time + half) - curve.at(grid.time - half)
    return state
