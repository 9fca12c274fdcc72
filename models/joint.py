# pyright: reportIndexIssue=false
"""Everything the array tells in one model: arrival times, silence, schedule, medium, movement."""

from __future__ import annotations

import numpyro

from maloc.data.joint_history import as_history
from maloc.detection import KINDS, squared_distance
from maloc.model_data.joint import as_joint_data
from maloc.models import _depth, _parts, _toa

__all__ = ["DIMS", "UNITS", "joint"]

UNITS = _parts.UNITS | _toa.UNITS | _depth.UNITS | {"interval_drift": "ms", "interval": "ms"}
DIMS = _parts.DIMS | _toa.DIMS | _depth.DIMS


def joint(
    history,
    water=None,
    *,
    movement="ctcrw",
    arrivals="ddetect",
    detection="halfnormal",
    schedule=True,
    sound_speed="auto",
    range_drift=True,
    loss=False,
    receiver_effects=False,
    dispersion=False,
    distance=squared_distance,
):
    """Joint density of tracks, emission times and parameters given all that was and wasn't heard.

    Parameters
    ----------
    history : ArrivalTimes, ArrivalHistory or JointData
        Arrival times and encounters of one tag or several, see `maloc.arrival_history`.
    water : maloc.habitat.Water, optional
        Keeps animals off the land, see `toa_track`; only with ``arrivals``.
    movement : {"ctcrw", "rw", "ou"}
        Continuous-time correlated random walk, Brownian motion, or a home range (each tag its own).
    arrivals : {"ddetect", "gaussian", "student", None}
        Arrival error; None: arrival times say nothing.
    detection : {"halfnormal", "logistic", "hazard", None}
        Detection function of distance; None: who heard a ping, and who did not, says nothing.
        Pings known only because they were heard are conditioned on having been heard; where the
        history knows or sums out those that nobody heard, these count too.
    schedule : bool
        Whether the burst interval ties the emission times.
    sound_speed : {"auto", "given", "estimated", "drifting"}
        Estimated: one factor on the given speed (auto: if it is not sure); drifting: also in time.
    range_drift : bool
        The detection range drifts in time (Gauss-Markov on its log).
    loss : bool
        Pings may be lost to every receiver at once; nothing tells so where only heard pings count.
    receiver_effects, dispersion, distance
        See `maloc.models.known_interval`.

    Raises
    ------
    ValueError
        If an option is none of these, nothing is left to learn from, or water has no arrivals.

    Notes
    -----
    Sites: ``track`` (S, 2, 2) m and m/s, or (S, 2) m; ``depth`` (S,) m with a `maloc.WaterColumn`;
    ``emission`` (S,) m: c (emission time - first arrival); ``interval`` (S,) ms, how far a stable
    one or a sequence's is from nominal; ``range_drift``, ``sound_speed_drift`` (S,), in sds.

    References
    ----------
    Arrival times: Baktoft et al. (2017) Sci. Rep. 7: 14294; silence and schedule: Hostetter & Royle
    (2020) Mov. Ecol. 8: 15. Their union, and the summing out of missed pings, are this package's.
    """
    _toa.refuse_unknown(
        movement=(movement, ("ctcrw", "rw", "ou")),
        arrivals=(arrivals, ("ddetect", "gaussian", "student", None)),
        detection=(detection, (*KINDS, None)),
        sound_speed=(sound_speed, ("auto", "given", "estimated", "drifting")),
    )
    if arrivals is None and detection is None:
        raise ValueError("neither arrivals nor detection: nothing to learn from")
    if arrivals is None and water is not None:
        raise ValueError("water goes with arrivals")
    data = as_joint_data(history)
    tags = data.tag, data.encounters.n_tags
    if arrivals is None:
        position = _parts.track(data.encounters, movement, False)
    else:
        position = _toa.in_water(_toa.path(data, movement, *tags), water)
        numpyro.deterministic("position", position)
    down, slowness = _depth.depth(data, position, *tags)
    if arrivals is not None:
        emission = _toa.emission(data)
        ratio = _toa.speed_ratio(data, sound_speed)
        time = numpyro.deterministic("emission_time", data.time + emission / (data.speed * ratio))
        if schedule and data.schedule in ("stable", "sequence"):
            _toa.beat(data, time)
        elif schedule and data.schedule == "random":
            _toa.within_limits(data, time)
        _toa.arrivals(data, position, emission, ratio, arrivals, data.clock_sd, down, slowness)
    if detection is not None:
        stretch = _parts.range_drift(data) if range_drift else None
        how = (detection, loss, receiver_effects, dispersion, _depth.slanted(distance, data, down))
        _parts.encountered(data, _parts.detection(data.encounters, position, *how, stretch))


joint.reads = as_history  # what the engine makes of the first argument
