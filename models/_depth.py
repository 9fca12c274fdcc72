# pyright: reportIndexIssue=false
"""Sites of the depth, which models of arrivals and of detection share."""

from __future__ import annotations

import numpyro
import numpyro.distributions as dist

from maloc._jax import jnp
from maloc.world.depth import DepthPath, PressureSensor, bottom_at, depth_of

__all__ = ["DIMS", "UNITS", "depth", "slanted"]

UNITS = {"depth_mean": "m", "depth_sd": "m", "depth_t05": "s"}
DIMS = {"depth": ("ping",), "depth_mean": ("tag",), "depth_level": ("tag",)}


def depth(data, position, tag=None, n_tags: int = 1):
    """Sites of the depth (T,) m; its squared vertical distances (T, R) m2, and slownesses (T, R).

    Flat tracks: 0 and 1. A slowness is that of a straight ray, over the reference speed's.

    Sites: ``depth_path`` (T, 1) m, ``depth`` (T,) m, positive down, see `maloc.depth`;
    ``depth_mean`` () or (N,) m, ``depth_level`` times the water; ``depth_sd`` (m), ``depth_t05``
    (s). No path where every depth is known exactly.
    """
    water = data.depth
    if water is None:
        return 0.0, 1.0
    if water.known:
        found = numpyro.deterministic("depth", water.observed)
        return water.square(found), water.slowness(found)
    sd = numpyro.sample("depth_sd", dist.LogNormal(jnp.log(0.2 * water.bottom), 0.7))
    t05 = numpyro.sample("depth_t05", dist.LogNormal(jnp.log(1800.0), 1.5))
    law = dist.Uniform(0.0, 1.0)
    level = numpyro.sample("depth_level", law if tag is None else law.expand([n_tags]).to_event(1))
    mean = numpyro.deterministic("depth_mean", water.bottom * level)
    centre = jnp.reshape(mean, (1,) if tag is None else (n_tags, 1))
    path = numpyro.sample("depth_path", DepthPath(data.dt, sd, t05, centre, tag=tag))
    found = numpyro.deterministic("depth", depth_of(path[:, 0], bottom_at(water, position)))
    sensor = PressureSensor(found, water.sd)
    own = {"per_state": True}
    numpyro.sample("depth_sensor", sensor.mask(water.sensed), obs=water.observed, infer=own)
    return water.square(found), water.slowness(found)


def slanted(distance, data, down):
    """Squared distances as ``distance`` has them, and the vertical ones of the receivers there."""
    if data.depth is None:
        return distance
    near = jnp.take_along_axis(down, data.encounters.receiver, axis=1)
    return lambda position, near_xy: distance(position, near_xy) + near
