"""Groups of a stored posterior that predictions are made from: movement, water, depth."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["depth_group", "movement_group", "water_group"]


def movement_group(fit: Fitted, states: np.ndarray):
    """What a prediction needs besides the path's draws: see `maloc.predict`.

    ``ping`` (S,) tells which states stand in the group posterior; the rest stand in between.
    """
    import xarray as xr

    from maloc.infer import _paths

    if not any(issubclass(s.law, _paths.MarkovPath) for s in fit.cm.chain):
        return None
    site = _paths.path_site(fit.cm)
    x, u = fit.flat_draws()
    lead = x.shape[:2]
    flat = (v.reshape(-1, *v.shape[2:]) for v in (x, u))
    read = _paths.read_law(fit, *flat, emission=False)
    n = fit.n_states
    tag = read["tag"][:n] if "tag" in read else np.zeros(n, int)
    first = np.unique(tag, return_index=True)[1]
    told, time = _paths.clock_parts(fit, read)
    variables: dict[str, tuple] = {
        "ping": (("state",), states),
        "time": (("state",), time),
        "told": (("state",), told),
        "tag": (("state",), tag),
    }
    deep = [f"depth_{name}" for name in (*_paths.DepthPath.scale_names, "centre")]
    for name in (*site.law.scale_names, "centre", *deep):
        if name in read:
            value = _paths.by_tag(read[name], first, name.endswith("centre"))
            axis = "down" if name == "depth_centre" else "axis"
            dims = ("chain", "draw", "which", axis)[: value.ndim + 1]
            variables[name] = (dims, value.reshape(*lead, *value.shape[1:]))
    return xr.Dataset(variables, attrs={"law": site.law.__name__, "path": site.name})


def water_group(water):
    """The distance to the shore that a prediction needs, too."""
    import xarray as xr

    dims = {"field": ("part", "row", "column"), "origin": ("axis",)}
    parts = dataclasses.asdict(water)
    return xr.Dataset({k: (dims.get(k, ()), np.asarray(v)) for k, v in parts.items()})


def depth_group(depth, n: int):
    """Bottom and known depths that a prediction needs."""
    import xarray as xr

    variables = {
        "observed": (("state",), np.asarray(depth.observed)[:n]),
        "sensed": (("state",), np.asarray(depth.sensed)[:n]),
        "receiver": (("deployment",), np.asarray(depth.receiver)),
        "bottom": ((), np.asarray(depth.bottom)),
        "origin": (("axis",), np.asarray(depth.origin)),
        "step": ((), np.asarray(depth.step)),
    }
    if depth.grid is not None:
        variables["grid"] = (("row", "column"), np.asarray(depth.grid))
    return xr.Dataset(variables, attrs={"known": int(depth.known), "sd": float(depth.sd)})
