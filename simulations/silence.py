"""What silence and the schedule are worth: ``python -m simulations.silence --tracks 10``.

Tags roam a canal's array of twelve receivers; a ping at distance d is heard with probability
.9 exp(-d^2 / (2 scale^2)), the scale such that so many receivers hear a ping on average. The same
tracks are fitted by models that are told more and more:

- times: arrival times only;
- heard: and who did not hear the pings that somebody heard;
- given: and the pings that nobody heard, each known to have been sent (a row);
- beat: arrival times, and that the interval is stable (with --stable);
- all: everything (with --stable).

Printed: mean errors of the Laplace fit (or of NUTS's posterior means), as ratios to those of
arrival times, and the coverage of central 95 % intervals, at heard and at unheard pings. With
--stable also how far a fit ends above the one that starts at the truth.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from typing import Any

import numpy as np

from maloc import infer
from maloc._jax import jax
from maloc.data import ArrivalTimes, Schedule, arrival_history
from maloc.infer.marginal import maximise_marginal
from maloc.models import joint
from maloc.simulate.canal import canal_receivers

P0, SIGMA, LATE, SPEED = 0.9, 1.4e-3, 0.06, 1480.0
MEAN, SPREAD, WALK = 28.6, 0.5, 3e-3  # s; a tag's own interval, and its random walk
MARGIN = 20.0


@dataclasses.dataclass(frozen=True)
class Design:
    """What is simulated.

    Parameters
    ----------
    pings : int
    mean : float
        Receivers that hear a ping, on average over the array.
    drift : float
        Standard deviation of the log of the detection range, which varies over an hour.
    stable : bool
        Stable intervals, else Uniform(20.6, 36.6) s.
    """

    pings: int = 250
    mean: float = 3.2
    drift: float = 0.0
    stable: bool = False


def scale_for(mean: float) -> float:
    """Detection scale (m) with which so many receivers hear a ping sent anywhere in the array."""
    xy = canal_receivers().xy
    at = np.random.default_rng(0).uniform(xy.min(0) - MARGIN, xy.max(0) + MARGIN, (4000, 2))
    away = np.linalg.norm(at[:, None] - xy, axis=2)
    low, high = 1.0, 2000.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        heard = (P0 * np.exp(-0.5 * (away / middle) ** 2)).sum(axis=1).mean()
        low, high = (middle, high) if heard < mean else (low, middle)
    return middle


def walk_in_box(rng, time: np.ndarray, low, high, t05: float, speed: float = 0.3) -> np.ndarray:
    """Correlated random walk, second by second, thrown back at the walls of a box; (P, 2) m."""
    keep = 0.05 ** (1 / t05)
    at, velocity = rng.uniform(low, high), rng.normal(0.0, speed, 2)
    path = np.empty((int(time[-1]) + 2, 2))
    for k in range(len(path)):
        path[k] = at
        velocity = keep * velocity + speed * np.sqrt(1 - keep**2) * rng.normal(size=2)
        at = at + velocity
        out = np.where(at < low, 1, np.where(at > high, -1, 0))
        velocity = np.where(out == 0, velocity, out * np.abs(velocity))
        at = np.where(at < low, 2 * low - at, np.where(at > high, 2 * high - at, at))
    every = np.arange(len(path))
    return np.stack([np.interp(time, every, path[:, k]) for k in (0, 1)], axis=1)


def simulate(rng: np.random.Generator, design: Design) -> tuple[ArrivalTimes, np.ndarray, dict]:
    """One track: arrival times with a row for every ping, positions (P, 2), and the truth's sites.

    Rows before the first and after the last heard ping are cut off.
    """
    xy = canal_receivers().xy
    n = design.pings
    walk = np.cumsum(rng.normal(0.0, WALK, n))
    steps = MEAN + rng.normal(0.0, SPREAD) + walk + rng.normal(0.0, 1e-4, n)
    if not design.stable:
        steps = rng.uniform(20.6, 36.6, n)
    sent = 10.0 + np.concatenate([[0.0], np.cumsum(steps[:-1])])
    low, high = xy.min(0) - MARGIN, xy.max(0) + MARGIN
    t05 = -np.log(0.05) / np.log(2) * rng.uniform(30, 60)
    path = walk_in_box(rng, sent, low, high, t05)
    away = np.linalg.norm(path[:, None] - xy, axis=2)
    range_ = np.empty(n)
    range_[0] = rng.normal()
    for k, keep in enumerate(np.exp(-np.diff(sent) / 3600.0)):
        range_[k + 1] = keep * range_[k] + np.sqrt(1 - keep**2) * rng.normal()
    scale = scale_for(design.mean) * np.exp(design.drift * range_)
    heard = rng.random(away.shape) < P0 * np.exp(-0.5 * (away / scale[:, None]) ** 2)
    late = (rng.random(away.shape) < LATE) * rng.uniform(50.0, 300.0, away.shape) / SPEED
    arrival = sent[:, None] + away / SPEED + rng.normal(0.0, SIGMA, away.shape) + late
    rows = np.flatnonzero(heard.any(axis=1))
    keep = slice(rows[0], rows[-1] + 1)
    schedule = Schedule("stable", MEAN, WALK) if design.stable else Schedule("random", 20.6, 36.6)
    toa = ArrivalTimes(
        np.where(heard, arrival, np.nan)[keep], canal_receivers(), SPEED, schedule=schedule
    )
    truth = {"sent": sent[keep], "scale": scale_for(design.mean), "t05": t05, "steps": steps[keep]}
    return toa, path[keep], truth


def heard_rows(toa: ArrivalTimes) -> ArrivalTimes:
    """The pings that somebody heard, nothing being known of others."""
    rows = toa.n_heard > 0
    return toa.replace(
        toa=toa.toa[rows], sound_speed=toa.sound_speed[rows], ping=toa.ping[rows],
        schedule=Schedule(),
    )  # fmt: skip


def methods(design: Design) -> dict[str, dict[str, Any]]:
    """Options of the joint model by what it is told."""
    out = {
        "times": {"detection": None, "schedule": False},
        "heard": {"schedule": False},
        "given": {"schedule": False},
    }
    if design.stable:
        out |= {"beat": {"detection": None}, "all": {}}
    return out


def fit(name: str, toa: ArrivalTimes, options: dict, sampler: str, seed: int, size=(2, 500)):
    """Positions (P, 2), limits of their central 95 % (2, P, 2), and the fit, at its own rows."""
    history = arrival_history(heard_rows(toa)) if name == "heard" else (
        arrival_history(toa, known=True)
    )  # fmt: skip
    if sampler == "laplace":
        got = infer.laplace(joint, history, **options)
    else:
        how = {"method": sampler, "chains": size[0], "draws": size[1], "progress": False}
        got = infer.nuts(jax.random.key(seed), joint, history, **how, **options)
    mean, _, low, high = got.positions()
    return mean, np.stack([low, high]), got


def truth_gap(got, path: np.ndarray, truth: dict) -> float:
    """How far (nll) a fit ends above the one that starts from the true path and times."""
    cm, args = got.cm, got.args
    x, n = got.marginal.x.copy(), len(path)
    first = np.asarray(args[0].time)[:n]
    for site in cm.chain:
        if site.name == "track":
            velocity = np.gradient(path, truth["sent"], axis=0)
            x[:n, site.columns] = np.concatenate([path, velocity], axis=1)
        elif site.name == "emission":
            x[:n, site.columns] = ((truth["sent"] - first) * SPEED)[:, None]
        elif site.name == "interval":
            nominal = np.append(np.asarray(args[0].nominal)[: n - 1], MEAN)
            x[:n, site.columns] = 1e3 * (truth["steps"] - nominal)[:, None]

    best = maximise_marginal(cm, args, x, got.marginal.u)
    return float(got.marginal.value - best.value)


def study(
    design: Design,
    tracks: int,
    seed: int,
    sampler: str,
    told: str = "",
    size: tuple[int, int] = (2, 500),
    log=sys.stderr,
) -> list[dict]:
    """One row a track and method; ``told``: names of the methods, separated by commas, or all.

    ``size``: chains, and draws of each, of a sampler.
    """
    rows = []
    for track in range(tracks):
        toa, path, truth = simulate(np.random.default_rng([seed, track]), design)
        heard = toa.n_heard > 0
        for name, options in methods(design).items():
            if told and name not in told.split(","):
                continue
            spent = time.process_time()
            xy, limits, got = fit(name, toa, options, sampler, track, size)
            spent = time.process_time() - spent
            where = heard if name == "heard" else np.ones(len(toa), bool)
            error = np.full(len(toa), np.nan)
            inside = np.full((len(toa), 2), np.nan)
            error[where] = np.linalg.norm(xy - path[where], axis=1)
            inside[where] = (path[where] > limits[0]) & (path[where] < limits[1])
            row = {
                "track": track, "method": name, "heard": error[heard].mean(),
                "all": error.mean() if name != "heard" else np.nan,
                "cover_heard": inside[heard].mean(),
                "cover_unheard": inside[~heard].mean() if (~heard).any() else np.nan,
                "few": (toa.n_heard <= 2).mean(), "cpu": spent, "warnings": len(got.warnings),
                "unheard": int((~heard).sum()),
            }  # fmt: skip
            if design.stable and name in ("beat", "all") and sampler == "laplace":
                row["above_truth"] = truth_gap(got, path, truth)
            rows.append(row)
            print({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}, file=log)
    return rows


def table(rows: list[dict]) -> str:
    """Means over tracks, errors as ratios to those of arrival times."""
    names = list(dict.fromkeys(r["method"] for r in rows))

    def mean(name, key):
        values = np.array([r.get(key, np.nan) for r in rows if r["method"] == name], float)
        return np.nan if np.isnan(values).all() else np.nanmean(values)

    lines = ["method  heard  all    /times heard  all    cover heard  unheard  CPU s  above truth"]
    for name in names:
        ratio = [mean(name, k) / mean("times", k) for k in ("heard", "all")]
        above = [r["above_truth"] for r in rows if r["method"] == name and "above_truth" in r]
        far = f"{sum(a > 3 for a in above)}/{len(above)} > 3" if above else ""
        unheard = [r["unheard"] * (r["cover_unheard"] if r["unheard"] else 0)
                   for r in rows if r["method"] == name]  # fmt: skip
        count = sum(r["unheard"] for r in rows if r["method"] == name)
        cover = np.nansum(unheard) / count if count and name != "heard" else np.nan
        lines.append(
            f"{name:7s} {mean(name, 'heard'):6.2f} {mean(name, 'all'):6.2f} "
            f"{ratio[0]:11.3f} {ratio[1]:6.3f} {mean(name, 'cover_heard'):11.3f} {cover:8.3f} "
            f"{mean(name, 'cpu'):7.2f}  {far}"
        )
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tracks", type=int, default=2)
    parser.add_argument("--pings", type=int, default=250)
    parser.add_argument("--mean", type=float, default=1.5, help="receivers that hear a ping")
    parser.add_argument("--drift", type=float, default=0.0, help="sd of the log detection range")
    parser.add_argument("--stable", action="store_true", help="stable burst intervals")
    parser.add_argument("--told", default="", help="only these: times,heard,given,beat,all")
    parser.add_argument("--method", default="laplace", choices=("laplace", "nuts", "hmc"))
    parser.add_argument("--chains", type=int, default=2)
    parser.add_argument("--draws", type=int, default=500, help="of each chain")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    design = Design(args.pings, args.mean, args.drift, args.stable)
    size = (args.chains, args.draws)
    rows = study(design, args.tracks, args.seed, args.method, args.told, size)
    heard = np.mean([r["few"] for r in rows])
    print(f"{design}, {args.tracks} tracks, {args.method}; heard by <= 2 receivers: {heard:.2f}")
    print(table(rows))


if __name__ == "__main__":
    main()
