"""Posterior to xarray and ArviZ."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["to_datatree", "to_inference_data", "write_posterior"]


def _groups(fit: Fitted) -> dict:
    """InferenceData's groups as xarray Datasets."""
    import xarray as xr

    from maloc._version import __version__

    draws = fit.draws()
    data = fit.args[0] if fit.args else None
    along = "state" if isinstance(data, EncounterData | JointData) else "ping"
    attrs = {"inference_library": "maloc", "inference_library_version": __version__}
    attrs |= {"method": fit.method, "model": fit.model_name}
    chain_path = {s.name for s in fit.cm.chain}
    variables = {}
    for name, value in draws.items():
        dims = ["chain", "draw"]
        for axis, size in enumerate(value.shape[2:]):
            if axis == 0 and size == fit.n_states and (name in chain_path or value.ndim > 2):
                dims.append(along)
            elif size == 2 and name in ("track", "position") and axis == value.ndim - 3:
                dims.append("axis")
            else:
                dims.append(f"{name}_dim_{axis}")
        variables[name] = (dims, value)
    shape = next(iter(draws.values())).shape[:2]
    coords = {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])}
    groups = {"posterior": xr.Dataset(variables, coords, attrs)}
    pointwise = fit.pointwise()
    each = {"arrival": "detection"} if along == "ping" else {}
    groups["log_likelihood"] = xr.Dataset(
        {k: (("chain", "draw", each.get(k, f"{k}_value")), v) for k, v in pointwise.items()},
        coords,
        attrs,
    )
    stats = getattr(fit, "stats", {})
    rename = {"potential": "energy", "steps": "n_steps", "accept": "acceptance_rate"}
    groups["sample_stats"] = xr.Dataset(
        {
            rename.get(k, k): (("chain", "draw")[: np.ndim(v)], np.asarray(v))
            for k, v in stats.items()
        },
        coords if stats else None,
        attrs,
    )
    if isinstance(data, ToaData):
        groups |= _toa_groups(fit, data, list(pointwise))
    elif isinstance(data, EncounterData):
        groups |= _encounter_groups(fit, data)
    elif isinstance(data, JointData):
        groups |= _joint_groups(fit, data, list(pointwise))
    return groups


def _joint_groups(fit: Fitted, data: JointData, names: list[str]) -> dict:
    """Encounters, and the arrivals with where they belong."""
    groups = _encounter_groups(fit, data.encounters)
    if "arrival" in names:
        n = fit.n_states
        rows, columns = np.nonzero(np.asarray(data.heard)[:n])
        groups["observed_data"] = groups["observed_data"].assign(
            arrival=("arrival_value", np.asarray(data.range)[rows, columns]),
            arrival_state=("arrival_value", rows),
            arrival_receiver=("arrival_value", columns),
        )
        speed = np.asarray(data.speed)[:n]
        groups["constant_data"] = groups["constant_data"].assign(sound_speed=("state", speed))
    return groups


def _encounter_groups(fit: Fitted, data: EncounterData) -> dict:
    import xarray as xr

    n = fit.n_states
    heard, columns = np.asarray(data.heard)[:n], np.asarray(data.receiver)[:n]
    rows, place = np.nonzero(heard)
    observed = {
        "detection_state": (("detection",), rows),
        "detection_receiver": (("detection",), columns[rows, place]),
    }
    present = np.asarray(data.present)
    constant = {
        "time": (("state",), np.asarray(data.time)[:n]),
        "tag": (("state",), np.asarray(data.tag)[:n]),
        "is_ping": (("state",), np.asarray(data.ping)[:n]),
        "receiver_xy": (("receiver", "axis"), np.asarray(data.receiver_xy)[present]),
    }
    return {"observed_data": xr.Dataset(observed), "constant_data": xr.Dataset(constant)}


def _toa_groups(fit: Fitted, data: ToaData, names: list[str]) -> dict:
    import xarray as xr

    n = fit.n_states
    heard = np.asarray(data.heard)[:n]
    rows, columns = np.nonzero(heard)
    observed = {
        name: (("detection",), np.asarray(data.range)[:n][heard])
        for name in names
        if name == "arrival"
    }
    constant = {
        "detection_ping": (("detection",), rows),
        "detection_receiver": (("detection",), columns),
        "receiver_xy": (
            ("receiver", "axis"),
            np.asarray(data.receiver_xy)[np.asarray(data.present)],
        ),
        "first_arrival": (("ping",), np.asarray(data.time)[:n]),
        "sound_speed": (("ping",), np.asarray(data.speed)[:n]),
    }
    return {
        "observed_data": xr.Dataset(observed),
        "constant_data": xr.Dataset(constant),
    }


def to_datatree(fit: Fitted):
    """All groups as one `xarray.DataTree`; what ``posterior.nc`` holds."""
    import xarray as xr

    groups = {f"/{name}": group for name, group in _groups(fit).items()}
    if (movement := _movement(fit)) is not None:
        groups["/movement"] = movement
    if fit.water is not None:
        groups["/water"] = _water(fit.water)
    if (depth := getattr(fit.args[0], "depth", None) if fit.args else None) is not None:
        groups["/depth"] = _depth(depth, fit.n_states)
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs={"creator": "maloc"}), **groups})


def _movement(fit: Fitted):
    """What a prediction needs besides the path's draws: see `maloc.predict`."""
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
    variables = {
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


def _water(water):
    """The distance to the shore that a prediction needs, too."""
    import xarray as xr

    dims = {"field": ("part", "row", "column"), "origin": ("axis",)}
    parts = dataclasses.asdict(water)
    return xr.Dataset({k: (dims.get(k, ()), np.asarray(v)) for k, v in parts.items()})


def _depth(depth, n: int):
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


def write_posterior(
    fit: Any, path: Path, tags: Sequence[str], origin: int | None, crs: str | None
) -> None:
    """Write ``posterior.nc``, with the tags' names, time 0 (ns since 1970 UTC) and the frame."""
    tree = fit.to_datatree()
    known = {"tags": list(tags)}
    known |= {} if origin is None else {"origin": np.int64(origin)}
    known |= {} if crs is None else {"crs": crs}
    tree.attrs |= known
    tree.to_netcdf(path, engine="h5netcdf")


def to_inference_data(fit: Fitted):
    """All groups as ArviZ InferenceData (arviz < 1) or the DataTree that arviz 1 takes."""
    import arviz as az

    if hasattr(az, "InferenceData") and isinstance(az.InferenceData, type):
        return az.InferenceData(**_groups(fit))
    return to_datatree(fit)
