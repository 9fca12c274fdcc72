"""Score predictions where pings were left out: ``python -m benchmarks.predict --tracks 10``.

Simulated tracks (correlated random walk in a grid of receivers) lose stretches of pings before they
are fitted; the positions at the left-out pings' times, within gaps and after the end, are then
predicted and compared with the truth. An honest posterior grows as the error does and covers 95 %.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time

import numpy as np

import maloc
from maloc.data import ArrivalTimes, Schedule
from maloc.simulate import Hearing, simulate

GAPS = (1, 4, 12)  # pings left out together, each several times a track
TAIL = 6  # pings left out at the end


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=int, default=10)
    parser.add_argument("--pings", type=int, default=200)
    parser.add_argument("--movement", choices=("ctcrw", "rw", "ou"), default="ctcrw")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()

    rows: dict[str, list] = {}
    spent = count = 0.0
    for k in range(given.tracks):
        study = simulate(
            np.random.default_rng([given.seed, k]),
            "grid",
            given.pings,
            schedule=Schedule("random", 20.0, 40.0),
            hearing=Hearing(p_na=0.3, p_mp=0.0),
        )
        toa, emission = study.toa, study.truth.time
        truth = np.column_stack([study.truth.x, study.truth.y])
        keep, where = np.ones(given.pings, bool), {}
        at = 10
        for gap in GAPS * 4:
            if at + gap + 10 > given.pings - TAIL:
                break
            where |= {i: f"gap of {gap}" for i in range(at, at + gap)}
            at += gap + 10
        where |= {given.pings - TAIL + i: f"{i + 1} after the end" for i in range(TAIL)}
        keep[list(where)] = False
        part = ArrivalTimes(
            toa.toa[keep], toa.receivers, toa.sound_speed[keep], tag=toa.tag, schedule=Schedule()
        )
        fit = maloc.infer.laplace(maloc.models.toa_track, part, movement=given.movement)
        fit.predict(emission)  # compiled
        start = time.process_time()
        found = fit.predict(emission)
        spent, count = spent + time.process_time() - start, count + len(emission)
        off = found.position - truth
        distance = np.sqrt(np.einsum("ti,tij,tj->t", off, _inverse(found), off))
        for i in range(given.pings):
            rows.setdefault(where.get(i, "heard"), []).append(
                (np.hypot(*off[i]), np.hypot(*found.sd[i]), distance[i] < np.sqrt(5.991))
            )
    print(f"{'':18}{'n':>6}{'error m':>9}{'sd m':>8}{'cover':>7}")
    order = ["heard", *(f"gap of {g}" for g in GAPS), *(f"{i + 1} after the end" for i in range(6))]
    for name in order:
        if name in rows:
            error, sd, inside = np.array(rows[name]).T
            rms, width = (np.sqrt(np.mean(v**2)) for v in (error, sd))
            print(f"{name:18}{len(error):6d}{rms:9.2f}{width:8.2f}{inside.mean():7.3f}")
    print(f"{1e6 * spent / count:.0f} CPU microseconds a time")


def _inverse(found):
    return np.linalg.inv(found.covariance[:, :2, :2])


if __name__ == "__main__":
    main()
