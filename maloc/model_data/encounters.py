"""Encounter histories as the models see them: one chain of states, padded to one shape a bucket.

Tags are laid end to end. A state is a heard ping, an unheard ping of a known schedule, or a node
inside a gap where the path is needed because pings may have been missed there. Padding states
belong to one tag more than there are; nobody listens to it, so they integrate out exactly.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maloc._jax import jax
from maloc.data._padding import bucket
from maloc.data.encounters import EncounterHistory
from maloc.model_data import states as build
from maloc.model_data.gaps import law_of
from maloc.schedule.renewal import Gap, pack_gaps

Numbers = Array | np.ndarray

__all__ = ["EncounterData", "as_encounter_data", "to_model_data"]

_MIN_STEP = 1e-3  # s; two pings at one instant still need a step


@dataclasses.dataclass(frozen=True)
class EncounterData:
    """S states of all tags and the receivers that listened: a pytree, `n_tags` static.

    K is the number of receivers considered at a state: all J deployments (padded), or those near
    it where the history was pruned.

    Attributes
    ----------
    time : (S,) s
        From the data set's origin, ascending within a tag.
    dt : (S - 1,) s
        Element t: from state t to state t + 1; 1 where the tag changes, and in padding.
    tag : (S,) int
        Index of the tag; `n_tags` for padding.
    ping : (S,) bool
        A ping is known to have been sent here: heard, or unheard in a known schedule.
    heard : (S, K) bool
        Which receivers heard it; false at nodes.
    listening : (S, K) bool
        Which receivers were deployed and are considered.
    receiver : (S, K) int
        Deployment of each column.
    near_xy : (S, K, 2) m
        Its position.
    covariates : (S, K, C)
        Standardised covariates of the linear predictor of detection.
    initial : (S, 2) m
        Middle of the receivers that heard the ping, interpolated in time between pings.
    low, high : (2,) m
        Corners of the state space.
    edge : () m
        Width of its smooth edge.
    spacing : () m
        Distance between neighbouring receivers: scale of the priors of detection.
    interval : () s
        Time between pings: scale of the priors of movement.
    valid : (S,) bool
        False for padding.
    present : (J,) bool
        False for deployments that pad the shape.
    receiver_xy : (J, 2) m
        Positions of all deployments.
    gaps : maloc.renewal.Gaps, optional
        The gaps in which pings may have been missed; None where none is summed over.
    n_tags : int
        Tags, without the dummy of the padding.
    """

    time: Float[Numbers, " state"]
    dt: Float[Numbers, " step"]
    tag: Int[Numbers, " state"]
    ping: Bool[Numbers, " state"]
    heard: Bool[Numbers, "state column"]
    listening: Bool[Numbers, "state column"]
    receiver: Int[Numbers, "state column"]
    near_xy: Float[Numbers, "state column 2"]
    covariates: Float[Numbers, "state column covariate"]
    initial: Float[Numbers, "state 2"]
    low: Float[Numbers, 2]
    high: Float[Numbers, 2]
    edge: Float[Numbers, ""]
    spacing: Float[Numbers, ""]
    interval: Float[Numbers, ""]
    valid: Bool[Numbers, " state"]
    present: Bool[Numbers, " deployment"]
    receiver_xy: Float[Numbers, "deployment 2"]
    gaps: Any = None
    n_tags: int = 1


jax.tree_util.register_dataclass(
    EncounterData,
    data_fields=[f.name for f in dataclasses.fields(EncounterData) if f.name != "n_tags"],
    meta_fields=["n_tags"],
)


def as_encounter_data(history: EncounterHistory | EncounterData) -> EncounterData:
    """Model arrays of `history`: as they are, or made without padding from a history."""
    return history if isinstance(history, EncounterData) else to_model_data(history, pad=False)


def to_model_data(history: EncounterHistory, pad: bool = True) -> EncounterData:
    """Arrays of `history`, padded to a bucket unless ``pad`` is false.

    Parameters
    ----------
    history : EncounterHistory
        P pings of N tags, R deployments.
    pad : bool
        Pad states, receivers and gaps, so that one compilation serves many data sets.

    Returns
    -------
    EncounterData
    """
    states = build.chain(history)
    s, r, n = len(states.time), len(history.receivers), len(history.tags)
    more = bucket(s) - s if pad else 0
    j = -(-r // 4) * 4 if pad else r
    ping = states.row >= 0
    heard = ping[:, None] & history.heard[states.row]
    take = build.considered(history, states)
    listening = (history.listening_at(states.time) | heard) & take
    if take.all():
        k, column = j, np.broadcast_to(np.arange(r), (s, r))
    else:
        most = int(take.sum(axis=1).max())
        k = -(-most // 4) * 4 if pad else most
        column = np.argsort(~take, axis=1, kind="stable")[:, :k]

    def columns(values: np.ndarray) -> np.ndarray:
        """The considered columns of (S, R, ...), padded."""
        at = column.reshape(*column.shape, *[1] * (values.ndim - 2))
        wide = [(0, more), (0, k - column.shape[1]), *[(0, 0)] * (values.ndim - 2)]
        return np.pad(np.take_along_axis(values, at, axis=1), wide)

    xy = history.receivers.xy
    xy = np.concatenate([xy, np.repeat(xy.mean(axis=0)[None], j - r, axis=0)])
    receiver = columns(np.broadcast_to(np.arange(r), (s, r)))
    receiver[:, column.shape[1] :] = np.arange(column.shape[1], k) % j
    start = build.interpolate(history, states, history.middles())
    step = np.where(np.diff(states.tag) == 0, np.maximum(np.diff(states.time), _MIN_STEP), 1.0)
    data = EncounterData(
        time=np.append(states.time, states.time[-1] + np.arange(1.0, more + 1)),
        dt=np.append(step, np.ones(more)),
        tag=np.append(states.tag, np.full(more, n)).astype(np.int32),
        ping=np.pad(ping, (0, more)),
        heard=columns(heard),
        listening=columns(listening),
        receiver=receiver.astype(np.int32),
        near_xy=xy[receiver],
        covariates=columns(build.covariates(history, states)),
        initial=np.pad(start, ((0, more), (0, 0)), mode="edge"),
        low=history.low,
        high=history.high,
        edge=np.asarray(history.edge),
        spacing=np.asarray(history.spacing),
        interval=np.asarray(_interval(history)),
        valid=np.arange(s + more) < s,
        present=np.arange(j) < r,
        receiver_xy=xy,
        gaps=_gaps(history, states.gaps, pad),
        n_tags=n,
    )
    return jax.device_put(data)  # at once: one by one, each would compile a copy


def _gaps(history: EncounterHistory, found: list, pad: bool) -> Any:
    if not found:
        return None
    gaps = [Gap(g.kind, g.duration, nodes, at, g.first_at_start) for g, nodes, at in found]
    return pack_gaps(gaps, law_of(history), pad=pad)


def _interval(history: EncounterHistory) -> float:
    """Time between pings, s: the schedule's, else the median step; 1 where there is none."""
    if history.schedule.kind != "unknown":
        return history.schedule.mean
    steps = np.diff(history.time)[np.diff(history.tag) == 0]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0
