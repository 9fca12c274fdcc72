"""What the third dimension is worth: ``python -m simulations.depth --tracks 20``.

Tags roam a grid of receivers moored near the surface and near the bottom in turn; their depth
wanders (Ornstein-Uhlenbeck, mirrored at surface and bottom: not the law of the model), and a
pressure sensor with an error of its own speaks at a share of the pings. Each track is fitted by the
Laplace approximation as if it were flat, with the sensed depths, with none of them, and with the
true depths. Printed: mean horizontal error and its ratio to the flat track's, coverage of central
95 % intervals of x and y, and of depths; mean error of depth.
"""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np

from maloc import infer
from maloc.data import ArrivalTimes, Receivers, Schedule, WaterColumn
from maloc.models import toa_track
from maloc.simulate import Hearing, arrays
from maloc.simulate.animals import ctcrw
from maloc.simulate.depths import swimming_depth
from maloc.simulate.hearing import hear
from maloc.simulate.pings import burst_times

SPEED = 1480.0
SCHEDULE = Schedule("random", 20.6, 36.6)
HEARING = Hearing(p_na=0.3, scale=200.0, p_mp=0.06, noise="gaussian", sd=1e-3, resolution=0.0)


class Study(NamedTuple):
    """One simulated track: arrival times with sensed depths, positions (P, 3) m, depth of water."""

    toa: ArrivalTimes
    place: np.ndarray
    bottom: float


def simulate(
    rng: np.random.Generator,
    pings: int,
    *,
    bottom: float = 80.0,
    sd: float = 20.0,
    sensed: float = 0.5,
    sensor_sd: float = 1.0,
    n_receivers: int = 16,
) -> Study:
    """Draw one track, and what receivers and sensor say of it."""
    xy = arrays.grid(n_receivers).xy
    row = np.arange(len(xy))
    moored = np.where((row + row // 4) % 2 == 0, 0.1 * bottom, 0.95 * bottom)
    sent = burst_times(rng, pings, SCHEDULE)
    path = ctcrw(rng, sent, 0.1, 300.0, start=tuple(xy.mean(0)))
    depth = swimming_depth(rng, sent, bottom, 0.5 * bottom, sd)
    place = np.column_stack([path, depth])
    at = np.column_stack([xy, moored])
    heard = hear(rng, sent, place, at, np.full(pings, SPEED), HEARING)
    says = depth + sensor_sd * rng.standard_normal(pings)
    says[rng.random(pings) >= sensed] = np.nan
    names = np.array([f"R{i}" for i in row])
    receivers = Receivers(names, xy[:, 0], xy[:, 1], moored)
    toa = ArrivalTimes(
        heard.observed(0.0), receivers, np.full(pings, SPEED), schedule=SCHEDULE, depth=says
    )
    return Study(toa, place, bottom)


def score(fit, truth: np.ndarray) -> dict[str, float]:
    """Errors and coverage of one fit at the heard pings (T, 3)."""
    mean, _, low, high = fit.positions()
    xy = truth[:, :2]
    out = {
        "error": float(np.linalg.norm(mean - xy, axis=1).mean()),
        "cover": float(((low <= xy) & (xy <= high)).mean()),
        "cover z": np.nan,
        "error z": np.nan,
    }
    if (found := fit.depths()) is not None:
        z, _, low, high = found
        inside = (low <= truth[:, 2]) & (truth[:, 2] <= high)
        out |= {"cover z": float(inside.mean()), "error z": float(np.abs(z - truth[:, 2]).mean())}
    return out


def variants(study: Study, sensor_sd: float) -> dict[str, ArrivalTimes]:
    """The same arrival times with more and less known of the depth."""
    toa, water = study.toa, WaterColumn(study.bottom, sensor_sd)
    return {
        "flat": toa.replace(depth=None),
        "sensed": toa.replace(column=water),
        "unknown": toa.replace(depth=None, column=water),
        "known": toa.replace(depth=study.place[:, 2], column=WaterColumn(study.bottom, 0.0)),
    }


def main(argv: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--tracks", type=int, default=1)
    parser.add_argument("--pings", type=int, default=30)
    parser.add_argument("--sd", type=float, default=20.0, help="of the depth, m")
    parser.add_argument("--bottom", type=float, default=80.0, help="m")
    parser.add_argument("--sensed", type=float, default=0.5, help="share of pings with a depth")
    parser.add_argument("--sensor-sd", type=float, default=1.0, help="m")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(argv)
    rows: dict[str, list[dict[str, float]]] = {}
    for track in range(asked.tracks):
        study = simulate(
            np.random.default_rng([asked.seed, track]),
            asked.pings,
            bottom=asked.bottom,
            sd=asked.sd,
            sensed=asked.sensed,
            sensor_sd=asked.sensor_sd,
        )
        truth = study.place[study.toa.n_heard > 0]
        for name, toa in variants(study, asked.sensor_sd).items():
            fit = infer.laplace(toa_track, toa, draws=500)
            rows.setdefault(name, []).append(score(fit, truth))
            told = {k: round(v, 3) for k, v in rows[name][-1].items()}
            cpu = sum(s["cpu"] for s in fit.seconds.values())
            print(track, name, told, f"{cpu:.1f} s", file=sys.stderr)
    print("depth     mean error m  of flat  cover x, y  cover z  mean error z m")
    flat = np.mean([r["error"] for r in rows["flat"]])
    for name, some in rows.items():
        error, cover, inside, off = (np.mean([r[k] for r in some]) for k in some[0])
        print(f"{name:8}{error:14.2f}{error / flat:9.3f}{cover:12.3f}{inside:9.3f}{off:16.2f}")
    print(f"{asked.tracks} tracks of {asked.pings} pings, depth sd {asked.sd:g} m")


if __name__ == "__main__":
    main()
