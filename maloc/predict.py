"""Tracks read back from a finished run, at any times: what `maloc predict` is made of.

In Python a fit does the same itself: ``fit.predict(times)`` and ``fit.sample_tracks(times)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._limits import Z95
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

    from maloc.infer._bridge import PathDraws
    from maloc.infer.predict import Prediction, TrackDraws

__all__ = ["StoredTrack", "prediction_table", "read_tracks", "regular_times"]


@dataclass(frozen=True, eq=False, repr=False)
class StoredTrack:
    """The posterior of one tag's track as a run left it.

    Attributes
    ----------
    tag : str
    path : PathDraws
        Draws of its states, their times and the parameters of its movement.
    method : str
        How it was fitted.
    origin : int or None
        Time 0 as ns since 1970 UTC, where it is known.
    crs : str or None
        Frame of the positions, where it is known.
    """

    tag: str
    path: PathDraws
    method: str
    origin: int | None = None
    crs: str | None = None

    @property
    def span(self) -> tuple[float, float]:
        """Median times of the first and the last state, s."""
        clock = self.path.clock
        return float(np.median(clock[:, 0])), float(np.median(clock[:, -1]))

    def predict(self, times) -> Prediction:
        """Posterior at any times (n,), s from `origin`: the mixture of the draws' bridges."""
        from maloc.infer.predict import mixture

        return mixture(self.path, np.atleast_1d(np.asarray(times, float)))

    def sample_tracks(self, times, n: int = 200, seed: int = 0) -> TrackDraws:
        """Whole tracks at ascending times (n,), s: one through each of n draws at most."""
        from maloc.infer.predict import drawn

        times = np.atleast_1d(np.asarray(times, float))
        return drawn(self.path, times, n, seed, tag=self.tag, origin=self.origin, crs=self.crs)

    def __repr__(self) -> str:
        draws, states = self.path.clock.shape
        return f"StoredTrack: {self.tag or 'no name'}, {draws} draws of {states} states"


def read_tracks(folder: str | Path) -> list[StoredTrack]:
    """Read the tracks of a finished `maloc track`.

    Parameters
    ----------
    folder : path
        What ``maloc track --out`` wrote.

    Returns
    -------
    list of StoredTrack
        One a tag.

    Raises
    ------
    InputError
        If it is no such folder, or the model had no movement between pings.
    """
    folder = Path(folder)
    files = sorted(folder.glob("posterior*.nc"))
    if not files:
        raise InputError(
            "holds no posterior.nc", file=folder, mend="give a folder that maloc track wrote"
        )
    return [track for file in files for track in _read(file)]


def _read(file: Path) -> list[StoredTrack]:
    import xarray as xr

    from maloc import movement
    from maloc.infer._bridge import PathDraws
    from maloc.infer._depths import DepthDraws
    from maloc.infer._paths import in_order
    from maloc.world.depth import DepthPath

    def group(name: str | None):
        with xr.open_dataset(file, group=name, engine="h5netcdf") as found:
            return found.load()

    try:
        about, law, posterior = group(None).attrs, group("movement"), group("posterior")
    except (OSError, ValueError, KeyError) as problem:
        raise InputError(
            f"has no movement to predict by ({type(problem).__name__})",
            file=file,
            mend="run maloc track again with this version",
        ) from None
    among = law["ping"].values.astype(bool) if "ping" in law else np.ones(law.sizes["state"], bool)
    between = None if among.all() else group("between")

    def draws(name: str) -> np.ndarray:
        """Draws (D, S, ...) of a site at all states: those of pings, and those between them."""
        at_pings = _flat(posterior[name].values)
        if between is None:
            return at_pings
        out = np.empty((len(at_pings), len(among), *at_pings.shape[2:]))
        out[:, among], out[:, ~among] = at_pings, _flat(between[name].values)
        return out

    kind = getattr(movement, law.attrs["law"])
    track = draws(law.attrs["path"])
    state = track.reshape(*track.shape[:2], -1, track.shape[-1])
    told = law["told"].values.astype(bool)
    clock = np.broadcast_to(_time(law["time"]), track.shape[:2])
    if told.any():
        clock = np.where(told, draws("emission_time"), clock)
    water, deep = _stored_water(file), _stored_depth(file)
    names = np.atleast_1d(about.get("tags", [""])).tolist()
    origin = int(about["origin"]) if "origin" in about else None
    out = []
    for k in range(int(law["tag"].values.max()) + 1):
        mine = np.flatnonzero(law["tag"].values == k)
        scale = {name: _flat(law[name].values)[:, k] for name in kind.scale_names}
        home = _flat(law["centre"].values)[:, k] if "centre" in law else None
        own = in_order(clock[:, mine])
        depth = None
        if deep is not None:
            path = None
            if "depth_path" in posterior:
                z = draws("depth_path")[:, mine, None]
                how = {n: _flat(law[f"depth_{n}"].values)[:, k] for n in DepthPath.scale_names}
                centre = _flat(law["depth_centre"].values)[:, k]
                path = PathDraws(movement.OU, how, own, z, centre)
            known = np.asarray(deep.observed)[mine]
            depth = DepthDraws(path, deep, np.median(own, axis=0), known)
        path = PathDraws(kind, scale, own, state[:, mine], home, water, depth)
        name = str(names[k]) if k < len(names) else str(k)
        out.append(StoredTrack(name, path, posterior.attrs["method"], origin, about.get("crs")))
    return out


