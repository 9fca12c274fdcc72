"""Posterior to xarray: groups with named dimensions, coordinates and units."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import InputError
from maloc.infer import _replicate
from maloc.infer._dims import units_of
from maloc.infer._labels import Names, names_of, track_rows
from maloc.infer._stored import depth_group, movement_group, water_group
from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

if TYPE_CHECKING:
    import xarray as xr

    from maloc.infer._fit import Fitted

__all__ = ["to_datatree", "write_posterior"]

_STATS = {"potential": "energy", "steps": "n_steps", "accept": "acceptance_rate"}
_DRAW = ("chain", "draw")


def to_datatree(
    fit: Fitted,
    *,
    log_likelihood: str = "ping",
    predictive: bool = False,
    log_prior: bool = False,
    seed: int = 0,
) -> xr.DataTree:
    """All groups as one `xarray.DataTree`: see `Fit.to_datatree`."""
    import xarray as xr

    if log_likelihood not in ("ping", "value"):
        raise InputError(f"log_likelihood is 'ping' or 'value', not {log_likelihood!r}")
    names = names_of(fit)
    groups = _posterior(fit, names)
    by = _by_ping if log_likelihood == "ping" else _by_value
    groups["log_likelihood"] = names.dataset(by(fit, names))
    if sampled := getattr(fit, "stats", {}):
        named = {_STATS.get(k) or k: np.asarray(v) for k, v in sampled.items()}
        groups["sample_stats"] = names.dataset({k: (_DRAW[: v.ndim], v) for k, v in named.items()})
    groups |= _data(fit, names)
    if predictive:
        values = _replicate.replicated(fit, seed)
        drawn = {k: _value(fit, names, k, v, 2) for k, v in values.items()}
        groups["posterior_predictive"] = names.dataset(drawn)
    if log_prior:
        prior = {k: (_DRAW, v) for k, v in _replicate.log_prior(fit).items()}
        groups["log_prior"] = names.dataset(prior)
    if (unheard := _unheard(fit, names)) is not None:
        groups["unheard"] = unheard
    if (movement := movement_group(fit, names.states)) is not None:
        groups["movement"] = movement
    if fit.water is not None:
        groups["water"] = water_group(fit.water)
    if (depth := getattr(fit.args[0], "depth", None) if fit.args else None) is not None:
        groups["depth"] = depth_group(depth, fit.n_states)
    about = xr.Dataset(attrs={"creator": "maloc"})
    return xr.DataTree.from_dict({"/": about, **{f"/{k}": v for k, v in groups.items()}})


def _posterior(fit: Fitted, names: Names) -> dict[str, xr.Dataset]:
    """Draws at pings, parameters first; those at states between pings in a group of their own."""
    draws = fit.draws()
    parameters = fit.parameter_names
    at_pings, between = {}, {}
    for name in (*parameters, *(k for k in draws if k not in parameters)):
        value, dims, units = draws[name], (*_DRAW, *fit.dims(name)), units_of(fit.cm, name)
        if names.along in dims and not names.states.all():
            moved = tuple("state" if d == names.along else d for d in dims)
            between[name] = (moved, value[:, :, ~names.states], units)
            value = value[:, :, names.states]
        at_pings[name] = (dims, value, units)
    groups = {"posterior": names.dataset(at_pings, parameters=parameters)}
    if between:
        groups["between"] = names.dataset(between)
    return groups


def _by_value(fit: Fitted, names: Names) -> dict[str, tuple]:
    each = {"arrival": "detection"}
    return {k: ((*_DRAW, each.get(k, f"{k}_value")), v) for k, v in fit.pointwise().items()}


def _by_ping(fit: Fitted, names: Names) -> dict[str, tuple]:
    """Log density of all that is known of a ping; a gap's silence belongs to the ping after it.

    Data that run along nothing else than pings stay arrays of their own.
    """
    total, out = None, {}
    for name, value in fit._arrivals()[2].items():
        if value.shape[2] == fit.cm.length(fit.args):
            value = value[:, :, : fit.n_states][:, :, names.states]
        elif name == "gap" and (ends := _ends(fit)) is not None:
            by_gap, value = value, np.zeros((*value.shape[:2], int(names.states.sum())))
            for gap, row in enumerate(ends):
                value[:, :, row] += by_gap[:, :, gap]
        else:
            out[name] = ((*_DRAW, f"{name}_value"), value)
            continue
        total = value if total is None else total + value
    return out if total is None else {f"by_{names.along}": ((*_DRAW, names.along), total), **out}


def _ends(fit: Fitted) -> list[int] | None:
    """The ping that ends each gap; that before it, where none does."""
    from maloc.model_data.gaps import find_gaps

    history = getattr(fit.source, "encounters", fit.source)
    if history is None:
        return None
    return [gap.before if gap.after < 0 else gap.after for gap in find_gaps(history)]


def _value(fit: Fitted, names: Names, name: str, value: np.ndarray, lead: int) -> tuple:
    """Dimensions and values of data of one kind; arrivals those that were heard, in a row."""
    data, dims = fit.args[0] if fit.args else None, _DRAW[:lead]
    if name == "arrival" and isinstance(data, ToaData | JointData):
        return (*dims, "detection"), value[..., np.asarray(data.heard)], {"units": "m"}
    states = fit.cm.length(fit.args)
    along = value.ndim > lead and value.shape[lead] == states
    if along:
        value = value[(slice(None),) * lead + (slice(fit.n_states),)]
        value = value[(slice(None),) * lead + (names.states,)]
    more = tuple(f"{name}_dim_{i}" for i in range(value.ndim - lead))
    return (*dims, names.along if along else "", *more[1:]) if along else (*dims, *more), value


def _data(fit: Fitted, names: Names) -> dict[str, xr.Dataset]:
    """What was observed, and what was known beforehand."""
    data, n = fit.args[0] if fit.args else None, fit.n_states
    if not isinstance(data, ToaData | EncounterData | JointData):
        return {}
    keep, present = names.states, np.asarray(data.present)
    xy = np.asarray(data.receiver_xy)[present]
    constant: dict[str, tuple] = {"receiver_xy": (("receiver", "axis"), xy, {"units": "m"})}
    observed: dict[str, tuple] = {}
    encounters = getattr(data, "encounters", data)
    if isinstance(encounters, EncounterData):
        heard = np.asarray(encounters.heard)[:n][keep]
        column = np.asarray(encounters.receiver)[:n][keep]
        rows, place = np.nonzero(heard)
        observed["encounter"] = (("ping", "encounter_dim_1"), heard)
        constant["encounter_receiver"] = (("ping", "encounter_dim_1"), column)
        constant["encounter_ping"] = (("encounter",), rows)
        constant["encounter_heard_by"] = (("encounter",), column[rows, place])
        constant["tag_index"] = (("ping",), np.asarray(encounters.tag)[:n][keep])
        constant["given_time"] = (("ping",), np.asarray(data.time)[:n][keep], {"units": "s"})
    if isinstance(data, ToaData | JointData):
        heard = np.asarray(data.heard)[:n][keep]
        rows, columns = np.nonzero(heard)
        ranges = np.asarray(data.range)[:n][keep][heard]
        observed["arrival"] = (("detection",), ranges, {"units": "m"})
        constant["detection_ping"] = (("detection",), rows)
        constant["detection_receiver"] = (("detection",), columns)
        speed = np.asarray(data.speed)[:n][keep]
        constant["sound_speed"] = (("ping",), speed, {"units": "m/s"})
    if isinstance(data, ToaData):
        constant["first_arrival"] = (("ping",), np.asarray(data.time)[:n], {"units": "s"})
    return {"observed_data": names.dataset(observed), "constant_data": names.dataset(constant)}


def _unheard(fit: Fitted, names: Names) -> xr.Dataset | None:
    """Rows of track.csv that are predictions: pings that nobody heard."""
    rows = track_rows(fit)
    if rows is None or not len(rows.unheard):
        return None
    wide = ("unheard", "axis")
    variables = {
        "position": (wide, rows.mean, {"units": "m"}),
        "covariance": (("unheard", "axis", "axis_too"), rows.covariance, {"units": "m2"}),
        "low": (wide, rows.low, {"units": "m"}),
        "high": (wide, rows.high, {"units": "m"}),
        "ping": (("unheard",), rows.ping),
        "tag_index": (("unheard",), rows.tag),
        "time": (("unheard",), *names.clock(rows.time)),
    }
    return names.dataset(variables, {"unheard": rows.unheard})


def write_posterior(
    fit: Any, path: Path, tags: Sequence[str], origin: int | None, crs: str | None
) -> None:
    """Write ``posterior.nc``, with the tags' names, time 0 (ns since 1970 UTC) and the frame."""
    tree = fit.to_datatree()
    known: dict[str, Any] = {"tags": list(tags)}
    known |= {} if origin is None else {"origin": np.int64(origin)}
    known |= {} if crs is None else {"crs": crs}
    tree.attrs |= known
    tree.to_netcdf(path, engine="h5netcdf")
