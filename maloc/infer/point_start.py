"""Starting positions from single pings: population Monte Carlo, before any movement model."""

from __future__ import annotations

import numpy as np

from maloc.errors import InputError
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

__all__ = ["checked_positions", "pmc_positions"]

_SIGMA = 2.0  # m; a start needs no better, and finding it costs more than all the rest
_REFLECTED = 0.1
_LEAST = 3  # arrivals


def checked_positions(args: tuple, positions: np.ndarray | str | None) -> np.ndarray | None:
    """Positions to start from: those given, those of "pmc", or None (the middle of the array).

    Raises
    ------
    InputError
        If there is no such way to find positions, or the model has no arrival times.
    """
    if positions is None or not isinstance(positions, str):
        return positions
    if positions != "pmc":
        raise InputError(f"positions '{positions}' are unknown", mend="'pmc', or an array (T, 2)")
    if not (args and isinstance(args[0], ToaData | JointData)):
        raise InputError("positions='pmc' needs a model of arrival times")
    return pmc_positions(args[0])


def pmc_positions(data: ToaData | JointData) -> np.ndarray | None:
    """Positions (T, 2) m of all states; straight lines in time between the pings located.

    Parameters
    ----------
    data : ToaData or JointData
        T states.

    Returns
    -------
    array or None
        None where fewer than two pings have three arrivals.
    """
    from maloc.points._pmc import pmc
    from maloc.points._problem import problem_of

    heard = np.asarray(data.heard)
    rows = np.flatnonzero(heard.sum(axis=1) >= _LEAST)
    if len(rows) < 2:
        return None
    ranges = np.where(heard, np.asarray(data.range), np.nan)[rows]
    below = np.zeros(ranges.shape)
    if data.depth is not None:
        below += np.asarray(data.depth.receiver) - np.asarray(data.depth.initial)[rows, None]
    receivers = np.asarray(data.receiver_xy)
    problem, _ = problem_of(ranges, receivers, below, np.full(ranges.shape, _SIGMA))
    found = pmc(problem, 2, n_particles=100, iterations=2, kernels=20, reflected=_REFLECTED)
    sure = np.isfinite(found.position).all(axis=1)
    if sure.sum() < 2:
        return None
    time, where = np.asarray(data.time), found.position[sure]
    tag = np.asarray(data.tag) if isinstance(data, JointData) else np.zeros(len(time), int)
    out = np.tile(where.mean(axis=0), (len(time), 1))
    for one in np.unique(tag[rows[sure]]):
        mine, seen = tag == one, tag[rows[sure]] == one
        at = time[rows[sure]][seen]
        out[mine] = np.stack([np.interp(time[mine], at, where[seen, i]) for i in (0, 1)], axis=1)
    return out
