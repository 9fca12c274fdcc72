"""How far the log likelihood can be off where far receivers are left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maloc.data._encounter_gaps import most_missed
from maloc.data._encounter_states import chain, considered, interpolate
from maloc.data.encounters import EncounterHistory
from maloc.errors import InputError

__all__ = ["bound"]


def bound(
    history: EncounterHistory,
    scale: float,
    p0: float,
    margin: float,
    curve: Callable[[np.ndarray], np.ndarray] | None,
) -> float:
    """The bound that `EncounterHistory.prune_bound` describes."""
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
