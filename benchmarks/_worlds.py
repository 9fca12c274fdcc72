"""Worlds that a track is judged in: where each is from, how it is fitted, what is asked of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

import maloc
from benchmarks.gps import read_gps
from maloc.runs.load import load
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from simulations.outside import far_animal
from simulations.walls import WallWorld, wall_world
from simulations.wrong_arrivals import CASES, wrong_arrivals

__all__ = ["Case", "World", "scirep_toa", "ssu1_options", "worlds"]

_STABLE = maloc.Schedule("stable", 2.011, 0.001)  # scirep's tag


class Case(NamedTuple):
    """Arrival times of one tag with their truth: positions (P, 2) of its rows, or GPS fixes."""

    toa: maloc.ArrivalTimes
    truth: np.ndarray
    gps: bool = False


@dataclass(frozen=True)
class World:
    """A kind of data.

    Parameters
    ----------
    name : str
    cases : callable
        From the folder of the data to its cases, each a function that makes it.
    asked : mapping
        Score -> least and greatest value.
    options : mapping
        Fields of `TrackOptions`, where a user has reason to give them.
    worse : float, optional
        Greatest mean error over the best of the builds beside it.
    peer : callable, optional
        From the folder of the data to the mean error (m) of another program in it.
    """

    name: str
    cases: Callable[[Path], list[Callable[[], Case]]]
    asked: Mapping[str, tuple[float, float]]
    options: Mapping[str, Any] = field(default_factory=dict)
    worse: float | None = None
    peer: Callable[[Path], float] | None = None


def _with_truth(folder: Path, name: str, **how: Any) -> Case:
    """A matrix with its truth in columns x, y of this file, or of toa.csv beside it."""
    table = how.pop("receivers", "receivers.csv")
    receivers = maloc.read_receivers(folder / table)
    head = (folder / name).read_text().split("\n", 1)[0].strip().split(",")
    aside = tuple(c for c in ("top", "x", "y", "z") if c in head)
    column = how.pop("column", None)
    toa = maloc.read_toa(folder / name, receivers, ignore_columns=aside, **how)
    truth = pl.read_csv(folder / (name if "x" in head else "toa.csv"))["x", "y"].to_numpy()
    return Case(toa if column is None else toa.replace(column=column), truth)


def _found(folder: Path, pattern: str) -> list[Path]:
    if not (files := sorted(folder.glob(pattern))):
        raise FileNotFoundError(f"no {pattern} in {folder}")
    return files


def _walls(name: str, data: Path) -> list[Callable[[], Case]]:
    return [partial(_with_truth, data / "walls", f"{name}.csv")]


def _rays(start: str, how: str, data: Path) -> list[Callable[[], Case]]:
    (folder,) = _found(data / "rays", f"{start}_*")
    known: dict[str, Any] = {}
    if how:
        known["sound_speed"] = json.loads((folder / "params.json").read_text())["c_mean"]
    if how != "depth":
        return [partial(_with_truth, folder, "toa.csv", **known)]
    known["column"] = maloc.WaterColumn(None, 0.5)
    return [partial(_with_truth, folder, "toa_depth.csv", **known)]


def scirep_toa(data: Path, pings: int) -> maloc.ArrivalTimes:
    """The towed tag's first pings."""
    folder = data / "scirep"
    receivers = maloc.read_receivers(folder / "receivers.csv")
    toa = maloc.read_toa(folder / "toa.csv", receivers, schedule=_STABLE)
    first = {k: getattr(toa, k)[:pings] for k in ("toa", "sound_speed", "ping")}
    return toa.replace(**first)


def _scirep(data: Path) -> list[Callable[[], Case]]:
    return [lambda: Case(scirep_toa(data, 1000), read_gps(data / "scirep" / "gps.csv"), True)]


def ssu1_options(data: Path) -> TrackOptions:
    """What a user says of the tag towed among receivers whose clocks drift."""
    folder = data / "ssu1"
    return TrackOptions(
        detections=(folder / "VUE_Export_ssu1.csv",),
        receivers=folder / "hydros.csv",
        tags=("15266",),
        interval=(20.0, 40.0),
    )


def _ssu1(data: Path) -> list[Callable[[], Case]]:
    def make() -> Case:
        (toa,) = load(ssu1_options(data), Log(quiet=True)).toas
        return Case(toa, read_gps(data / "ssu1" / "gps.csv"), True)

    return [make]


def _canal(cell: str, data: Path) -> list[Callable[[], Case]]:
    files = _found(data / "sim_canal", f"track*_{cell}.csv")
    return [partial(_with_truth, data / "sim_canal", f.name) for f in files]


def _lake(kind: str, schedule: maloc.Schedule, data: Path) -> list[Callable[[], Case]]:
    files = _found(data / "sim_lake", f"lake*_{kind}_*.csv")
    return [
        partial(
            _with_truth,
            data / "sim_lake",
            f.name,
            receivers=f"receivers_{f.stem[4:6]}.csv",
            schedule=schedule,
        )
        for f in files
    ]


def _yaps(folder: str, cell: str, data: Path) -> float:
    """Mean error of YAPS on the files of a cell, m."""
    table = pl.read_csv(data / folder / "yaps_results.csv")
    return float(np.mean(table.filter(pl.col("file").str.contains(cell))["mean"].to_numpy()))


