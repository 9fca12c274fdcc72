"""Movement-assisted localization where nobody knows how many pings were missed, nor when."""

from __future__ import annotations

import numpyro

from maloc._jax import jnp
from maloc.detection import squared_distance
from maloc.model_data.encounters import as_encounter_data
from maloc.models import _parts

__all__ = ["DIMS", "UNITS", "unknown_interval"]

UNITS, DIMS = _parts.UNITS, _parts.DIMS


def unknown_interval(
    encounters,
    *,
    movement="rw",
    detection="halfnormal",
    loss=False,
    receiver_effects=False,
    dispersion=False,
    distance=squared_distance,
    hierarchical=False,
):
    """Joint density of paths and parameters given heard pings and the burst interval's law.

    Number and times of the pings that nobody heard are summed out exactly (thinned renewal).

    Parameters
    ----------
    encounters : EncounterHistory or EncounterData
        Encounter histories of one or more tags, with a schedule of their burst intervals.
    movement : {"rw", "ctcrw", "ou"}
        Brownian motion, as in the paper, a continuous-time correlated random walk, or a home range.
    detection : {"halfnormal", "logistic", "hazard"}
        Detection function of distance.
    loss : bool
        Pings may be lost to every receiver at once (collisions): site ``p_lost``.
    receiver_effects, dispersion : bool
        Receivers differ; pings differ (on the linear predictor).
    distance : callable
        Squared effective distance, see `maloc.detection.encounters`.
    hierarchical : bool
        Each tag has its own movement parameters around common ones.

    Raises
    ------
    ValueError
        If an option is none of these, or the history has no schedule.

    Notes
    -----
    Sites: ``track`` (S, 2) m or (S, 2, 2), heard pings and nodes of the gaps in order; ``p0``,
    ``scale`` (m), ``sigma_step`` or ``sigma_vel`` and ``t05``; ``log_q`` (S,), log probability that
    a ping sent there is heard by nobody.

    References
    ----------
    Hostetter & Royle (2020) Movement Ecology 8: 15 ("Mvmt UI"), whose sampler over the number of
    missed pings is replaced by their sum; Cox (1962) Renewal Theory, for the renewal equation.
    """
    _parts.refuse_unknown(movement, detection)
    data = as_encounter_data(encounters)
    position = _parts.track(data, movement, hierarchical)
    how = (detection, loss, receiver_effects, dispersion, distance)
    law = _parts.detection(data, position, *how)
    numpyro.sample("encounter", law.mask(jnp.asarray(data.ping)), obs=data.heard)
    if data.gaps is None:
        raise ValueError("unknown_interval needs a burst interval: give the history a schedule")
    log_q = numpyro.deterministic("log_q", law.log_unheard)
    missed = _parts.MissedPings(data.gaps, log_q)
    numpyro.sample("gap", missed, obs=jnp.zeros(missed.batch_shape))
