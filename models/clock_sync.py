# pyright: reportIndexIssue=false
"""Receivers' clocks from sync tags: the joint clock model of `maloc.sync.fit` in NumPyro."""

from __future__ import annotations

import numpyro
import numpyro.distributions as dist

from maloc._jax import jnp
from maloc.arrival import DDetect, Gaussian
from maloc.model_data.clock_pings import as_clock_pings
from maloc.models import _clock, _toa
from maloc.world.clock_walk import ClockWalk

__all__ = ["ALONG", "DIMS", "UNITS", "clock_sync"]

UNITS = {"clock_noise": "ms/h^1.5", "sigma": "ms", "delay": "ms", "jump": "ms", "shift": "m"}
UNITS |= {"sound_speed": "m/s"}
ALONG = "knot"
DIMS = {"offset": ("knot", "clock"), "delay": ("receiver",), "shift": ("receiver", "axis")}
DIMS |= {"jump": ("jump_dim",), "constants": ("constant",)}
_LATEST = 300.0  # ms; largest lateness of a reflection


def clock_sync(sync, *, error="ddetect", sound_speed="auto", noise="estimated", position_sd=1.0):
    """Joint density of clocks, emission times and parameters given arrivals of sync pings.

    A clock's offset is an integrated random walk, a cubic Hermite curve between its knots, besides
    jumps whose times are given; every emission time is latent.

    Parameters
    ----------
    sync : ClockSync or ClockPings
        Sync pings, and the clocks near which the model begins: what it finds does not depend on
        them, but for the times of jumps and which arrivals are of one ping.
    error : {"ddetect", "gaussian"}
        Arrival error.
    sound_speed : {"auto", "given", "estimated"}
        Estimated: one factor on the ClockSync's. Auto: estimated unless it was given to that.
    noise : {"estimated", "given"}
        Of the clocks; given: as the ClockSync has it.
    position_sd : float
        Prior standard deviation of each deployment's x and y about the table, m; 0: held at the
        places of the ClockSync.

    Raises
    ------
    ValueError
        If an option is none of these.

    Notes
    -----
    Sites: ``clock`` (K, 2, C) ms and ms/h and ``emission`` (K, M) ms, departures from the
    ClockSync; ``shift`` (D, 2) m, from the table; ``jump`` (J,) ms, departures. ``offset`` (K, C) s
    is the clocks' offset at the knots, without jumps. See `maloc.model_data.clock_pings`.

    References
    ----------
    Baktoft et al. (2017) Sci. Rep. 7: 14294, clocks, places and sync pings estimated together.
    """
    _toa.refuse_unknown(
        error=(error, ("ddetect", "gaussian")),
        sound_speed=(sound_speed, ("auto", "given", "estimated")),
        noise=(noise, ("estimated", "given")),
    )
    if not position_sd >= 0:
        raise ValueError(f"position_sd must be at least 0, not {position_sd}")
    data = as_clock_pings(sync)
    wander = data.noise
    if noise == "estimated":
        prior = dist.LogNormal(jnp.log(0.2), 1.5).expand(jnp.shape(data.noise)).to_event(1)
        wander = numpyro.sample("clock_noise", prior)
    clock = numpyro.sample("clock", ClockWalk(data.dt, wander, data.curves))
    sent = dist.Normal(0.0, 1e3).expand(jnp.shape(data.emission)).to_event(2)
    emission = numpyro.sample("emission", sent, infer={"is_chain": True})
    numpyro.deterministic("offset", data.offset + 1e-3 * clock[:, 0])

    free = "estimated" if sound_speed == "auto" and not data.speed_known else sound_speed
    delay, shift, speed, jump = _clock.constants(data, position_sd, free == "estimated")
    travel = _clock.travel(data, shift, speed)
    own = data.source[..., None] == jnp.arange(len(shift))[None, None]
    ends = jnp.concatenate([clock, jnp.roll(clock, -1, axis=0)], axis=1)  # no ping at the last
    offset = jnp.pad(data.weights @ ends, ((0, 0), (0, 0), (0, 1)))[..., data.clock]
    offset = offset + data.after @ jump + jnp.where(own, delay[None, None], 0.0)
    arrival = emission[..., None] + travel + offset

    sigma = numpyro.sample("sigma", dist.LogNormal(jnp.log(0.3), 1.0))
    law = Gaussian(arrival, sigma)
    if error == "ddetect":
        logit_w = dist.TransformedDistribution(
            dist.Normal(-2.5, 1.2), dist.transforms.SigmoidTransform()
        )
        w = numpyro.sample("w", logit_w)
        law = DDetect(arrival, sigma, _LATEST, w, background=3e-3)
    numpyro.sample("arrival", law.mask(data.heard), obs=data.arrival)


clock_sync.reads = as_clock_pings  # what the engine makes of the first argument