def _towed(track: str, time: str, data: Path) -> float:
    """Mean distance of another program's positions from the GPS, m; those that were heard."""
    table = pl.read_csv(data / track)
    table = table.filter(pl.col("nobs") > 0) if "nobs" in table.columns else table
    gps, t = read_gps((data / track).parent / "gps.csv"), table[time].to_numpy()
    true = np.column_stack([np.interp(t, gps[:, 2], gps[:, a]) for a in (0, 1)])
    off = np.linalg.norm(table["x", "y"].to_numpy() - true, axis=1)
    return float(off[(t > gps[0, 2]) & (t < gps[-1, 2])].mean())


def _drawn(
    key: int, tracks: int, draw: Callable[..., tuple[maloc.ArrivalTimes, np.ndarray]], *args: Any
) -> Callable[[Path], list[Callable[[], Case]]]:
    """Cases that a simulator draws, each by its seed."""

    def make(i: int) -> Case:
        return Case(*draw(np.random.default_rng([18, key, i]), *args))

    return lambda data: [partial(make, i) for i in range(tracks)]


_WALL = {"mean": (0.0, 0.6), "p95": (0.0, 2.0), "cover": (0.93, 0.97)}
_STILL = _WALL | {"cover": (0.93, 1.0)}  # errors of a tag that lies still are one error
_ELLIPSE = {"ellipse": (0.92, 0.97)}
_ROBUST = {"cover": (0.93, 0.97)} | _ELLIPSE
_SIMULATED = {"cover": (0.93, 0.97)}
_TOWED = {"mean": (0.0, 0.26), "p95": (0.0, 0.6), "cover_x": (0.9, 1.0), "cover_y": (0.9, 1.0)}
_BOAT = {"mean": (0.0, 2.8), "p95": (0.0, 5.5)}
_FAR = {"cover": (0.92, 0.97), "bias": (0.0, 0.5)}
_BEST_BY_RAYS = {"s00": None, "s01": 0.56, "s03": 1.38, "s05": 0.41, "s08": 0.53, "s10": 1.31}
_WALL_KINDS = {
    "half": WallWorld(),
    "third": WallWorld(share=0.33, late=(8.0, 25.0)),
    "far": WallWorld(late=(12.0, 135.0), spread=(0.2, 4.0)),
    "fixed third": WallWorld(fixed=True, share=0.33, late=(12.0, 135.0), spread=(0.2, 4.0)),
    "fixed half": WallWorld(fixed=True, share=0.5, late=(12.0, 135.0), spread=(0.2, 4.0)),
    "fixed most": WallWorld(600, True, 0.6, (12.0, 135.0), (0.2, 4.0), interval=(540.0, 660.0)),
}
_FAR_OFF = ((400, 800), (400, 1500), (400, 2500), (800, 2500))
_CELLS = [f"na{na}_mp{mp}" for na in ("00", "30", "50") for mp in ("00", "06", "15")]
_LAKES = {
    "rbi": maloc.Schedule("random", 20.0, 40.0),
    "sbi": maloc.Schedule("stable", 60.0, 0.001),
}


def worlds(tracks: int) -> Iterator[World]:
    """All worlds; those that are drawn have so many tracks each."""
    yield World("walls/wall_400", partial(_walls, "wall_400"), _WALL)
    yield World("walls/fixed_150", partial(_walls, "fixed_150"), _STILL)
    for key, (name, kind) in enumerate(_WALL_KINDS.items()):
        drawn = _drawn(100 + key, max(tracks // 4, 1), wall_world, kind)
        yield World(f"walls/{name}", drawn, _STILL if kind.fixed else _WALL)
    for how in ("", "speed", "depth"):
        for name, best in _BEST_BY_RAYS.items():
            asked = _ELLIPSE if best is None else _ELLIPSE | {"mean": (0.0, best)}
            yield World(f"rays/{name} {how}".strip(), partial(_rays, name, how), asked)
    umap = partial(_towed, "scirep/peer_umap.csv", "top")
    yield World("scirep", _scirep, _TOWED, {"sound_speed": "estimated"}, peer=umap)
    yield World("ssu1", _ssu1, _BOAT, peer=partial(_towed, "ssu1/peer_yaps_track.csv", "epo"))
    for key, name in enumerate(CASES):
        more = 1.02 if name == "right" else 1.0
        drawn = _drawn(200 + key, tracks, wrong_arrivals, name)
        yield World(f"robust/{name}", drawn, _ROBUST, worse=more)
    for key, (d, away) in enumerate(_FAR_OFF):
        drawn = _drawn(300 + key, tracks, far_animal, d, away)
        yield World(f"outside/{d} {away}", drawn, _FAR)
    for cell in _CELLS:
        how = {"worse": 1.01, "peer": partial(_yaps, "sim_canal", cell)}
        yield World(f"sim_canal/{cell}", partial(_canal, cell), _SIMULATED, **how)
    for kind, schedule in _LAKES.items():
        how = {"worse": 1.01, "peer": partial(_yaps, "sim_lake", kind)}
        yield World(f"sim_lake/{kind}", partial(_lake, kind, schedule), _SIMULATED, **how)
