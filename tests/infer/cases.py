"""Small models and data sets that the tests of the engine share. Some models no library ships."""

from __future__ import annotations

import numpy as np
import numpyro
import numpyro.distributions as dist

from maloc._jax import jnp
from maloc.data import ArrivalTimes, Receivers, Schedule
from maloc.movement import Brownian

OPEN = np.iinfo(np.int64)
SPEED = 1480.0


def receivers(xy) -> Receivers:
    """Receivers without sync tags, never moved."""
    xy = np.asarray(xy, float)
    n = len(xy)
    return Receivers(
        receiver=np.array([f"R{i}" for i in range(n)]),
        x=xy[:, 0],
        y=xy[:, 1],
        depth=np.full(n, np.nan),
        sync_tag=np.full(n, ""),
        start=np.full(n, OPEN.min),
        end=np.full(n, OPEN.max),
    )


def toa(
    seed: int = 0,
    pings: int = 13,
    n_receivers: int = 6,
    kind: str = "unknown",
    sigma: float = 0.5,
    p_heard: float = 0.85,
    p_late: float = 0.08,
    unheard: tuple[int, ...] = (4,),
) -> tuple[ArrivalTimes, np.ndarray, np.ndarray]:
    """Arrival times of a tag crossing a ring of receivers; its emission times and positions."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(n_receivers) / n_receivers + 0.2
    xy = np.column_stack([90 * np.cos(angle), 60 * np.sin(angle)]) + rng.normal(
        0, 5, (n_receivers, 2)
    )
    step = {"stable": rng.normal(25.0, 0.02, pings), "unknown": rng.uniform(15, 40, pings)}
    emission = 100.0 + np.cumsum(step.get(kind, rng.uniform(20.0, 30.0, pings)))
    heading = 0.5 + np.cumsum(rng.normal(0, 0.3, pings))
    move = 0.3 * np.diff(emission, prepend=emission[0])[:, None]
    position = np.array([-40.0, -15.0]) + np.cumsum(
        move * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0
    )
    distance = np.linalg.norm(position[:, None] - xy, axis=-1)
    error = rng.normal(0, sigma, distance.shape)
    error += (rng.random(distance.shape) < p_late) * rng.uniform(5, 90, distance.shape)
    arrival = emission[:, None] + (distance + error) / SPEED
    heard = rng.random(distance.shape) < p_heard
    heard[:, :3] = True
    heard[list(unheard)] = False
    schedule = {
        "unknown": Schedule(),
        "random": Schedule("random", 20.0, 30.0),
        "stable": Schedule("stable", 25.0, 0.02),
    }[kind]
    times = ArrivalTimes(
        toa=np.where(heard, arrival, np.nan),
        receivers=receivers(xy),
        sound_speed=np.full(pings, SPEED),
        tag="A69-1602-1",
        schedule=schedule,
    )
    return times, emission, position


# -- a linear Gaussian model: its posterior is known in closed form ------------------------------

SPREAD = 10.0


def fixes(dt, observed):
    """Brownian track observed as positions with a Gaussian error; nothing to do with arrivals."""
    sigma_step = numpyro.sample("sigma_step", dist.LogNormal(0.0, 1.0))
    noise = numpyro.sample("noise", dist.LogNormal(0.0, 0.5))
    track = numpyro.sample("track", Brownian(dt, sigma_step, jnp.zeros(2), SPREAD))
    numpyro.sample("fix", dist.Normal(track, noise), obs=observed)


def known_fixes(dt, observed):
    """`fixes` with its parameters known: a path and nothing else."""
    track = numpyro.sample("track", Brownian(dt, 1.2, jnp.zeros(2), SPREAD))
    numpyro.sample("fix", dist.Normal(track, 0.7), obs=observed)


def fixes_data(seed: int = 0, length: int = 14):
    """Unequal steps (s) and observed positions (m) for `fixes`."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.2, 3.0, length - 1)
    steps = rng.normal(size=(length - 1, 2)) * np.sqrt(dt)[:, None]
    track = rng.normal(0, 4, 2) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return jnp.asarray(dt), jnp.asarray(track + rng.normal(0, 0.8, track.shape))


# -- models of a user's own ------------------------------------------------------------------------


def ranges_only(dt, beacons, ranges):
    """Brownian track and a wandering range bias (marked as a chain on the site), Student errors."""
    sigma_step = numpyro.sample("sigma_step", dist.LogNormal(0.0, 1.0))
    scale = numpyro.sample("scale", dist.HalfNormal(2.0))
    weights = jnp.asarray(numpyro.sample("weights", dist.Dirichlet(jnp.ones(3))))
    track = jnp.asarray(numpyro.sample("track", Brownian(dt, sigma_step, jnp.zeros(2), 50.0)))
    length = dt.shape[0] + 1
    law = dist.Normal(0.0, 1.0).expand((length,)).to_event(1)
    bias = jnp.asarray(numpyro.sample("bias", law, infer={"is_chain": True}))
    off = track[:, None, :] - beacons[None]
    distance = jnp.sqrt(jnp.sum(off**2, axis=-1) + 0.01)
    bearing = jnp.arctan2(off[:, 0, 1], off[:, 0, 0] + 200.0)
    numpyro.sample("bearing", dist.Normal(jnp.zeros(length), 0.3), obs=bearing)
    law = dist.StudentT(4.0, distance + bias[:, None] + weights[0], scale)
    numpyro.sample("range", law.mask(ranges > 0), obs=ranges)


def ranges_data(seed: int = 0, length: int = 11):
    """Steps (s), beacons (m), ranges (m; 0 = none) for `ranges_only`."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.5, 2.0, length - 1)
    beacons = np.array([[0.0, 0.0], [40.0, 0.0], [10.0, 35.0], [-20.0, 20.0]])
    track = np.cumsum(rng.normal(0, 1.5, (length, 2)), axis=0) + np.array([12.0, 9.0])
    ranges = np.linalg.norm(track[:, None] - beacons, axis=-1) + rng.normal(0, 0.5, (length, 4))
    ranges[rng.random(ranges.shape) < 0.2] = 0.0
    return jnp.asarray(dt), jnp.asarray(beacons), jnp.asarray(ranges)


def counts(observed):
    """Poisson counts of a wandering rate: NumPyro's own parts only; the caller names the path."""
    scale = numpyro.sample("scale", dist.HalfNormal(1.0))
    start = numpyro.sample("start", dist.Normal(0.0, 2.0))
    level = numpyro.sample("level", dist.GaussianRandomWalk(scale, observed.shape[0]))
    numpyro.sample("count", dist.Poisson(jnp.exp(start + level)), obs=observed)
