"""What the shores tell: ``python -m simulations.shores --tracks 20``.

Tags roam a bend of a canal, mirrored at its banks. Each track is fitted twice by the Laplace
approximation, with the canal's polygon and without it. Printed: mean errors and their ratio, the
coverage of central 95 % intervals, how far the worst posterior mean lies on land, and the share of
posterior draws more than 5 m inland.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
import shapely

from maloc import infer
from maloc.data import ArrivalTimes, Receivers, Schedule
from maloc.models import toa_track
from maloc.simulate import arrays
from maloc.simulate.animals import correlated_walk
from maloc.world.habitat import water

SIGMA, LATE, SPEED = 1.4e-3, 0.06, 1480.0
SCHEDULE = Schedule("random", 20.6, 36.6)


def simulate(rng: np.random.Generator, pings: int, missing: float):
    """One track: arrival times, and positions (P, 2) of the pings."""
    array = arrays.canal()
    assert array.water is not None
    sent = 10.0 + np.cumsum(rng.uniform(SCHEDULE.lo, SCHEDULE.hi, pings))
    path = correlated_walk(rng, sent, array.water, speed=0.25)
    away = np.linalg.norm(path[:, None] - array.xy, axis=2)
    late = (rng.random(away.shape) < LATE) * rng.uniform(50.0, 300.0, away.shape) / SPEED
    arrival = sent[:, None] + away / SPEED + rng.normal(0.0, SIGMA, away.shape) + late
    heard = rng.random(away.shape) < 1 - missing
    receivers = Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1])
    toa = ArrivalTimes(np.where(heard, arrival, np.nan), receivers, SPEED, schedule=SCHEDULE)
    return toa, path


def inland(xy: np.ndarray) -> np.ndarray:
    """Metres from the water (...) of places (..., 2); 0 in it."""
    return shapely.distance(shapely.Polygon(arrays.canal().water), shapely.points(xy))


def score(fit, truth: np.ndarray) -> dict[str, float]:
    """Errors of one fit at the heard pings."""
    mean, _, low, high = fit.positions()
    draws = fit.draws()["position"].reshape(-1, 2)
    return {
        "error": float(np.linalg.norm(mean - truth, axis=1).mean()),
        "cover": float(((low <= truth) & (truth <= high)).mean()),
        "worst": float(inland(mean).max()),
        "share": float((inland(draws) > 5).mean()),
    }


def main(argv: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tracks", type=int, default=2)
    parser.add_argument("--pings", type=int, default=250)
    parser.add_argument("--missing", type=float, default=0.75, help="share of arrivals not heard")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(argv)
    shores = water([[arrays.canal().water]])
    rows: dict[str, list[dict]] = {"without": [], "with": []}
    for track in range(asked.tracks):
        rng = np.random.default_rng([asked.seed, track])
        toa, path = simulate(rng, asked.pings, asked.missing)
        for name, given in (("without", ()), ("with", (shores,))):
            fit = infer.laplace(toa_track, toa, *given, draws=200)
            rows[name].append(score(fit, path[toa.n_heard > 0]))
            print(track, name, {k: round(v, 3) for k, v in rows[name][-1].items()}, file=sys.stderr)
    print("shores   mean error m  cover  worst mean inland m  draws > 5 m inland")
    for name, some in rows.items():
        error, cover, share = (np.mean([r[k] for r in some]) for k in ("error", "cover", "share"))
        worst = max(r["worst"] for r in some)
        print(f"{name:8}{error:13.2f}{cover:7.3f}{worst:21.2f}{share:20.4f}")
    ratio = np.mean([r["error"] for r in rows["with"]]) / np.mean(
        [r["error"] for r in rows["without"]]
    )
    print(f"ratio of mean errors {ratio:.3f}, {asked.tracks} tracks")


if __name__ == "__main__":
    main()
