"""How often checks find a wrong input: ``python -m simulations.wrong_inputs --runs 100``.

Tracks of 250 pings (correlated random walk) among twelve receivers along a canal, burst interval
U(20.6, 36.6) s, half-normal detection scaled so that about so many receivers hear a ping, arrivals
with a Gaussian error of 1.4 ms, 6 % of them late by 50 to 300 m. One input is then declared wrong,
the track fitted with it (`toa_track`, Laplace) and `maloc.infer.check_inputs` asked. Each run is
one line of a JSON file; runs that are there are not done again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from maloc.data import ArrivalTimes, Receivers, Schedule
from maloc.runs.threads import one_thread
from maloc.simulate.animals import correlated_walk
from maloc.simulate.arrays import canal
from maloc.simulate.hearing import Hearing, hear
from maloc.simulate.pings import burst_times

SPEED, MARGIN, P_NEAR = 1480.0, 20.0, 0.9
RANDOM, STABLE = Schedule("random", 20.6, 36.6), Schedule("stable", 28.6, 0.005)
NARROW = Schedule("random", 21.4, 35.8)  # 10 % of the width is missing
SHIFT, SPEED_OFF = 15.0, 0.02


class Case(NamedTuple):
    """What is wrong, receivers that hear a ping, tracks that are pooled, the true schedule.

    `simulations` are those that the check makes of each track; the schedule needs none of them.
    """

    wrong: str
    per_ping: float = 5.0
    tracks: int = 1
    schedule: Schedule = RANDOM
    simulations: int = 49


CASES = {
    "clean": Case(""),
    "limits 10 % too narrow": Case("burst limits", simulations=10),
    "random declared stable": Case("stable interval", simulations=10),
    "receiver displaced 15 m": Case("receiver positions"),
    "sound speed 2 % off": Case("sound speed"),
    "clean, stable interval": Case("", schedule=STABLE),
    "sound speed 2 % off, 5 tracks of 2.5": Case("sound speed", 2.5, 5, simulations=20),
    "clean, 5 tracks of 2.5": Case("", 2.5, 5, simulations=20),
    "receiver displaced 15 m, 2.5": Case("receiver positions", 2.5),
}


def water() -> np.ndarray:
    """Corners of what the animal roams: the array's bounding box and a margin."""
    xy = canal().xy
    (x0, y0), (x1, y1) = xy.min(0) - MARGIN, xy.max(0) + MARGIN
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def detection_scale(per_ping: float) -> float:
    """Half-normal scale (m) at which so many receivers, on average, hear a ping in the box."""
    box, xy = water(), canal().xy
    at = np.random.default_rng(0).uniform(box.min(0), box.max(0), (4000, 2))
    d2 = ((at[:, None] - xy) ** 2).sum(-1)

    def excess(log_scale: float) -> float:
        p = P_NEAR * np.exp(-0.5 * d2 / np.exp(2 * log_scale))
        return p.sum(1).mean() - per_ping

    return float(np.exp(brentq(excess, 0.0, 8.0)))


def track(
    rng: np.random.Generator, per_ping: float, pings: int = 250, schedule: Schedule = RANDOM
) -> ArrivalTimes:
    """Arrival times of one track, with everything declared as it is."""
    array = canal()
    emission = burst_times(rng, pings, schedule)
    xy = correlated_walk(rng, emission, water(), 0.15)
    hearing = Hearing(
        1 - P_NEAR, detection_scale(per_ping), 0.06, noise="gaussian", sd=1.4e-3, resolution=0.0
    )
    c = np.full(pings, SPEED)
    toa = hear(rng, emission, xy, array.xy, c, hearing).observed(0.0)
    toa = toa[np.isfinite(toa).any(axis=1)]
    order = np.argsort(np.nanmin(toa, axis=1), kind="stable")
    receivers = Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1])
    return ArrivalTimes(toa[order], receivers, np.asarray(SPEED), schedule=schedule)


