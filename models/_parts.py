# pyright: reportIndexIssue=false
"""What the detection models share: priors and sites of movement and of detection.

Scales come from the data (receiver spacing, burst interval), so that one prior serves metres and
the paper's grid units: medians are set by them, with a factor of e or more either way.
"""

from __future__ import annotations

from typing import Any

import numpyro
import numpyro.distributions as dist

from maloc._jax import jax, jnp
from maloc.detection import KINDS, encounters, linear_shift
from maloc.movement import CTCRW, OU, Brownian
from maloc.world.drift import GaussMarkov
from maloc.world.statespace import SoftBox

__all__ = [
    "DIMS",
    "UNITS",
    "Heard",
    "MissedPings",
    "detection",
    "encountered",
    "home_range",
    "placed",
    "range_drift",
    "refuse_unknown",
    "track",
]

UNITS = {"scale": "m", "sigma_step": "m/s^.5", "sigma_vel": "m/s", "t05": "s"}
UNITS |= {"home": "m", "home_sd": "m", "home_t05": "s", "range_memory": "s"}
DIMS = {"position": ("ping", "axis"), "log_q": ("ping",), "receiver_effect": ("receiver",)}
DIMS |= {"coefficient": ("covariate",)}
DIMS |= dict.fromkeys(("home", "home_offset"), ("tag", "axis"))
DIMS |= dict.fromkeys(
    [f"{k}_tag" for k in ("sigma_step", "sigma_vel", "t05", "home_sd", "home_t05")], ("tag",)
)
MOVEMENT = ("rw", "ctcrw", "ou")


def refuse_unknown(movement: str | None, detection: str) -> None:
    """Raise ValueError for an option that is none of the known."""
    for option, known in ((movement, MOVEMENT), (detection, KINDS)):
        if option is not None and option not in known:
            raise ValueError(f"{option!r} is none of {', '.join(known)}")


def _by_tag(name: str, median, spread: float, n_tags: int, hierarchical: bool):
    """A positive movement parameter: one for all tags, or one a tag around a common median."""
    value = numpyro.sample(name, dist.LogNormal(jnp.log(median), spread))
    if not hierarchical:
        return value
    between = numpyro.sample(f"{name}_between", dist.HalfNormal(0.5))
    off = numpyro.sample(f"{name}_tag", dist.Normal(0.0, 1.0).expand([n_tags]).to_event(1))
    return value * jnp.exp(between * off)


def track(data, movement: str, hierarchical: bool):
    """Sites of the path: positions (S, 2), tags starting anywhere in the state space."""
    start = SoftBox(data.low, data.high, data.edge)
    how = {"tag": data.tag, "start": start}
    if movement == "rw":
        median = 0.2 * data.spacing / jnp.sqrt(data.interval)
        sigma = _by_tag("sigma_step", median, 1.5, data.n_tags, hierarchical)
        position = numpyro.sample("track", Brownian(data.dt, sigma, start.mean, **how))
    elif movement == "ou":
        half = 0.5 * (data.high - data.low)
        sd = _by_tag("home_sd", data.spacing, 1.0, data.n_tags, hierarchical)
        t05 = _by_tag("home_t05", 100.0 * data.interval, 1.5, data.n_tags, hierarchical)
        law = home_range(data.dt, sd, t05, start.mean, half, data.tag, data.n_tags)
        position = numpyro.sample("track", law)
    else:
        median = 0.1 * data.spacing / data.interval
        sigma = _by_tag("sigma_vel", median, 1.5, data.n_tags, hierarchical)
        t05 = _by_tag("t05", 10.0 * data.interval, 1.5, data.n_tags, hierarchical)
        position = numpyro.sample("track", CTCRW(data.dt, sigma, t05, start.mean, **how))[:, 0]
    placed(data, position)
    return position


def home_range(dt, sd, t05, middle, reach, tag=None, n_tags: int = 1):
    """Law of a path around a home; each tag has one of its own, site ``home`` (A,) or (N, A), m."""
    shape = jnp.shape(middle) if tag is None else (n_tags, *jnp.shape(middle))
    away = dist.Normal(0.0, 1.0).expand(shape).to_event(len(shape))
    middle, reach = (jnp.broadcast_to(v, shape[-1:]) for v in (middle, reach))
    lead = (None,) * (len(shape) - 1)
    home = middle[lead] + reach[lead] * numpyro.sample("home_offset", away)
    return OU(dt, sd, t05, numpyro.deterministic("home", home), tag=tag)


def placed(data, position) -> None:
    """Record the positions; hold those of padding, which the flat state space would let go."""
    numpyro.deterministic("position", position)
    middle, size = 0.5 * (data.low + data.high), data.high - data.low
    off = jnp.sum(((position - middle[None]) / size[None]) ** 2, axis=1)
    numpyro.factor("padding", jnp.where(data.valid, 0.0, -0.5 * off))


