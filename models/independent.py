"""Independent localization: each heard ping by itself, anywhere in the state space."""

from __future__ import annotations

import numpyro

from maloc._jax import jnp
from maloc.detection import squared_distance
from maloc.model_data.encounters import as_encounter_data
from maloc.models import _parts
from maloc.world.statespace import SoftBox

__all__ = ["DIMS", "UNITS", "independent"]

UNITS, DIMS = {"scale": "m"}, _parts.DIMS


def independent(
    encounters,
    *,
    detection="halfnormal",
    loss=False,
    receiver_effects=False,
    dispersion=False,
    distance=squared_distance,
):
    """Joint density of positions and detection parameters given who heard each heard ping.

    Parameters
    ----------
    encounters : EncounterHistory or EncounterData
        Encounter histories of one or more tags; pings that nobody heard are left out.
    detection : {"halfnormal", "logistic", "hazard"}
        Detection function of distance.
    loss : bool
        Pings may be lost to every receiver at once (collisions): site ``p_lost``.
    receiver_effects, dispersion : bool
        Receivers differ; pings differ (on the linear predictor).
    distance : callable
        Squared effective distance, see `maloc.detection.encounters`.

    Raises
    ------
    ValueError
        If an option is none of these.

    Notes
    -----
    Sites: ``track`` (S, 2) m, ``p0``, ``scale`` (m). Leaving out unheard pings without dividing by
    the chance of being heard biases p0 upwards: this is the paper's model, kept for comparison.

    References
    ----------
    Hostetter & Royle (2020) Movement-assisted localization from acoustic telemetry data. Movement
    Ecology 8: 15, equations 2 and 3.
    """
    _parts.refuse_unknown(None, detection)
    data = as_encounter_data(encounters)
    anywhere = SoftBox(data.low, data.high, data.edge).expand([data.time.shape[0]]).to_event(1)
    position = numpyro.sample("track", anywhere, infer={"is_chain": True})
    _parts.placed(data, position)
    how = (detection, loss, receiver_effects, dispersion, distance)
    law = _parts.detection(data, position, *how)
    numpyro.sample("encounter", law.mask(jnp.any(data.heard, axis=1)), obs=data.heard)
