"""Encounter histories as the models see them: one chain of states, padded to one shape a bucket.

Tags are laid end to end. A state is a heard ping, an unheard ping of a known schedule, or a node
inside a gap where the path is needed because pings may have been missed there. Padding states
belong to one tag more than there are; nobody listens to it, so they integrate out exactly.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maloc._jax import jax

if TYPE_CHECKING:
    from maloc.data.encounters import EncounterHistory

Numbers = Array | np.ndarray

__all__ = ["EncounterData", "as_encounter_data"]


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
    return history if isinstance(history, EncounterData) else history.to_model_data(pad=False)
