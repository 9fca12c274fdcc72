"""Movement-assisted localization where every ping's time is known, heard or not."""

from __future__ import annotations

import numpyro

from maloc._jax import jnp
from maloc.detection import squared_distance
from maloc.model_data.encounters import as_encounter_data
from maloc.models import _parts

__all__ = ["DIMS", "UNITS", "known_interval"]

UNITS, DIMS = _parts.UNITS, _parts.DIMS


def known_interval(
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
    """Joint density of paths and parameters given who heard each ping, and who did not.

    Parameters
    ----------
    encounters : EncounterHistory or EncounterData
        Encounter histories of one or more tags, with a row for every ping sent, heard or not.
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
        If an option is none of these.

    Notes
    -----
    Sites: ``track`` (S, 2) m or (S, 2, 2); ``p0``, ``scale`` (m), ``sigma_step`` or ``sigma_vel``
    and ``t05``.

    References
    ----------
    Hostetter & Royle (2020) Movement Ecology 8: 15, equation 7 ("Mvmt KI").
    """
    _parts.refuse_unknown(movement, detection)
    data = as_encounter_data(encounters)
    position = _parts.track(data, movement, hierarchical)
    how = (detection, loss, receiver_effects, dispersion, distance)
    law = _parts.detection(data, position, *how)
    numpyro.sample("encounter", law.mask(jnp.asarray(data.ping)), obs=data.heard)
