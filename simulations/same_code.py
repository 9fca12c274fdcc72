"""Two transmitters with one code, and one alone: ``python -m simulations.same_code --runs 10``.

Animals with tags of one code (60 to 180 s between bursts) roam a grid of sixteen receivers for
hours; echoes, late, missed and false detections and collisions are in the data, which go the way
of a study's: `maloc.data.prepare`, `maloc.toa_matrix`, `maloc.emitters.split_same_code`.

Printed: how often two transmitters were found, and pings given to the wrong one; how far the split
tracks are from the truth at their pings (Laplace fit of arrival times, or point positions with
--method points), for whole tracks and from one moment at which the two may be exchanged to the
next; and how often one transmitter alone was split. With --harsh half of the arrivals are missed,
30 % echo, and a receiver has six false detections an hour.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from maloc import infer
from maloc.data import ArrivalTimes, prepare, toa_matrix
from maloc.emitters import CodeDesign, CodeScene, simulate_code, split_same_code
from maloc.emitters.simulate_code import ORIGIN
from maloc.errors import MalocWarning
from maloc.models import toa_track
from maloc.points import locate


def arrivals(scene: CodeScene, design: CodeDesign) -> ArrivalTimes:
    """The code's pings as a study would have them."""
    tag, schedule = scene.detections.tags[0], design.schedule
    kept = prepare(scene.detections, scene.receivers, {tag: (schedule.lo, schedule.hi)}).kept
    return toa_matrix(
        kept, scene.receivers, tag, sound_speed=design.sound_speed, schedule=schedule, origin=ORIGIN
    )


def sent_by(toa: ArrivalTimes, scene: CodeScene) -> np.ndarray:
    """Who sent each ping (P,), -1 = nobody did within the half second before it was first heard."""
    out = np.full(len(toa), -1)
    for who, sent in enumerate(scene.time):
        before = toa.first - sent[np.maximum(np.searchsorted(sent, toa.first) - 1, 0)]
        out[(before > 0) & (before < 0.5)] = who
    return out


def track_errors(toa: ArrivalTimes, scene: CodeScene, method: str) -> np.ndarray:
    """Distance (2, P), m, of the track from where either transmitter was; NaN: no position."""
    if method == "points":
        track = locate(toa).position
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MalocWarning)
            track = infer.laplace(toa_track, toa).positions()[0]
    out = []
    for time_, xy in zip(scene.time, scene.xy, strict=True):
        true = [np.interp(toa.first, time_, xy[:, i]) for i in (0, 1)]
        out.append(np.linalg.norm(track - np.stack(true, axis=1), axis=1))
    return np.stack(out)


def two(scene: CodeScene, design: CodeDesign, method: str) -> dict:
    """Scores of one scene of two transmitters."""
    toa = arrivals(scene, design)
    spent = time.process_time()
    split = split_same_code(toa)
    out = {"found": split.n_transmitters == 2, "cpu": time.process_time() - spent}
    if split.n_transmitters != 2:
        return out
    truth, errors, stretches, wrong = sent_by(toa, scene), [], [], 0
    for k, part in enumerate(split.tables):
        error, senders = track_errors(part, scene, method), truth[split.chain == k]
        who = _whose(senders)
        wrong += int(((senders >= 0) & (senders != who)).sum())
        errors.append(np.nanmean(error[who]))
        # from one moment of doubt to the next the track is one transmitter's, whichever it is
        edges = np.searchsorted(part.first, split.doubt[:, 0])
        for rows in np.split(np.arange(len(part)), edges):
            if len(rows):
                stretches.append(error[_whose(senders[rows])][rows])
    given = (split.chain >= 0) & (truth >= 0)
    lost = (split.chain < 0) & (truth >= 0)
    return out | {
        "error": errors,
        "stretch": np.nanmean(np.concatenate(stretches)),
        "wrong": wrong / given.sum(),
        "lost": lost.sum() / len(toa),
        "doubt": len(split.doubt),
    }


def _whose(senders: np.ndarray) -> int:
    return int(np.bincount(senders[senders >= 0], minlength=2).argmax())


def main(argv: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--harsh", action="store_true")
    parser.add_argument("--method", default="laplace", choices=("laplace", "points"))
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    design = CodeDesign(hours=args.hours)
    if args.harsh:
        hearing = replace(design.hearing, p_na=0.5)
        design = replace(design, hearing=hearing, p_echo=0.3, false_rate=1 / 600)
    alone = replace(design, n_transmitters=1)
    rows, split = [], 0
    for run in tqdm(range(args.runs), unit="run", leave=False):
        scene = simulate_code(np.random.default_rng([args.seed, 2, run]), design)
        rows.append(two(scene, design, args.method))
        scene = simulate_code(np.random.default_rng([args.seed, 1, run]), alone)
        split += split_same_code(arrivals(scene, alone)).n_transmitters > 1
    found = [r for r in rows if r["found"]]
    print(f"{args.runs} runs of {args.hours:g} h{', harsh' if args.harsh else ''}")
    print(f"two transmitters found in {100 * len(found) / len(rows):.0f} %")
    if found:
        error = np.array([e for r in found for e in r["error"]])
        wrong, lost = (100 * np.mean([r[name] for r in found]) for name in ("wrong", "lost"))
        print(
            f"split tracks: mean error {error.mean():.2f} m, worst track {error.max():.2f} m, "
            f"median {np.median(error):.2f} m, {100 * (error <= 3).mean():.0f} % within 3 m"
        )
        stretch, doubt = (np.array([r[name] for r in found]) for name in ("stretch", "doubt"))
        print(
            f"from one moment of doubt to the next: mean error {stretch.mean():.2f} m, "
            f"{100 * (stretch <= 3).mean():.0f} % of runs within 3 m; {doubt.mean():.1f} moments"
        )
        print(f"pings given to the wrong one {wrong:.2f} %, to none {lost:.2f} %")
    print(f"one transmitter split in {100 * split / args.runs:.0f} %")
    print(f"CPU s a split, median {np.median([r['cpu'] for r in rows]):.2f}")


if __name__ == "__main__":
    main()