def _stored_water(file: Path):
    """What kept the animals off the land, or None."""
    import h5netcdf
    import xarray as xr

    with h5netcdf.File(file, "r") as stored:
        if "water" not in stored.groups:
            return None
    from maloc.world.habitat import Water

    with xr.open_dataset(file, group="water", engine="h5netcdf") as found:
        parts = {str(name): np.asarray(value.values) for name, value in found.items()}

    return Water(**parts)


def _stored_depth(file: Path):
    """Bottom and known depths of a track that has depth, or None."""
    import h5netcdf
    import xarray as xr

    with h5netcdf.File(file, "r") as stored:
        if "depth" not in stored.groups:
            return None
    from maloc.world.depth_data import DepthData

    with xr.open_dataset(file, group="depth", engine="h5netcdf") as found:
        parts: dict[str, Any] = {str(name): np.asarray(v.values) for name, v in found.items()}
        sd, known = np.asarray(found.attrs["sd"]), bool(found.attrs["known"])
    initial, grid = parts["observed"], parts.pop("grid", None)
    return DepthData(**parts, grid=grid, sd=sd, initial=initial, known=known)


def _flat(values: np.ndarray) -> np.ndarray:
    """(chain, draw, ...) as (draws, ...)."""
    return values.reshape(-1, *values.shape[2:])


def _time(time: Any) -> np.ndarray:
    return np.asarray(time.values, float)


def regular_times(first: float, last: float, every: float, origin: int | None = None) -> np.ndarray:
    """Whole multiples of ``every`` seconds (of UTC, where the origin is known) in [first, last].

    Raises
    ------
    InputError
        If ``every`` is not positive, or there would be more than ten million times.
    """
    if not (np.isfinite(every) and every > 0):
        raise InputError(f"--every {every:g} is no number of seconds")
    if (last - first) / every > 1e7:
        raise InputError(f"--every {every:g} s makes more than ten million times")
    start = 0.0 if origin is None else (origin % round(every * 1e9)) / 1e9
    n = np.arange(np.ceil((first + start) / every), np.floor((last + start) / every) + 1)
    return n * every - start


def prediction_table(track: StoredTrack, times: np.ndarray, seed: int = 0) -> pl.DataFrame:
    """Posterior at times (n,) as a table.

    Returns
    -------
    polars.DataFrame
        tag, time (ISO 8601 UTC or null), t (the input's seconds), x, y, sd_x, sd_y (m), cov_xy
        (m2), x_lo, x_hi, y_lo, y_hi (central 95 %: of draws, or of a Laplace fit's normal law), the
        depth z and sd_z (m) of a track that has it, vx, vy, sd_vx, sd_vy (m/s) where the movement
        has velocities, within (between the first ping and
        the last), and longitude, latitude where the frame is known.
    """
    import polars as pl

    found = track.predict(times)
    sd = np.sqrt(np.einsum("tii->ti", found.covariance))
    low, high = found.position - Z95 * found.sd, found.position + Z95 * found.sd
    if track.method != "laplace":
        tracks = track.sample_tracks(times, 1000, seed)
        low, high = np.quantile(tracks.position, [0.025, 0.975], axis=0)
    time, t = pl.Series([None] * len(times), dtype=pl.String), times
    if track.origin is not None:
        ns = pl.Series(track.origin + np.round(times * 1e9).astype(np.int64))
        time = ns.cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        t = track.origin / 1e9 + times
    columns = {"tag": [track.tag] * len(times), "time": time, "t": t}
    columns |= {"x": found.mean[:, 0], "y": found.mean[:, 1], "sd_x": sd[:, 0], "sd_y": sd[:, 1]}
    columns |= {"cov_xy": found.covariance[:, 0, 1]}
    columns |= {"x_lo": low[:, 0], "x_hi": high[:, 0], "y_lo": low[:, 1], "y_hi": high[:, 1]}
    order, axes = track.path.state.shape[2:]
    if found.depth is not None:
        columns |= {"z": found.depth, "sd_z": found.depth_sd}
    if order == 2:
        columns |= {"vx": found.mean[:, axes], "vy": found.mean[:, axes + 1]}
        columns |= {"sd_vx": sd[:, axes], "sd_vy": sd[:, axes + 1]}
    columns["within"] = found.within
    if track.crs is not None:
        from pyproj import Transformer

        degrees = Transformer.from_crs(track.crs, "EPSG:4326", always_xy=True)
        columns["longitude"], columns["latitude"] = degrees.transform(*found.position.T)
    return pl.DataFrame(columns)
