"""Emitters without identity, followed in four scenes: ``python -m simulations.emitters --runs 10``.

The scenes are those of a published example (`maloc.emitters.SCENES`): one emitter and four known
ones by time differences at three receivers; four unknown ones by arrival times at four receivers
(one false each, chance of detection .95); the same by time differences (two false a pair). Each
scan is associated by itself, and tracked (confirmed by 4 hits in 6 steps, deleted after 5 misses
in a row); then once more with the confirmed tracks' predictions taking part in the association.

Printed: GOSPA (c = 200 m, p = 2; m, mean over steps and runs) of the scans' own positions and of
the confirmed tracks; runs in which every emitter had a track at some step, and at the last; false
tracks a step; CPU ms a step of association and tracking together, mean and 95 % quantile, after
one run to compile.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from maloc.emitters import (
    SCENES,
    Scan,
    Scene,
    Tracker,
    associate,
    fuse,
    gospa,
    simulate,
)

CUT, ORDER = 200.0, 2.0  # of GOSPA, m


class Followed(NamedTuple):
    """One run: GOSPA of scans and of tracks (T,), who had a track (T, K), false tracks, CPU s."""

    scans: np.ndarray
    tracks: np.ndarray
    tracked: np.ndarray
    false: np.ndarray
    cpu: np.ndarray


def follow(
    scans: list[Scan], truth: np.ndarray, scene: Scene, association: str, fed: bool
) -> Followed:
    """Associate and track one simulated scene; ``fed``: predicted tracks take part in both."""
    sensing = scene.sensing
    tracker = Tracker(scene.velocity_sd, association=association)
    out = Followed(
        *(np.zeros((len(scans), *shape)) for shape in ((), (), truth.shape[1:2], (), ()))
    )
    for k, (scan, true) in enumerate(zip(scans, truth, strict=True)):
        now, spent = k * scene.interval, time.process_time()
        if scene.known:
            found = fuse(scan.value, scan.column, scan.emitter, sensing)
        else:
            tracks = tracker.predict(now) if fed else None
            found = associate(scan.value, scan.column, sensing, tracks)
        tracks = tracker.step(now, found.position, found.covariance)
        out.cpu[k] = time.process_time() - spent
        out.scans[k] = gospa(true, found.position, CUT, ORDER).distance
        score = gospa(true, tracks.position, CUT, ORDER)
        out.tracks[k], out.tracked[k], out.false[k] = score.distance, score.pair >= 0, score.false
    return out


def study(name: str, runs: int, steps: int, seed: int, association: str) -> list[str]:
    """Rows of the table of one scene."""
    scene = SCENES[name].replace(n_steps=steps)
    follow(*simulate(np.random.default_rng([seed, runs]), scene), scene, association, True)
    modes = (False,) if scene.known else (False, True)
    done: dict[bool, list[Followed]] = {fed: [] for fed in modes}
    for run in tqdm(range(runs), desc=name, unit="run", leave=False):
        scans, truth = simulate(np.random.default_rng([seed, run]), scene)
        for fed in modes:
            done[fed].append(follow(scans, truth, scene, association, fed))
    rows = []
    alone = float(np.mean([r.scans for r in done[False]]))
    for fed, mine in done.items():
        tracks = float(np.mean([r.tracks for r in mine]))
        ever = np.mean([r.tracked.any(axis=0).all() for r in mine])
        last = np.mean([r.tracked[-1].all() for r in mine])
        cpu = 1e3 * np.concatenate([r.cpu for r in mine])
        false = np.mean([r.false for r in mine])
        rows.append(
            f"{name:7s} {'fed' if fed else 'static':7s} {alone:7.1f} {tracks:7.1f} "
            f"{100 * (1 - tracks / alone):6.0f} % {100 * ever:6.0f} % {100 * last:6.0f} % "
            f"{false:8.3f} {cpu.mean():8.1f} {np.quantile(cpu, 0.95):7.1f}"
        )
    return rows


def main(argv: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--scenes", default=",".join(SCENES), help="separated by commas")
    parser.add_argument("--association", default="gnn", choices=("gnn", "jpda"))
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    print(f"{args.runs} runs of {args.steps} steps, {args.association}")
    print("scene   tracks    scans  tracks   less     ever     last     false   CPU ms    95 %")
    for name in args.scenes.split(","):
        for row in study(name, args.runs, args.steps, args.seed, args.association):
            print(row, flush=True)


if __name__ == "__main__":
    main()
