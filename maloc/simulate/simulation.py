"""A whole simulated study: raw detections with drifting clocks, and everything that is true."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maloc.data import ArrivalTimes, Detections, Receivers, Schedule
from maloc.errors import InputError
from maloc.simulate import arrays
from maloc.simulate.animals import correlated_walk, ctcrw
from maloc.simulate.clocks import Clocks, draw_clocks
from maloc.simulate.hearing import Arrivals, Hearing, hear
from maloc.simulate.pings import burst_times, sound_speed_walk

__all__ = ["SCENARIOS", "Simulation", "Truth", "canal_toa", "simulate"]

SCENARIOS = {"canal": arrays.canal, "grid": arrays.grid, "line": arrays.line}

ORIGIN = 1_767_225_600_000_000_000  # 2026-01-01 00:00 UTC, ns: second 0 of what is simulated
TAG = "A69-1602-1001"
_V13 = Schedule("random", 20.6, 36.6)  # burst interval of the tags in the canal studies, s
_SYNC = Schedule("random", 60.0, 120.0)


class Truth(NamedTuple):
    """What is true of each ping of the animal's tag, all (P,).

    ``ping`` 1..P, ``time`` emission in s from the origin, ``x`` and ``y`` m, ``n_heard`` how many
    receivers heard it.
    """

    ping: np.ndarray
    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    n_heard: np.ndarray


@dataclass(frozen=True, repr=False, eq=False)
class Simulation:
    """Simulated data and their truth.

    Parameters
    ----------
    truth : Truth
        The animal's pings.
    detections : Detections
        As the receivers' own, drifting clocks wrote them; the animal's and the sync tags'.
    toa : ArrivalTimes
        The same detections of the animal, on the true clock.
    receivers : Receivers
        The table of receivers, with their sync tags.
    clocks : Clocks
        How far each clock is ahead of true time.
    options : mapping
        What was asked for.
    """

    truth: Truth
    detections: Detections
    toa: ArrivalTimes
    receivers: Receivers
    clocks: Clocks
    options: Mapping[str, Any]

    def __repr__(self) -> str:
        return (
            f"Simulation of a {self.options['scenario']}: {len(self.truth.ping)} pings, "
            f"{len(self.receivers)} receivers, {len(self.detections)} detections"
        )

    def write(self, folder: Path | str, force: bool = False) -> Path:
        """Write the tables that ``maloc simulate`` promises, the folder whole or not at all.

        Parameters
        ----------
        folder : path
            ``detections.csv`` and ``receivers.csv`` (what a study would have), ``toa.csv`` (on the
            true clock), ``truth.csv``, ``clocks.csv`` (error of each clock at its knots, s) and
            ``summary.json`` (what was asked for).
        force : bool
            Replace an earlier output.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        InputError
            If the folder exists already and `force` is off, or cannot be written.
        """
        import polars as pl

        from maloc._package.version import __version__
        from maloc.export.folder import output_folder

        when = pl.Series("time", ORIGIN + np.round(self.truth.time * 1e9).astype(np.int64))
        truth = {
            "ping": self.truth.ping,
            "time": when.cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ"),
            "t": self.truth.time,
            "x": self.truth.x,
            "y": self.truth.y,
            "n_heard": self.truth.n_heard,
        }
        ahead = dict(zip(map(str, self.receivers.receiver), self.clocks.ahead.T, strict=True))
        with output_folder(Path(folder), force) as out:
            self.detections.to_frame().write_csv(out / "detections.csv")
            self.receivers.to_frame().write_csv(out / "receivers.csv")
            self.toa.to_frame().write_csv(out / "toa.csv")
            pl.DataFrame(truth).write_csv(out / "truth.csv")
            pl.DataFrame({"t": self.clocks.knots, **ahead}).write_csv(out / "clocks.csv")
            summary = {"maloc": __version__, "command": "simulate", "options": dict(self.options)}
            (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
        return Path(folder)


def simulate(
    rng: np.random.Generator,
    scenario: str = "grid",
    n_pings: int = 250,
    *,
    schedule: Schedule = _V13,
    hearing: Hearing | None = None,
    sound_speed: float = 1450.0,
    sound_speed_walk_rate: float = 0.0,
    sigma_vel: float = 0.1,
    t05: float = 300.0,
    speed: float = 0.15,
    sync_every: int = 2,
    sync_schedule: Schedule = _SYNC,
    offset_sd: float = 0.5,
    drift_ppm: float = 5.0,
) -> Simulation:
    """Simulate one tagged animal in an array of receivers with drifting clocks and sync tags.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance: the same state gives the same study.
    scenario : {"grid", "line", "canal"}
        Array. In "grid" and "line" the animal is an exact CTCRW that starts over the array's
        centre; in "canal" a correlated random walk that stays in the water.
    n_pings : int
        Pings of the animal's tag.
    schedule : Schedule
        Its burst interval, "random" or "stable".
    hearing : Hearing, optional
        Missing shares, late arrivals, noise and resolution, of the sync tags' pings too.
    sound_speed : float
        At the start, m/s.
    sound_speed_walk_rate : float
        How it wanders, m/s per square root second.
    sigma_vel, t05 : float
        CTCRW: standard deviation of the velocity, m/s an axis, and time to 5 % correlation, s.
    speed : float
        Canal: mean speed, m/s.
    sync_every : int
        Each `sync_every`-th receiver, the first included, has a sync tag; 0 = none.
    sync_schedule : Schedule
        Burst interval of the sync tags.
    offset_sd, drift_ppm : float
        Clocks' offsets, s, and drifts, microseconds a second; the first receiver keeps true time.

    Returns
    -------
    Simulation

    Raises
    ------
    InputError
        If the scenario is unknown, there is no ping, or a number makes no sense.
    """
    if scenario not in SCENARIOS:
        raise InputError(f"scenario '{scenario}' is not one of {', '.join(SCENARIOS)}")
    if n_pings < 1:
        raise InputError(f"{n_pings} pings are none to simulate")
    hearing = Hearing() if hearing is None else hearing
    array = SCENARIOS[scenario]()
    emission = burst_times(rng, n_pings, schedule)
    if array.water is None:
        xy = ctcrw(rng, emission, sigma_vel, t05, start=tuple(array.xy.mean(0)))
    else:
        xy = correlated_walk(rng, emission, array.water, speed)
    duration = float(emission[-1]) + schedule.lo
    clocks = draw_clocks(rng, len(array.xy), duration, offset_sd, drift_ppm)
    c = sound_speed_walk(rng, emission, sound_speed, sound_speed_walk_rate)
    arrivals = hear(rng, emission, xy, array.xy, c, hearing)

    sync_tag = np.array([""] * len(array.xy), dtype="U16")
    parts = [(TAG, arrivals)]
    for j in range(0, len(array.xy), sync_every) if sync_every > 0 else ():
        sync_tag[j] = f"A69-1602-{9001 + j}"
        n = int(duration / max(sync_schedule.lo, 1e-3)) + 1
        t = burst_times(rng, n, sync_schedule)
        t = t[t <= duration]
        c_sync = np.interp(t, emission, c)
        there = np.broadcast_to(array.xy[j], (len(t), 2))
        parts.append((str(sync_tag[j]), hear(rng, t, there, array.xy, c_sync, hearing)))

    receivers = Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1], sync_tag=sync_tag)
    detections, row = _raw(parts, receivers, clocks, hearing.resolution)
    toa = _arrival_times(arrivals, receivers, c, schedule, hearing.resolution, row)
    options = {
        "scenario": scenario,
        "n_pings": n_pings,
        "schedule": asdict(schedule),
        "hearing": {**asdict(hearing), "scale": None if np.isinf(hearing.scale) else hearing.scale},
        "sound_speed": sound_speed,
        "sound_speed_walk_rate": sound_speed_walk_rate,
        "sync_every": sync_every,
        "sync_schedule": asdict(sync_schedule),
        "offset_sd": offset_sd,
        "drift_ppm": drift_ppm,
    }
    options |= {"sigma_vel": sigma_vel, "t05": t05} if array.water is None else {"speed": speed}
    n_heard = arrivals.heard.sum(1)
    truth = Truth(np.arange(1, n_pings + 1), emission, xy[:, 0], xy[:, 1], n_heard)
    return Simulation(truth, detections, toa, receivers, clocks, options)


def canal_toa(
    rng: np.random.Generator,
    n_pings: int = 250,
    p_na: float = 0.3,
    p_mp: float = 0.06,
    margin: float | None = 60.0,
) -> tuple[ArrivalTimes, Truth]:
    """Simulate one canal track's arrival times alone, for benchmarks over many tracks.

    Of the kind of the yaps studies' canal tracks: twelve receivers, burst interval
    Uniform(20.6, 36.6) s, known sound speed that wanders around 1450 m/s, milliseconds with
    signed Poisson(1) noise, detours of 50 to 300 m.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    n_pings : int
        Pings.
    p_na, p_mp : float
        Shares of missing and of late arrivals.
    margin : float, optional
        The animal roams the array's bounding box widened by this, m, as those tracks do; None =
        it stays in the canal's water.

    Returns
    -------
    toa : ArrivalTimes
        On the true clock.
    truth : Truth
        Emission times and positions.
    """
    array = arrays.canal()
    emission = burst_times(rng, n_pings, _V13)
    polygon = array.water
    if margin is not None:
        (x0, y0), (x1, y1) = array.xy.min(0) - margin, array.xy.max(0) + margin
        polygon = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    assert polygon is not None
    start = array.xy[rng.integers(len(array.xy))]
    xy = correlated_walk(rng, emission, polygon, start=(float(start[0]), float(start[1])))
    c = sound_speed_walk(rng, emission, 1450.0, 0.07)
    hearing = Hearing(p_na=p_na, p_mp=p_mp)
    arrivals = hear(rng, emission, xy, array.xy, c, hearing)
    receivers = Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1])
    toa = _arrival_times(arrivals, receivers, c, _V13, hearing.resolution, None)
    ping = np.arange(1, n_pings + 1)
    return toa, Truth(ping, emission, xy[:, 0], xy[:, 1], arrivals.heard.sum(1))


def _raw(
    parts: list[tuple[str, Arrivals]], receivers: Receivers, clocks: Clocks, resolution: float
) -> tuple[Detections, np.ndarray]:
    """All detections on the receivers' own clocks, in time order; and the animal's rows (P, R)."""
    time, receiver, tag = [], [], []
    for name, arrivals in parts:
        shown = arrivals.observed(resolution, clocks.error(arrivals.direct + arrivals.late))
        ping, column = np.nonzero(arrivals.heard)
        seconds = shown[ping, column]
        time.append(ORIGIN + np.round(seconds * 1e9).astype(np.int64))
        receiver.append(receivers.receiver[column])
        tag.append(np.full(len(ping), name))
    order = np.argsort(np.concatenate(time), kind="stable")
    detections = Detections(
        np.concatenate(time)[order],
        np.concatenate(receiver)[order],
        np.concatenate(tag)[order],
    )
    row = np.full(parts[0][1].heard.shape, -1)
    place = np.argsort(order, kind="stable")
    row[parts[0][1].heard] = place[: int(parts[0][1].heard.sum())]
    return detections, row


def _arrival_times(
    arrivals: Arrivals,
    receivers: Receivers,
    sound_speed: np.ndarray,
    schedule: Schedule,
    resolution: float,
    row: np.ndarray | None,
) -> ArrivalTimes:
    return ArrivalTimes(
        arrivals.observed(resolution),
        receivers,
        sound_speed,
        tag=TAG,
        origin=ORIGIN,
        schedule=schedule,
        detection=row,
    )
