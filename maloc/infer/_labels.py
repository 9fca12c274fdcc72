"""Which ping, tag and receiver a posterior's entry belongs to: coordinates of its dimensions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import FitError
from maloc.infer import _paths, track
from maloc.infer._dims import along
from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

if TYPE_CHECKING:
    import xarray as xr

    from maloc.infer._fit import Fitted
    from maloc.infer._rows import Rows

__all__ = ["Names", "names_of", "track_rows"]

_XY = np.array(["x", "y"], object)  # as objects: fixed lengths have no specification in Zarr 3
_AXES = {"axis": _XY, "axis_too": _XY, "part": np.array(["position", "velocity"], object)}


@dataclass(frozen=True)
class Names:
    """What the dimensions of a fit's posterior are called by.

    Attributes
    ----------
    states : (S,) bool
        Which states of the chain are pings; the rest lie in gaps, where pings may have been missed.
    along : str
        Dimension of the chain's time.
    pings : dict
        Coordinates along it. ``ping``: id in the input (of several tags counted on, with ``number``
        as in arrivals.csv); ``time``: mean emission time, UTC, or s where the input has no date;
        ``heard``; ``ping_tag`` where tags have names; ``row`` in track.csv, from 0.
    others : dict
        Coordinates of all other dimensions.
    origin : int or None
        ns since 1970 UTC of second 0.
    attrs : dict
        Attributes of every group.
    """

    states: np.ndarray
    along: str
    pings: dict[str, Any]
    others: dict[str, Any]
    origin: int | None
    attrs: dict[str, Any]

    def dataset(
        self, variables: dict[str, tuple], more: dict[str, Any] | None = None, **attrs: Any
    ) -> xr.Dataset:
        """Return variables, name -> (dims, values, attributes), with their coordinates."""
        import xarray as xr

        dims = {d for dims, *_ in variables.values() for d in dims}
        coords = {k: v for k, v in self.others.items() if k in dims} | (more or {})
        if self.along in dims:
            coords |= {k: ((self.along,), *v) for k, v in self.pings.items()}
        return xr.Dataset(variables, coords, self.attrs | attrs)

    def clock(self, time: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
        """Times (s from the origin) as UTC where the origin is known, and their attributes."""
        if self.origin is None:
            return time, {"units": "s"}
        ns = self.origin + np.round(time * 1e9).astype(np.int64)
        return ns.astype("datetime64[ns]"), {}


def names_of(fit: Fitted) -> Names:
    """Names and coordinates of a fit's dimensions."""
    from maloc._package.version import __version__

    data, n = fit.args[0] if fit.args else None, fit.n_states
    attrs = {"inference_library": "maloc", "inference_library_version": __version__}
    attrs |= {"method": fit.method, "model": fit.model_name}
    shape = next(iter(fit.draws().values())).shape[:2]
    history = getattr(fit.source, "encounters", fit.source)  # of a joint, or a detection model
    others: dict[str, Any] = {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])} | _AXES
    if (receivers := getattr(history, "receivers", None)) is not None:
        others["receiver"] = np.asarray([str(name) for name in receivers.labels], object)
    if any(tags := getattr(history, "tags", ())):
        others["tag"] = np.asarray(tags, object)
    names = Names(
        np.ones(n, bool), along(fit.cm), {}, others, getattr(history, "origin", None), attrs
    )
    if not isinstance(data, ToaData | EncounterData | JointData):
        names.pings[names.along] = (np.arange(1, n + 1),)
        return names
    if not isinstance(data, ToaData):
        names.states[:] = np.asarray(data.ping)[:n]
    names.pings.update(_pings(fit, data, names, tags))
    return names


def _pings(fit: Fitted, data: Any, names: Names, tags: tuple[str, ...]) -> dict[str, tuple]:
    n, keep = fit.n_states, names.states
    heard = np.asarray(getattr(data, "encounters", data).heard)[:n][keep].any(axis=1)
    tag = np.zeros(len(heard), int) if isinstance(data, ToaData) else np.asarray(data.tag)[:n][keep]
    first = np.unique(tag, return_index=True)[1]
    number = np.arange(len(tag)) - first[np.searchsorted(tag[first], tag)] + 1
    if isinstance(data, ToaData) and fit.source is not None:
        number = fit.source.ping[fit.source.n_heard > 0]
    several = len(np.unique(number)) < len(number)
    out: dict[str, tuple] = {"ping": (np.arange(1, len(tag) + 1) if several else number,)}
    out["time"] = names.clock(_seconds(fit, data)[keep])
    out["heard"] = (heard,)
    if several:
        out["number"] = (number,)
    if any(tags):
        out["ping_tag"] = (np.asarray(tags, object)[tag],)
    if (rows := track_rows(fit)) is not None:
        out["row"] = (rows.known,)
    return out


def _seconds(fit: Fitted, data: Any) -> np.ndarray:
    """Mean emission time of each state, or its time where nothing tells an emission, s."""
    draws, n = fit.draws(), fit.n_states
    time = np.asarray(data.time)[:n]
    if "emission_time" not in draws:
        return time
    told = _paths.emission_told(data)[:n] if isinstance(data, JointData) else np.ones(n, bool)
    return np.where(told, draws["emission_time"].mean(axis=(0, 1)), time)


def track_rows(fit: Fitted) -> Rows | None:
    """Where pings stand in track.csv: as the table that was made has them, or as it would.

    None for a detection or joint model whose table was not made: that counts missed pings first.
    """
    source, known = fit.source, fit._known
    if "rows" not in known and isinstance(source, ArrivalTimes):
        if {"track", "position", "emission_time"} <= set(fit.draws()):
            try:
                track.find_rows(fit, source)
            except FitError:  # nothing says when the others were sent: there is no such table
                return None
    return known.get("rows")
