# pyright: reportIndexIssue=false
"""What the models of arrival times share: sites of movement, emission, medium and arrival."""

from __future__ import annotations

from typing import Any

import numpyro
import numpyro.distributions as dist

from maloc._jax import jax, jnp
from maloc.arrival import DDetect, Gaussian, GaussianStudent, Multipath, Student
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
UNITS |= dict.fromkeys(("lateness", "receiver_sd", "receiver_offset_sd"), "m")
UNITS |= {"receiver_moved": "m", "receiver_late": "m"}
DIMS |= dict.fromkeys(("receiver_shift", "receiver_moved"), ("receiver", "axis"))
DIMS |= dict.fromkeys(("receiver_offset", "receiver_late"), ("receiver",))
DIMS |= dict.fromkeys(("home", "home_offset"), ("tag", "axis"))
_OFF = 0.02  # relative sd of a tag's own interval about the stated one
_JITTER = 0.2  # ms; how well a tag keeps its beat from one ping to the next
_FAR = 10.0  # of the first position's spread: a ping's range is known from its arrivals alone
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
    ranges = dist.Normal(0.0, _FAR * data.spread).expand(data.time.shape).to_event(1)
    return numpyro.sample("emission", ranges, infer={"is_chain": True})


def within_limits(data, time) -> None:
    """Factor of a random burst interval: times from ping to ping within soft limits."""
    low, high = (bound * data.n_intervals for bound in data.interval)
    gap = jnp.diff(time)
    inside = jax.nn.log_sigmoid((gap - low) / _EDGE) + jax.nn.log_sigmoid((high - gap) / _EDGE)
    numpyro.factor("schedule", jnp.where(data.interval_known, inside, 0.0))


def receivers(data, option: str):
    """Sites of what receivers do wrong for good: places (R, 2) m, and lateness () or (1, R) m.

    Standard normal effects, found with the path, times scales that are estimated; the places' is
    added to what the data say of their errors.
    """
    if option != "estimated":
        return data.receiver_xy, 0.0
    effect = {"inner": "receiver"}
    shift = dist.Normal(0.0, 1.0).expand(data.receiver_xy.shape).to_event(2)
    late = dist.Normal(0.0, 1.0).expand(data.receiver_xy.shape[:1]).to_event(1)
    told = data.receiver_sd
    sd = numpyro.sample("receiver_sd", dist.LogNormal(jnp.log(0.5 if told is None else 0.1), 1.0))
    sd = sd if told is None else jnp.sqrt(sd**2 + told[:, None] ** 2)
    moved = sd * numpyro.sample("receiver_shift", shift, infer=effect)
    sd = numpyro.sample("receiver_offset_sd", dist.LogNormal(jnp.log(0.2), 1.0))
    late = sd * numpyro.sample("receiver_offset", late, infer=effect)
    numpyro.deterministic("receiver_moved", moved)
    numpyro.deterministic("receiver_late", late)
    return data.receiver_xy + moved, late[None]


def arrivals(
    data, position, emission, ratio, error: str, clock_sd=None, down: Any = 0.0,
    slowness: Any = 1.0, effects: str = "exact",
) -> None:  # fmt: skip
    """Sites of the arrival error, and the arrivals themselves; ``ratio`` () or (T,) of speeds.

    ``down`` (T, R): squared vertical distances, m2; ``slowness`` (T, R): over the reference's.
    """
    sigma = numpyro.sample("sigma", dist.LogNormal(jnp.log(2.0), 1.5))
    place, late = receivers(data, effects)
    east = position[:, :1] - place.T[:1]
    north = position[:, 1:] - place.T[1:]
    distance = jnp.sqrt(east**2 + north**2 + 0.25 + down)
    ratio = ratio[:, None] if jnp.ndim(ratio) else ratio
    arrival = (emission[:, None] + distance * slowness) / ratio + late
    if clock_sd is not None:
        sigma = jnp.sqrt(sigma**2 + clock_sd**2)
    if error in ("ddetect", "auto"):
        w = _share(-2.5, 1.2)
        law = DDetect(arrival, sigma, data.phi, w, background=1e-4)
    elif error == "multipath":
        lateness = numpyro.sample("lateness", dist.LogNormal(jnp.log(10.0), 1.0))
        law = Multipath(arrival, sigma, w=_share(-2.5, 1.2), scale=lateness, phi=data.phi)
    elif error == "mixture":
        scale = numpyro.sample("t_scale", dist.LogNormal(jnp.log(10.0), 3.0))
        law = GaussianStudent(arrival, sigma, scale, _share(-4.0, 3.0))
    elif error == "gaussian":
        law = Gaussian(arrival, sigma)
    else:
        law = Student(arrival, sigma)
    alone = {"per_state": True}  # a ping's arrivals depend on its own state alone
    numpyro.sample("arrival", law.mask(data.heard), obs=data.range, infer=alone)


def _share(logit: float, sd: float):
    """Site of the share of arrivals that are not direct."""
    law = dist.Normal(logit, sd)
    return numpyro.sample(
        "w", dist.TransformedDistribution(law, dist.transforms.SigmoidTransform())
    )


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
