# pyright: reportIndexIssue=false
"""What the models of arrival times share: sites of movement, emission, medium and arrival."""

from __future__ import annotations

from typing import Any

import numpyro
import numpyro.distributions as dist

from maloc._jax import jax, jnp
from maloc.arrival import DDetect, Gaussian, GaussianStudent, Student
from maloc.models._parts import home_range
from maloc.movement import CTCRW, Brownian
from maloc.world.drift import GaussMarkov, IntervalDrift, interval_step

__all__ = [
    "DIMS",
    "UNITS",
    "arrivals",
    "emission",
    "in_water",
    "beat",
    "path",
    "refuse_unknown",
    "speed_ratio",
    "within_limits",
]

UNITS = {"sigma": "m", "sigma_vel": "m/s", "sigma_step": "m/s^.5", "t05": "s"}
UNITS |= {"interval_sd": "s", "sound_speed": "m/s", "sound_speed_memory": "s"}
UNITS |= {"home": "m", "home_sd": "m", "home_t05": "s"}
DIMS = {"position": ("ping", "axis"), "emission_time": ("ping",)}
DIMS |= dict.fromkeys(("home", "home_offset"), ("tag", "axis"))
_OFF = 0.02  # relative sd of a tag's own interval about the stated one
_JITTER = 0.2  # ms; how well a tag keeps its beat from one ping to the next
_INLAND = 3.0  # how far a path strays inland, in widths of the shore
_EDGE = 0.02  # s; width of the soft edges of a random interval


def refuse_unknown(**options: tuple[object, tuple]) -> None:
    """Raise ValueError for an option (value, known values) that is none of the known."""
    for option, known in options.values():
        if option not in known:
            raise ValueError(f"{option!r} is none of {', '.join(map(str, known))}")


def path(data, movement: str, tag=None, n_tags: int = 1):
    """Sites of the path; positions (T, 2)."""
    if movement == "ctcrw":
        sigma_vel = numpyro.sample("sigma_vel", dist.LogNormal(jnp.log(0.3), 1.0))
        t05 = numpyro.sample("t05", dist.LogNormal(jnp.log(260.0), 1.5))
        law = CTCRW(data.dt, sigma_vel, t05, data.centre, data.spread, tag=tag)
        return numpyro.sample("track", law)[:, 0]
    if movement == "ou":
        sd = numpyro.sample("home_sd", dist.LogNormal(jnp.log(0.1 * data.spread), 1.0))
        t05 = numpyro.sample("home_t05", dist.LogNormal(jnp.log(3600.0), 1.5))
        law = home_range(data.dt, sd, t05, data.centre, data.spread, tag, n_tags)
        return numpyro.sample("track", law)
    sigma_step = numpyro.sample("sigma_step", dist.LogNormal(0.0, 1.5))
    law = Brownian(data.dt, sigma_step, data.centre, data.spread, tag=tag)
    return numpyro.sample("track", law)


def in_water(position, water):
    """Positions off the land; a path that goes inland is held back by the factor ``shore``."""
    if water is None:
        return position
    inland = -water.distance(position) / (_INLAND * water.soft)
    numpyro.factor("shore", jax.nn.log_sigmoid(3.0 - inland))
    return water.off_land(position)


def emission(data):
    """Site of c (emission time - first arrival), (T,) m."""
    ranges = dist.Normal(0.0, data.spread).expand(data.time.shape).to_event(1)
    return numpyro.sample("emission", ranges, infer={"is_chain": True})


def within_limits(data, time) -> None:
    """Factor of a random burst interval: times from ping to ping within soft limits."""
    low, high = (bound * data.n_intervals for bound in data.interval)
    gap = jnp.diff(time)
    inside = jax.nn.log_sigmoid((gap - low) / _EDGE) + jax.nn.log_sigmoid((high - gap) / _EDGE)
    numpyro.factor("schedule", jnp.where(data.interval_known, inside, 0.0))


def arrivals(
    data, position, emission, ratio, error: str, clock_sd=None, down: Any = 0.0, slowness: Any = 1.0
) -> None:
    """Sites of the arrival error, and the arrivals themselves; ``ratio`` () or (T,) of speeds.

    ``down`` (T, R): squared vertical distances, m2; ``slowness`` (T, R): over the reference's.
    """
    sigma = numpyro.sample("sigma", dist.LogNormal(jnp.log(2.0), 1.5))
    east = position[:, :1] - data.receiver_xy.T[:1]
    north = position[:, 1:] - data.receiver_xy.T[1:]
    distance = jnp.sqrt(east**2 + north**2 + 0.25 + down)
    ratio = ratio[:, None] if jnp.ndim(ratio) else ratio
    arrival = (emission[:, None] + distance * slowness) / ratio
    if clock_sd is not None:
        sigma = jnp.sqrt(sigma**2 + clock_sd**2)
    if error == "ddetect":
        logit_w = dist.TransformedDistribution(
            dist.Normal(-2.5, 1.2), dist.transforms.SigmoidTransform()
        )
        w = numpyro.sample("w", logit_w)
        law = DDetect(arrival, sigma, data.phi, w, background=1e-4)
    elif error == "mixture":
        scale = numpyro.sample("t_scale", dist.LogNormal(jnp.log(10.0), 3.0))
        logit_w = dist.TransformedDistribution(
            dist.Normal(-4.0, 3.0), dist.transforms.SigmoidTransform()
        )
        law = GaussianStudent(arrival, sigma, scale, numpyro.sample("w", logit_w))
    elif error == "gaussian":
        law = Gaussian(arrival, sigma)
    else:
        law = Student(arrival, sigma)
    alone = {"per_state": True}  # a ping's arrivals depend on its own state alone
    numpyro.sample("arrival", law.mask(data.heard), obs=data.range, infer=alone)


def speed_ratio(data, option: str):
    """Sites of the sound speed, as a factor on the given one: (), or (T,) where it drifts."""
    if option == "given" or (option == "auto" and data.speed_known):
        return 1.0
    ratio = numpyro.sample("sound_speed_ratio", dist.Normal(1.0, data.speed_sd))
    numpyro.deterministic("sound_speed", ratio * jnp.mean(data.speed))
    if option == "drifting":
        sd = numpyro.sample("sound_speed_sd", dist.LogNormal(jnp.log(2e-3), 0.7))
        memory = numpyro.sample("sound_speed_memory", dist.LogNormal(jnp.log(4 * 3600.0), 1.0))
        drift = GaussMarkov(data.dt, memory, data.tag)
        ratio = ratio + sd * numpyro.sample("sound_speed_drift", drift)
    return ratio


def beat(data, time) -> None:
    """Sites of a burst interval that is stable, or follows a known sequence, but for slow drift."""
    mean, spread = data.interval
    sd = numpyro.sample("interval_drift", dist.LogNormal(jnp.log(1e3 * spread), 1.0))
    walk = IntervalDrift(data.n_intervals, sd, _OFF * 1e3 * mean)
    off = numpyro.sample("interval", walk)
    n = jnp.maximum(data.n_intervals, 1.0)
    more, width = interval_step(n, off[:-1], off[1:], sd, _JITTER)
    law = dist.Normal(data.nominal + 1e-3 * more, 1e-3 * width)
    numpyro.factor("schedule", law.mask(data.interval_known).log_prob(jnp.diff(time)))
