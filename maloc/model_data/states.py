"""From an encounter history to the states of one chain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.encounters import EncounterHistory
from maloc.errors import InputError
from maloc.model_data.gaps import Silence, find_gaps, law_of
from maloc.schedule.renewal.gap import gap_nodes

__all__ = ["States", "chain", "considered", "covariates", "interpolate"]

_SAME = 1e-6  # s; a node so near a ping is the ping's own state


class States(NamedTuple):
    """States of the chain, and the gaps between pings.

    Attributes
    ----------
    time, tag : array (S,)
    row : array (S,) of int
        Row of the history; -1 at a node of a gap.
    gaps : list of (Silence, nodes (K,) s after the gap's start, states (K,))
    """

    time: np.ndarray
    tag: np.ndarray
    row: np.ndarray
    gaps: list[tuple[Silence, np.ndarray, np.ndarray]]


def chain(history: EncounterHistory) -> States:
    """Pings and, where missed pings are summed over, nodes inside the gaps, in order of time."""
    found = find_gaps(history)
    nodes: list[np.ndarray] = []
    if found:
        law = law_of(history)
        nodes = [np.asarray(gap_nodes(g.duration, g.kind, law)) for g in found]
    time, tag = [history.time], [history.tag]
    row = [np.arange(len(history))]
    for gap, at in zip(found, nodes, strict=True):
        new = gap.start + at[_fresh(history, gap, at)]
        time.append(new)
        tag.append(np.full(len(new), gap.tag))
        row.append(np.full(len(new), -1))
    times, tags, rows = (np.concatenate(part) for part in (time, tag, row))
    order = np.lexsort((times, tags))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    states, used = [], len(history)
    for gap, at in zip(found, nodes, strict=True):
        fresh = _fresh(history, gap, at)
        mine = np.where(at < gap.duration / 2, gap.before, gap.after)
        mine[fresh] = used + np.arange(fresh.sum())
        used += int(fresh.sum())
        states.append((gap, at, place[mine]))
    return States(times[order], tags[order], rows[order], states)


def _fresh(history: EncounterHistory, gap: Silence, at: np.ndarray) -> np.ndarray:
    """Which nodes need a state of their own, (K,)."""
    old = (gap.before >= 0) & (at <= _SAME)
    return ~(old | ((gap.after >= 0) & (at >= gap.duration - _SAME)))


def interpolate(history: EncounterHistory, states: States, values: np.ndarray) -> np.ndarray:
    """Values (P, ...) at the pings, linear in time between those of a tag, at states (S, ...)."""
    flat = values.reshape(len(values), -1)
    out = np.empty((len(states.time), flat.shape[1]))
    for tag, (i, j) in enumerate(zip(history.first_rows, history.last_rows, strict=True)):
        mine = states.tag == tag
        t = history.time[i : j + 1]
        right = np.clip(np.searchsorted(t, states.time[mine]), 1, max(len(t) - 1, 1))
        right = np.minimum(right, len(t) - 1)
        left = np.maximum(right - 1, 0)
        step = np.maximum(t[right] - t[left], _SAME)
        share = np.clip((states.time[mine] - t[left]) / step, 0.0, 1.0)[:, None]
        out[mine] = (1 - share) * flat[i + left] + share * flat[i + right]
    at_ping = states.row >= 0
    out[at_ping] = flat[states.row[at_ping]]
    return out.reshape(-1, *values.shape[1:])


def considered(history: EncounterHistory, states: States) -> np.ndarray:
    """Which deployments are considered at each state, (S, R)."""
    r = len(history.receivers)
    if history.near is None or history.reach is None:
        return np.ones((len(states.time), r), bool)
    at = interpolate(history, states, history.near)
    away = np.hypot(*(at[:, None] - history.receivers.xy[None]).transpose(2, 0, 1))
    heard = (states.row >= 0)[:, None] & history.heard[states.row]
    return (away <= history.reach) | heard


def covariates(history: EncounterHistory, states: States) -> np.ndarray:
    """Standardised covariates at each state and deployment, (S, R, C); missing = average."""
    out = np.zeros((len(states.time), len(history.receivers), len(history.covariates)))
    for c, (name, value) in enumerate(history.covariates.items()):
        if callable(value):
            known = _by_both(history, name, value(history.time), len(history))
            here = _by_both(history, name, value(states.time), len(states.time))
        else:
            known = _by_both(history, name, value, len(history))
            here = interpolate(history, states, known)
        counts = np.isfinite(known) & history.listening
        mean, sd = (float(f(known[counts])) if counts.any() else 0.0 for f in (np.mean, np.std))
        if not sd > 0:
            raise InputError(f"covariate '{name}' has one value everywhere: it tells nothing")
        out[:, :, c] = np.nan_to_num((here - mean) / sd)
    return out


def _by_both(history: EncounterHistory, name: str, value: object, n: int) -> np.ndarray:
    """A covariate's values as (n, R)."""
    got = np.asarray(value, float)
    r = len(history.receivers)
    if got.shape == (n,) and n != r:
        got = got[:, None]
    elif got.ndim == 1 and n == r:
        raise InputError(
            f"covariate '{name}' has {n} values: as many pings as receivers",
            mend=f"give it as ({n}, 1) for pings or (1, {r}) for receivers",
        )
    try:
        return np.broadcast_to(got, (n, r))
    except ValueError:
        raise InputError(
            f"covariate '{name}' has shape {got.shape}, not ({r},), ({n},) or ({n}, {r})"
        ) from None
