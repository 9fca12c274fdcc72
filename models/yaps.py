# pyright: reportIndexIssue=false
"""YAPS's models on this package's engine: the peer inside, for comparisons like for like."""

from __future__ import annotations

import dataclasses

import numpyro
import numpyro.distributions as dist

from maloc._jax import jnp
from maloc.model_data.toa import as_toa_data
from maloc.models import _depth, _toa
from maloc.world.drift import IntervalDrift, RandomWalk, interval_step

__all__ = ["DIMS", "UNITS", "yaps"]

UNITS, DIMS = _toa.UNITS | _depth.UNITS, _toa.DIMS | _depth.DIMS
UNITS |= {"t_scale": "m", "interval_drift": "ms", "interval": "ms", "sound_speed_sd": "m/s^1.5"}
_BEAT = 1e-3  # ms; emission times are sums of the intervals, all but exactly
_OFF = 0.02  # relative sd of a tag's first interval about the stated one
_LOOSER = 0.05  # YAPS lets random intervals leave their limits by this share


def yaps(toa, *, error="mixture", sound_speed="auto"):
    """Joint density of track, emission times and parameters given arrival times, after YAPS.

    Parameters
    ----------
    toa : ArrivalTimes or ToaData
        Arrival times of one tag. The burst interval is stable (its changes are a random walk),
        random within limits, or unknown.
    error : {"mixture", "student", "gaussian"}
        Arrival error; the mixture is Gaussian with a Student t part (3 df).
    sound_speed : {"auto", "given", "walk"}
        Walk: a random walk around the given speed; auto: where the data say it is not sure.

    Raises
    ------
    ValueError
        If an option is none of these.

    Notes
    -----
    Sites: ``track`` (T, 2) m, a random walk with variance 2 D_xy dt, ``sigma_step`` = sqrt(2 D_xy);
    ``emission`` (T,) m: c (emission time - first arrival); ``interval`` (T,) ms, how far a stable
    one is from nominal; ``sound_speed_walk`` (T,) m/s.

    A stable interval and a walking sound speed are the model of 2017; the thesis's YAPS-SS gives
    the speed, its YAPS-BI has random intervals too: normal about the middle of their limits.

    Unlike yaps 1.2.5: steps of the walk last from first arrival to first arrival, not from emission
    to emission; unheard pings are summed out, not states (the same density); sound speed changes
    from ping to ping, not between a few stretches; parameters have wide priors, the limits of an
    interval soft edges of .02 s, distances .5 m of rounding. `maloc.infer.laplace` starts from no
    random values, and its curvature is Gauss-Newton where TMB's is exact.

    References
    ----------
    Baktoft, Gjelland, Okland & Thygesen (2017) Sci. Rep. 7: 14294; Baktoft et al. (2019) bioRxiv
    2019.12.16.877688, yaps 1.2.5. Variants: Vergeynst et al. (2020) Animal Biotelemetry 8: 7.
    """
    _toa.refuse_unknown(
        error=(error, ("mixture", "student", "gaussian")),
        sound_speed=(sound_speed, ("auto", "given", "walk")),
    )
    data = as_toa_data(toa)
    position = numpyro.deterministic("position", _toa.path(data, "rw"))
    down, slowness = _depth.depth(data, position)
    emission = _toa.emission(data)
    ratio = 1.0
    if sound_speed == "walk" or (sound_speed == "auto" and not data.speed_known):
        sd = numpyro.sample("sound_speed_sd", dist.LogNormal(jnp.log(0.05), 2.0))
        law = RandomWalk(data.dt, sd, data.speed_sd * jnp.mean(data.speed))
        ratio = 1.0 + numpyro.sample("sound_speed_walk", law) / data.speed
    time = numpyro.deterministic("emission_time", data.time + emission / (data.speed * ratio))
    if data.schedule == "stable":
        _steady(data, time)
    elif data.schedule == "random":
        low, high = data.interval
        n = jnp.maximum(data.n_intervals, 1.0)
        law = dist.Normal(n * 0.5 * (low + high), jnp.sqrt(n) * 0.5 * (high - low))
        about = law.mask(data.interval_known).log_prob(jnp.diff(time))
        numpyro.factor("burst_interval", about)
        looser = jnp.stack([(1 - _LOOSER) * low, (1 + _LOOSER) * high])
        _toa.within_limits(dataclasses.replace(data, interval=looser), time)
    _toa.arrivals(data, position, emission, ratio, error, data.clock_sd, down, slowness)


def _steady(data, time) -> None:
    """Sites of a burst interval that walks, and the emission times that are its sums."""
    mean = data.interval[0]
    sd = numpyro.sample("interval_drift", dist.LogNormal(0.0, 3.0))
    off = numpyro.sample("interval", IntervalDrift(data.n_intervals, sd, _OFF * 1e3 * mean))
    n = jnp.maximum(data.n_intervals, 1.0)
    more, width = interval_step(n, off[:-1], off[1:], sd, _BEAT)
    law = dist.Normal(n * mean + 1e-3 * more, 1e-3 * width)
    numpyro.factor("schedule", law.mask(data.interval_known).log_prob(jnp.diff(time)))
