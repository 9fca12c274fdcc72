"""Study of clock synchronisation on simulated arrays: ``python -m simulations.sync --arrays 50``.

Arrays of 8 to 20 receivers over 1 to 30 days, clocks hours wrong that drift by up to a minute a day
and jump, reflections, places wrong by a metre, a sound speed that varies (`maloc.simulate`). Every
offset is compared with the truth at every sync detection, those beside jumps and at the ends
included.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import NamedTuple

import numpy as np

from maloc import sync
from maloc.errors import FitError
from maloc.simulate.sync_array import ORIGIN, SyncArray, sync_array
from maloc.sync import ClockSync

FOUND = 0.02  # jumps at least so large must be found, s
DAYS = (1.0, 1.0, 1.0, 2.0, 3.0, 1.0, 2.0, 5.0, 1.0, 30.0)  # of ten arrays


class Score(NamedTuple):
    """How one array was synchronised.

    ``error`` (N,) and ``sd`` (N,), s, of all clocks but the reference's at their detections;
    ``near`` (N,) within an hour of a jump or an end; ``jumps``, ``dated``, ``false``: number of
    true jumps of 20 ms and more, of those found between their neighbours, and of others found.
    """

    error: np.ndarray
    sd: np.ndarray
    near: np.ndarray
    jumps: int
    found: int
    dated: int
    false: int
    seconds: float


def score(array: SyncArray, fitted: ClockSync, seconds: float = 0.0) -> Score:
    """Compare a synchronisation with the truth."""
    names = list(fitted.receivers.names)
    reference = names.index(fitted.reference)
    r = fitted.residuals
    true = array.relative(reference)[r.row]
    clock, at = array.clock[r.row], array.true[r.row]
    rows = np.isfinite(r.offset) & (clock != reference)
    sd = fitted.offset_sd(r.receiver, r.time)
    ends = np.minimum(at - at.min(), at.max() - at) < 3600
    for j, t in zip(array.jump_clock, array.jump_time, strict=True):
        ends |= (clock == j) & (np.abs(at - t) < 3600)

    found = dated = n_large = 0
    claimed = np.zeros(len(fitted.jumps), bool)
    own = np.flatnonzero(array.clock == reference)
    ahead = np.interp(array.jump_time, array.true[own], array.steady[own])
    moments = array.jump_time + ahead - (fitted.origin - ORIGIN) / 1e9
    for j, t, size, moment in zip(
        array.jump_clock, array.jump_time, array.jump_size, moments, strict=True
    ):
        heard = at[clock == j]
        if not ((heard < t).any() and (heard > t).any()):
            continue  # nothing was heard on one side of it
        large = abs(size) >= FOUND
        n_large += large
        k = np.flatnonzero(
            (fitted.jumps.receiver == names[j])
            & ~claimed
            & (np.abs(fitted.jumps.time - moment) < 3 * 3600)
            & (np.abs(fitted.jumps.size - size) < 5e-3)
        )[:1]
        claimed[k] = True
        between = (fitted.jumps.low[k] <= moment + 1e-3) & (moment - 1e-3 <= fitted.jumps.high[k])
        found += large and len(k)
        dated += large and int(between.sum())
    return Score(
        (r.offset - true)[rows],
        sd[rows],
        ends[rows],
        n_large,
        found,
        dated,
        int((~claimed).sum()),
        seconds,
    )


def pooled(scores: list[Score]) -> Score:
    """Put the scores of several arrays together."""
    return Score(
        np.concatenate([s.error for s in scores]),
        np.concatenate([s.sd for s in scores]),
        np.concatenate([s.near for s in scores]),
        sum(s.jumps for s in scores),
        sum(s.found for s in scores),
        sum(s.dated for s in scores),
        sum(s.false for s in scores),
        sum(s.seconds for s in scores),
    )


def one(seed: int, days: float | None = None) -> tuple[SyncArray, Score | None, str]:
    """Simulate, synchronise and score an array; the text says how it went wrong, if it did."""
    rng = np.random.default_rng([4, seed])
    span = DAYS[seed % len(DAYS)] if days is None else days
    array = sync_array(rng, int(rng.integers(8, 21)), span)
    begin = time.process_time()
    try:
        fitted = sync.fit(array.detections, array.receivers)
    except (FitError, ValueError) as error:  # a failure is a result
        return array, None, str(error)
    spent = time.process_time() - begin
    if not fitted.synced.all():
        return array, None, f"{int((~fitted.synced).sum())} receivers not synchronised"
    return array, score(array, fitted, spent), ""


def main(argv: list[str] | None = None) -> int:
    """Run the study; returns the number of failures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arrays", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="seed of the first array")
    parser.add_argument("--days", type=float, help="length of each record; default 1 to 30")
    given = parser.parse_args(argv)
    head = (
        f"{'seed':>5}{'rec':>4}{'days':>5}{'arrivals':>9}{'rms ms':>8}{'near ms':>8}{'max ms':>8}"
    )
    print(head + f"{'cover':>7}{'jumps':>6}{'found':>6}{'dated':>6}{'false':>6}{'CPU s':>7}")
    scores, failed = [], 0
    for seed in range(given.first, given.first + given.arrays):
        array, s, why = one(seed, given.days)
        n = len(array.receivers)
        days = float(np.ptp(array.true)) / 86_400
        line = f"{seed:>5}{n:>4}{days:>5.0f}{len(array.detections):>9}"
        if s is None:
            failed += 1
            print(f"{line} failed: {why}", flush=True)
            continue
        scores.append(s)
        print(line + _line(s), flush=True)
    if scores:
        whole = pooled(scores)
        print(f"{'all':>5}{'':>4}{'':>5}{len(whole.error):>9}" + _line(whole))
    print(f"{failed} failures")
    return failed


def _line(s: Score) -> str:
    rms, near = (1e3 * np.sqrt(np.mean(e**2)) for e in (s.error, s.error[s.near]))
    told = np.isfinite(s.sd)  # not where a jump leaves a recorded time open
    cover = np.mean(np.abs(s.error[told]) < 1.96 * s.sd[told])
    return (
        f"{rms:>8.3f}{near:>8.3f}{1e3 * np.abs(s.error).max():>8.2f}{cover:>7.3f}"
        f"{s.jumps:>6}{s.found:>6}{s.dated:>6}{s.false:>6}{s.seconds:>7.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())
