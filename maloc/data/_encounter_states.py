"""From an encounter history to the states of one chain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc._jax import jax
from maloc.data.encounter_data import EncounterData
from maloc.data.encounters import EncounterHistory
from maloc.data.model_data import bucket

__all__ = ["model_data"]

_MIN_STEP = 1e-3  # s; two pings at one instant still need a step


class States(NamedTuple):
    """Time (S,) s, tag (S,), and the history's row (S,), -1 at a node."""

    time: np.ndarray
    tag: np.ndarray
    row: np.ndarray


def model_data(history: EncounterHistory, pad: bool = True) -> EncounterData:
    """Arrays of a history for the models (see `EncounterHistory.to_model_data`)."""
    states = States(history.time, history.tag, np.arange(len(history)))
    return _arrays(history, states, None, pad)


def _arrays(history: EncounterHistory, states: States, gaps, pad: bool) -> EncounterData:
    s, r, n = len(states.time), len(history.receivers), len(history.tags)
    size = bucket(s) if pad else s
    j = -(-r // 4) * 4 if pad else r
    more, wider = size - s, j - r
    ping = states.row >= 0
    heard = ping[:, None] & history.heard[states.row]
    listening = history.listening_at(states.time) | heard
    xy = history.receivers.xy
    xy = np.concatenate([xy, np.repeat(xy.mean(axis=0)[None], wider, axis=0)])
    initial = _initial(history, states)
    step = np.where(np.diff(states.tag) == 0, np.maximum(np.diff(states.time), _MIN_STEP), 1.0)
    last = states.time[-1]
    grow = ((0, more), (0, wider))
    data = EncounterData(
        time=np.append(states.time, last + np.arange(1.0, more + 1)),
        dt=np.append(step, np.ones(more)),
        tag=np.append(states.tag, np.full(more, n)).astype(np.int32),
        ping=np.pad(ping, (0, more)),
        heard=np.pad(heard, grow),
        listening=np.pad(listening, grow),
        receiver=np.broadcast_to(np.arange(j, dtype=np.int32), (size, j)),
        near_xy=np.broadcast_to(xy, (size, j, 2)),
        covariates=np.zeros((size, j, 0)),
        initial=np.pad(initial, ((0, more), (0, 0)), mode="edge"),
        low=history.low,
        high=history.high,
        edge=np.asarray(history.edge),
        spacing=np.asarray(history.spacing),
        interval=np.asarray(_interval(history)),
        valid=np.arange(size) < s,
        present=np.arange(j) < r,
        receiver_xy=xy,
        gaps=gaps,
        n_tags=n,
    )
    return jax.device_put(data)  # at once: one by one, each would compile a copy


def _interval(history: EncounterHistory) -> float:
    """Time between pings, s: the schedule's, else the median step; 1 where there is none."""
    if history.schedule.kind != "unknown":
        return history.schedule.mean
    steps = np.diff(history.time)[np.diff(history.tag) == 0]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0


def _initial(history: EncounterHistory, states: States) -> np.ndarray:
    """Middle of the hearing receivers, linear in time between heard pings, (S, 2)."""
    out = np.empty((len(states.time), 2))
    out[:] = history.receivers.xy.mean(axis=0)
    n = history.n_heard
    middle = history.heard @ history.receivers.xy / np.maximum(n, 1)[:, None]
    for tag in range(len(history.tags)):
        rows = np.flatnonzero((history.tag == tag) & (n > 0))
        mine = states.tag == tag
        if len(rows):
            for axis in (0, 1):
                out[mine, axis] = np.interp(
                    states.time[mine], history.time[rows], middle[rows, axis]
                )
    return np.clip(out, history.low, history.high)