def detection(
    data, position, kind: str, loss: bool, receiver_effects: bool, dispersion: bool, distance,
    stretch=None,
):  # fmt: skip
    """Sites of detection: the law (`maloc.detection.Encounters`) of who hears a ping sent there.

    ``stretch`` (S,): factor on the scale at each state.
    """
    p0 = numpyro.sample("p0", dist.Uniform(0.0, 1.0))
    scale = numpyro.sample("scale", dist.LogNormal(jnp.log(data.spacing), 1.0))
    scale = scale if stretch is None else scale * stretch[:, None]
    shape = None
    if kind == "hazard":
        shape = numpyro.sample("shape", dist.LogNormal(jnp.log(4.0), 0.7))
    coefficients = effects = p_lost = spread = None
    if n := data.covariates.shape[-1]:
        coefficients = numpyro.sample("coefficient", dist.Normal(0, 1).expand([n]).to_event(1))
    if receiver_effects:
        sd = numpyro.sample("receiver_sd", dist.HalfNormal(1.0))
        each = dist.Normal(0.0, 1.0).expand([data.receiver_xy.shape[0]]).to_event(1)
        effects = sd * numpyro.sample("receiver_effect", each)
    if loss:
        p_lost = numpyro.sample("p_lost", dist.Beta(1.0, 4.0))
    if dispersion:
        spread = numpyro.sample("dispersion", dist.HalfNormal(1.0))
    shift = linear_shift(data.covariates, coefficients, effects, data.receiver)
    return encounters(
        kind, position, data.near_xy, data.listening, p0, scale, shape,
        shift=shift, p_lost=p_lost, dispersion=spread, squared=distance,
    )  # fmt: skip


def range_drift(data):
    """Sites of the detection range's drift in time: a factor on the scale at each state (S,)."""
    sd = numpyro.sample("range_sd", dist.LogNormal(jnp.log(0.15), 0.7))
    memory = 100 * data.encounters.interval
    memory = numpyro.sample("range_memory", dist.LogNormal(jnp.log(memory), 0.7))
    drift = numpyro.sample("range_drift", GaussMarkov(data.dt, memory, data.tag))
    return jnp.exp(sd * drift)


def encountered(data, law) -> None:
    """Sites of who heard each ping, and of the pings that nobody heard as far as they are known."""
    encounters, pings = data.encounters, jnp.asarray(data.ping)
    if data.silence == "unknown":
        law = Heard(law)
    numpyro.sample("encounter", law.mask(pings), obs=encounters.heard)
    if data.silence == "summed":
        log_q = numpyro.deterministic("log_q", law.log_unheard)
        missed = MissedPings(encounters.gaps, log_q)
        numpyro.sample("gap", missed, obs=jnp.zeros(missed.batch_shape))


class Heard(dist.Distribution):
    """Encounter histories of pings that are known because somebody heard them.

    Parameters
    ----------
    law : Encounters
        Of all pings; its density is divided by the probability that somebody hears one.
    """

    local = True
    arg_constraints: Any = {}
    support: Any = dist.constraints.independent(dist.constraints.boolean, 1)
    pytree_data_fields = ("law",)

    def __init__(self, law, *, validate_args=None) -> None:
        self.law = law
        super().__init__(law.batch_shape, law.event_shape, validate_args=validate_args)

    def log_prob(self, value):
        """Log probability of histories (S, K) with a detection each, (S,)."""
        total = self.law.log_prob(value)
        return total - jnp.broadcast_to(self.law.log_heard, total.shape)


class MissedPings(dist.Distribution):
    """What the gaps between heard pings say of the path: pings missed in them are summed out.

    Batch shape (G,), the gaps; the value is of no account. For the engine's Gauss-Newton curvature
    each node counts by the number of pings expected to have been missed there (an EM surrogate:
    the same gradient, and one state a term).
    """

    local = summed_out = True
    arg_constraints: Any = {}
    support: Any = dist.constraints.real
    pytree_data_fields = ("gaps", "log_q", "log_density")

    def __init__(self, gaps, log_q, *, validate_args=None) -> None:
        from maloc.schedule.renewal import gap_log_likelihood

        self.gaps, self.log_q = gaps, log_q
        self.log_density = gap_log_likelihood(gaps, log_q)
        super().__init__(self.log_density.shape, (), validate_args=validate_args)

    def log_prob(self, value):
        """Log likelihood of each gap (G,)."""
        return self.log_density

    def local_log_prob(self, value, here):
        """The surrogate around ``here``: expected misses times log q, (S,)."""
        from maloc.schedule.renewal import gap_log_likelihood

        expected = jax.grad(lambda log_q: gap_log_likelihood(here.gaps, log_q).sum())(here.log_q)
        return expected * self.log_q

    def sample(self, key, sample_shape=()):
        """Zeros: gaps are given, not drawn."""
        return jnp.zeros(self.shape(sample_shape))
