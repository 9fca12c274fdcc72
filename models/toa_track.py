# pyright: reportIndexIssue=false
"""Track from arrival times: a moving tag, latent emission times, arrivals that may be reflected.

State-space model of Campbell et al.'s kaltoa and of YAPS in one: CTCRW (Johnson et al. 2008) or
Brownian movement, an emission time for every heard ping, ddetect (Campbell et al. 2025), Gaussian
or Student t arrival errors, sound speed given or estimated, burst interval unknown, random within
limits, or stable with jitter.
"""

from __future__ import annotations

import numpyro
import numpyro.distributions as dist

from maloc._jax import jnp
from maloc.model_data.toa import as_toa_data
from maloc.models import _depth, _toa

__all__ = ["DIMS", "UNITS", "toa_track"]

UNITS, DIMS = _toa.UNITS | _depth.UNITS, _toa.DIMS | _depth.DIMS


def toa_track(
    toa, water=None, *, movement="ctcrw", error="auto", sound_speed="auto", receivers="auto"
):
    """Joint density of track, emission times and parameters given arrival times.

    Parameters
    ----------
    toa : ArrivalTimes or ToaData
        Arrival times of one tag.
    water : maloc.habitat.Water, optional
        Keeps the animal off the land: ``position`` is ``track`` moved to the shore where it is
        inland.
    movement : {"ctcrw", "rw", "ou"}
        Continuous-time correlated random walk, Brownian motion, or Ornstein-Uhlenbeck motion around
        a home: sites ``home`` (m), ``home_sd`` (m), ``home_t05`` (s).
    error : {"auto", "ddetect", "multipath", "gaussian", "student"}
        Arrival error. Auto: ddetect; `maloc.infer.laplace` takes multipath where it is likelier.
    receivers : {"auto", "exact", "estimated"}
        Estimated: receivers may stand elsewhere (``receiver_moved``, m) and be late for good
        (``receiver_late``, m). Auto: `maloc.infer.laplace` decides by the arrivals; else exact.
    sound_speed : {"auto", "given", "estimated"}
        Estimated: one factor on the given speed, its prior sd what the data say of it, else 1 %.
        Auto: estimated where the data say that the speed is not sure.

    Raises
    ------
    ValueError
        If an option is none of these.

    Notes
    -----
    Sites: ``track`` (T, 2, 2) m and m/s, or (T, 2) m; ``emission`` (T,) m: c (emission time -
    first arrival), so minus the distance to the first receiver where that arrival is direct.
    Where the arrival times have a `maloc.WaterColumn`: ``depth`` (T,) m, see `maloc.depth`.
    ``sigma`` (m) is the direct arrivals' error in time, times c; where the data have standard
    errors of the clocks, their squares are added to its square.
    """
    _toa.refuse_unknown(
        movement=(movement, ("ctcrw", "rw", "ou")),
        error=(error, ("auto", "ddetect", "multipath", "gaussian", "student")),
        receivers=(receivers, ("auto", "exact", "estimated")),
        sound_speed=(sound_speed, ("auto", "given", "estimated")),
    )
    data = as_toa_data(toa)
    position = _toa.in_water(_toa.path(data, movement), water)
    down, slowness = _depth.depth(data, position)
    emission = _toa.emission(data)
    ratio = _toa.speed_ratio(data, sound_speed)
    time = data.time + emission / (data.speed * ratio)
    if data.schedule == "stable":
        mean, sd = data.interval
        mean = mean * (1 + 1e-3 * numpyro.sample("interval_offset", dist.Normal(0.0, 1.0)))
        sd = numpyro.sample("interval_sd", dist.LogNormal(jnp.log(sd), 1.0))
        n = jnp.maximum(data.n_intervals, 1.0)
        law = dist.Normal(n * mean, sd * jnp.sqrt(n)).mask(data.interval_known)
        numpyro.factor("schedule", law.log_prob(jnp.diff(time)))
    elif data.schedule == "random":
        _toa.within_limits(data, time)
    numpyro.deterministic("position", position)
    numpyro.deterministic("emission_time", time)
    how = {"slowness": slowness, "effects": receivers}
    _toa.arrivals(data, position, emission, ratio, error, data.clock_sd, down, **how)
