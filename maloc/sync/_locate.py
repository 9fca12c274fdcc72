"""Where on the common clock recorded times lie, and how sure that is."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.sync._curve import hermite, to_common
from maloc.sync._prepare import seconds

if TYPE_CHECKING:
    from maloc.sync._clocks import Clocks

__all__ = ["SURE", "TWICE", "UNSURE", "Located", "locate", "offset_of", "offset_sd"]

SURE, UNSURE, TWICE, UNSYNCED = 0, 1, 2, 3


class Located(NamedTuple):
    """Arrays (N,): clock (-1 = not synchronised), jumps before, common time (s), status."""

    clock: np.ndarray
    segment: np.ndarray
    common: np.ndarray
    status: np.ndarray


def locate(sync: Clocks, receiver: np.ndarray, time: np.ndarray) -> Located:
    """Find the common time of recorded times.

    Parameters
    ----------
    sync : Clocks
    receiver : array (N,) of str
    time : array (N,) of int64
        Recorded, ns since 1970.
    """
    names, inverse = np.unique(np.asarray(receiver, dtype=str), return_inverse=True)
    number = {name: i for i, name in enumerate(sync.receivers.names)}
    clock = np.array([number.get(str(r), -1) for r in names], int)
    clock = clock[inverse] if len(names) else np.zeros(0, int)
    clock = np.where((clock >= 0) & sync.synced[clock], clock, -1)
    recorded = (np.asarray(time, np.int64) - sync.origin) * 1e-9
    state = np.nan_to_num(np.stack([sync.values.T, sync.slopes.T * sync.spacing], axis=-1))
    first, j = float(sync.knots[0]), sync.jumps

    def common_of(rows: np.ndarray, lead: float) -> np.ndarray:
        own = np.maximum(clock[rows], 0)
        return to_common(state, first, sync.spacing, own, recorded[rows] - lead)

    common, segment = common_of(np.arange(len(clock)), 0.0), np.zeros(len(clock), int)
    status = np.where(clock < 0, UNSYNCED, SURE)
    for name in np.unique(j.receiver):
        rows = np.flatnonzero(clock == number.get(str(name), -2))
        own = np.flatnonzero(j.receiver == name)
        own = own[np.argsort(j.time[own])]
        lead = np.concatenate([[0.0], np.cumsum(j.size[own])])
        low = np.concatenate([[-np.inf], j.high[own]])  # for sure on a stretch between these
        high = np.concatenate([j.low[own], [np.inf]])
        sure, near = np.zeros(len(rows), int), np.full(len(rows), np.inf)
        for n in range(len(lead)):
            t = common_of(rows, float(lead[n]))
            away = np.maximum(low[n] - t, t - high[n])
            inside = away <= 1e-6
            better = away < near
            common[rows[better]], segment[rows[better]] = t[better], n
            near = np.minimum(near, away)
            sure += inside
        status[rows] = np.select([sure == 1, sure > 1], [SURE, TWICE], UNSURE)
    return Located(clock, segment, common, status)


def offset_sd(
    sync: Clocks, clock: np.ndarray, segment: np.ndarray, common: np.ndarray
) -> np.ndarray:
    """Standard error (N,) of the offset of clocks at common times, s.

    Between knots the walk's own spread is added to that of the curve (a bridge); beyond the end
    knots the curve goes on straight and its error grows with it.
    """
    n_knots, n_clocks = len(sync.knots), len(sync.values)
    number = {name: i for i, name in enumerate(sync.receivers.names)}
    at = np.clip((sync.jumps.time - sync.knots[0]) / sync.spacing, 0, n_knots - 2).astype(int)
    owner = np.array([number[str(r)] for r in sync.jumps.receiver], int)
    base = np.cumsum([0, *(n_knots - 1 + np.bincount(owner, minlength=n_clocks))[:-1]])
    place = (common - sync.knots[0]) / sync.spacing
    inside = np.clip(place, 0.0, n_knots - 1)
    knot = np.minimum(inside.astype(int), n_knots - 2)
    # an interval with jumps is listed once for each side: keep within the stretch's own
    low, high = np.zeros(len(clock), int), np.full(len(clock), n_knots - 2)
    for j in np.unique(owner):
        mine = clock == j
        edges = np.maximum.accumulate(np.sort(at[owner == j]))
        low[mine] = np.concatenate([[0], edges])[segment[mine]]
        high[mine] = np.concatenate([edges, [n_knots - 2]])[segment[mine]]
    k = np.clip(knot, low, high)
    u = inside - k
    w = hermite(u)
    beyond = place - inside
    w[:, 1] += np.where(beyond < 0, beyond, 0.0)
    w[:, 3] += np.where(beyond > 0, beyond, 0.0)
    cov = sync.covariance[base[clock] + k + segment]
    q = sync.noise[clock] * sync.spacing**3
    u = np.clip(u, 0.0, 1.0)
    bridge = q * (u * (1 - u)) ** 3 / 3 + q * np.abs(beyond) ** 3 / 3
    return np.sqrt(np.maximum(np.einsum("na,nab,nb->n", w, cov, w), 0.0) + bridge)


def offset_of(sync: Clocks, receiver: object, time: object) -> np.ndarray:
    """See `maloc.sync.ClockSync.offset`."""
    time = np.atleast_1d(np.asarray(time, np.int64))
    at = locate(sync, np.broadcast_to(np.asarray(receiver, dtype=str), time.shape), time)
    return np.where(at.status == SURE, seconds(time, sync.origin) - at.common, np.nan)
