"""How far the log likelihood can be off where far receivers are left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maloc.data.encounters import EncounterHistory
from maloc.errors import InputError
from maloc.model_data.gaps import most_missed
from maloc.model_data.states import chain, considered, interpolate

__all__ = ["prune_bound"]


def prune_bound(
    history: EncounterHistory,
    scale: float,
    p0: float = 1.0,
    margin: float = 0.0,
    curve: Callable[[np.ndarray], np.ndarray] | None = None,
) -> float:
    """Return the most that pruning can change the log likelihood by.

    A receiver left out at distance d >= reach and not heard adds log(1 - p(d)) to a ping's log
    likelihood; with whole-ping loss, log(pi + (1 - pi) prod (1 - p)) changes by no more. If
    the path stays within `margin` of the positions pruned by and p falls with distance, then::

        |error| <= sum over pings of e + sum over gaps of n max e,
        e(state) = sum over receivers left out of -log(1 - p(d - margin)),

    n the most pings the gap can hold, e taken at its nodes: a gap's likelihood is a sum over
    counts m <= n of integrals of m chances of silence, each changed by a factor exp(-e) at
    most. (Poisson: n is the mean number of pings in the gap, by its closed form.)

    Parameters
    ----------
    history : EncounterHistory
        Pruned (`EncounterHistory.prune`).
    scale : float
        Detection scale of the half-normal p0 exp(-d^2 / (2 scale^2)), m.
    p0 : float
        Its height.
    margin : float
        How far the path may be from the positions, m.
    curve : callable, optional
        Detection probability of distances (m), falling, instead of the half-normal.

    Raises
    ------
    InputError
        If the numbers are no detection function.
    """
    if not (scale > 0 and 0 <= p0 <= 1 and margin >= 0):
        raise InputError(f"scale {scale:g}, p0 {p0:g}, margin {margin:g}: no detection function")
    if history.near is None:
        return 0.0
    states = chain(history)
    at = interpolate(history, states, history.near)
    away = np.hypot(*(at[:, None] - history.receivers.xy[None]).transpose(2, 0, 1))
    nearest = np.maximum(away - margin, 0.0)
    p = p0 * np.exp(-0.5 * (nearest / scale) ** 2) if curve is None else curve(nearest)
    dropped = history.listening_at(states.time) & ~considered(history, states)
    with np.errstate(divide="ignore"):
        off = np.where(dropped, -np.log1p(-np.minimum(p, 1.0)), 0.0).sum(axis=1)
    total = float(off[states.row >= 0].sum())
    for gap, _, nodes in states.gaps:
        if len(nodes):
            total += most_missed(history, gap) * float(off[nodes].max())
    return total
