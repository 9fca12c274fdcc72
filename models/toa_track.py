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

from maloc._jax import jax, jnp
from maloc.arrival import DDetect, Gaussian, Student
from maloc.data.model_data import as_toa_data
from maloc.movement import CTCRW, Brownian

__all__ = ["UNITS", "toa_track"]

UNITS = {"sigma": "m", "sigma_vel": "m/s", "sigma_step": "m/s^.5", "t05": "s"}
UNITS |= {"interval_sd": "s", "sound_speed": "m/s"}

_OPTIONS = ("ctcrw", "rw"), ("ddetect", "gaussian", "student"), ("auto", "given", "estimated")


def toa_track(toa, *, movement="ctcrw", error="ddetect", sound_speed="auto"):
    """Joint density of track, emission times and parameters given arrival times.

    Parameters
    ----------
    toa : ArrivalTimes or ToaData
        Arrival times of one tag.
    movement : {"ctcrw", "rw"}
        Continuous-time correlated random walk, or Brownian motion.
    error : {"ddetect", "gaussian", "student"}
        Arrival error.
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
    ``sigma`` (m) is the direct arrivals' error in time, times c.
    """
    for option, known in zip((movement, error, sound_speed), _OPTIONS, strict=True):
        if option not in known:
            raise ValueError(f"{option!r} is none of {', '.join(known)}")
    data = as_toa_data(toa)
    if movement == "ctcrw":
        sigma_vel = numpyro.sample("sigma_vel", dist.LogNormal(jnp.log(0.3), 1.0))
        t05 = numpyro.sample("t05", dist.LogNormal(jnp.log(260.0), 1.5))
        path = CTCRW(data.dt, sigma_vel, t05, data.centre, data.spread)
        position = numpyro.sample("track", path)[:, 0]
    else:
        sigma_step = numpyro.sample("sigma_step", dist.LogNormal(0.0, 1.5))
        path = Brownian(data.dt, sigma_step, data.centre, data.spread)
        position = numpyro.sample("track", path)
    ranges = dist.Normal(0.0, data.spread).expand(data.time.shape).to_event(1)
    emission = numpyro.sample("emission", ranges, infer={"is_chain": True})

    ratio = 1.0
    if sound_speed == "estimated" or (sound_speed == "auto" and not data.speed_known):
        ratio = numpyro.sample("sound_speed_ratio", dist.Normal(1.0, data.speed_sd))
        numpyro.deterministic("sound_speed", ratio * jnp.mean(data.speed))
    time = data.time + emission / (data.speed * ratio)
    if data.schedule == "stable":
        mean, sd = data.interval
        mean = mean * (1 + 1e-3 * numpyro.sample("interval_offset", dist.Normal(0.0, 1.0)))
        sd = numpyro.sample("interval_sd", dist.LogNormal(jnp.log(sd), 1.0))
        n = jnp.maximum(data.n_intervals, 1.0)
        law = dist.Normal(n * mean, sd * jnp.sqrt(n)).mask(data.interval_known)
        numpyro.factor("schedule", law.log_prob(jnp.diff(time)))
    elif data.schedule == "random":
        low, high = (bound * data.n_intervals for bound in data.interval)
        edge = 0.02
        gap = jnp.diff(time)
        inside = jax.nn.log_sigmoid((gap - low) / edge) + jax.nn.log_sigmoid((high - gap) / edge)
        numpyro.factor("schedule", jnp.where(data.interval_known, inside, 0.0))

    sigma = numpyro.sample("sigma", dist.LogNormal(jnp.log(2.0), 1.5))
    east = position[:, :1] - data.receiver_xy.T[:1]
    north = position[:, 1:] - data.receiver_xy.T[1:]
    distance = jnp.sqrt(east**2 + north**2 + 0.25)
    arrival = (emission[:, None] + distance) / ratio
    if error == "ddetect":
        logit_w = dist.TransformedDistribution(
            dist.Normal(-2.5, 1.2), dist.transforms.SigmoidTransform()
        )
        w = numpyro.sample("w", logit_w)
        law = DDetect(arrival, sigma, data.phi, w, background=1e-4)
    elif error == "gaussian":
        law = Gaussian(arrival, sigma)
    else:
        law = Student(arrival, sigma)
    numpyro.deterministic("position", position)
    numpyro.deterministic("emission_time", time)
    numpyro.sample("arrival", law.mask(data.heard), obs=data.range)