def declared(rng: np.random.Generator, toas: list[ArrivalTimes], wrong: str):
    """The tracks with one input declared wrong; the displaced receiver and how far it is off."""
    if wrong == "burst limits":
        return [toa.replace(schedule=NARROW) for toa in toas], "", (0.0, 0.0)
    if wrong == "stable interval":
        return [toa.replace(schedule=STABLE) for toa in toas], "", (0.0, 0.0)
    if wrong == "sound speed":
        off = 1 + SPEED_OFF * rng.choice((-1, 1))
        return [toa.replace(sound_speed=off * toa.sound_speed) for toa in toas], "", (0.0, 0.0)
    if wrong == "receiver positions":
        r = toas[0].receivers
        j, angle = rng.integers(len(r)), rng.uniform(0, 2 * np.pi)
        off = SHIFT * np.array([np.cos(angle), np.sin(angle)])
        xy = r.xy + off * (np.arange(len(r)) == j)[:, None]
        moved = Receivers(r.receiver, xy[:, 0], xy[:, 1])
        return [toa.replace(receivers=moved) for toa in toas], r.labels[j], tuple(-off)
    return toas, "", (0.0, 0.0)


def run(name: str, index: int, seed: int = 0, pings: int = 250) -> dict:
    """Simulate, declare, fit and check once."""
    import maloc
    from maloc.errors import MalocWarning

    case = CASES[name]
    rng = np.random.default_rng([seed, list(CASES).index(name), index])
    toas = [track(rng, case.per_ping, pings, case.schedule) for _ in range(case.tracks)]
    toas, receiver, shift = declared(rng, toas, case.wrong)
    began = time.process_time()
    fits = [maloc.infer.laplace(maloc.models.toa_track, toa) for toa in toas]
    fitted = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MalocWarning)
        found = maloc.infer.check_inputs(
            fits[0], toas[0], pool=fits[1:], simulations=case.simulations, seed=index
        )
    rows = {row.name: row for row in found.rows}
    named = rows["receiver positions"]
    return {
        "case": name,
        "index": index,
        "suspects": [row.name for row in found.rows if row.suspect],
        "receiver": named.receiver == receiver,
        "shift_error": float(np.hypot(*np.subtract(named.estimate, shift))),
        "p": {row.name: row.p for row in found.rows},
        "cpu": [fitted - began, time.process_time() - fitted],
        "fit_warnings": sum(bool(fit.warnings) for fit in fits),
    }


def summary(results: Iterable[dict[str, Any]]) -> str:
    """One line a case: runs, the wrong input named, anything else named, CPU seconds."""
    lines = [f"{'case':38}{'runs':>5}{'found':>7}{'named':>7}{'else':>6}{'off m':>7}{'CPU s':>7}"]
    results = list(results)
    for name, case in CASES.items():
        rows = [r for r in results if r["case"] == name]
        if not rows:
            continue
        found = sum(case.wrong in r["suspects"] for r in rows)
        other = sum(any(s != case.wrong for s in r["suspects"]) for r in rows)
        named = off = "-"
        if case.wrong == "receiver positions":
            right = [r for r in rows if case.wrong in r["suspects"] and r["receiver"]]
            named = str(len(right))
            off = f"{np.median([r['shift_error'] for r in right]):.1f}" if right else "-"
        cpu = float(np.median([r["cpu"][1] for r in rows]))
        said = found if case.wrong else "-"
        lines.append(f"{name:38}{len(rows):5}{said:>7}{named:>7}{other:6}{off:>7}{cpu:7.1f}")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Do what is not done yet and print the summary."""
    parser = argparse.ArgumentParser(prog="python -m simulations.wrong_inputs", description=__doc__)
    parser.add_argument("--runs", type=int, default=2, help="runs of each case")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pings", type=int, default=250)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--out", type=Path, help="file of earlier results to go on with")
    asked = parser.parse_args(argv)
    done = []
    if asked.out and asked.out.exists():
        done = [json.loads(line) for line in asked.out.read_text().splitlines()]
    have = {(r["case"], r["index"]) for r in done}
    jobs = [(c, i) for i in range(asked.runs) for c in asked.cases if (c, i) not in have]
    results = [r for r in done if r["case"] in asked.cases and r["index"] < asked.runs]
    for result in _done(jobs, asked):
        results.append(result)
        if asked.out:
            with asked.out.open("a") as file:
                file.write(json.dumps(result) + "\n")
        print(f"\r{len(results)} runs", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(summary(results))
    return 0


def _done(jobs: list[tuple[str, int]], asked: argparse.Namespace) -> Iterable[dict]:
    if asked.workers == 1:
        yield from (run(name, i, asked.seed, asked.pings) for name, i in jobs)
        return
    spawn = get_context("spawn")
    with one_thread(), ProcessPoolExecutor(asked.workers, mp_context=spawn) as pool:
        waiting = [pool.submit(run, name, i, asked.seed, asked.pings) for name, i in jobs]
        for one in waiting:
            yield one.result()


if __name__ == "__main__":
    sys.exit(main())
