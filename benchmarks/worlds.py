"""Tracks in worlds that are not the model's.

    python -m benchmarks.worlds DATA --worlds walls,rays/s03

DATA is a folder with the data sets (walls, rays, scirep, ssu1, sim_canal, sim_lake); worlds that
are drawn here (simulations/) need none. A row a world: mean over its tracks of the mean, median and
95 % error (m), shares of truth inside the 95 % limits by axis and inside the 95 % ellipse, root
mean square error over the stated standard deviation, error of the distance from the array's middle
over its own, how many runs warn, CPU seconds of a fit (median; a first fit pays for compiling),
another program's mean error, whether what is asked is met, and what that is.

Every track's scores are kept as a line of ``--results``, by the build (a digest of the package's
source), so that a run that was stopped goes on where it was, and another build is printed beside:
``--beside BUILD``. ``--again`` fits anew.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import maloc
from benchmarks._worlds import Case, World, worlds
from maloc.errors import FitError, InputError
from maloc.runs.fit_tag import Fitted, fit_tag
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

_COLUMNS = {
    "mean": ("mean", ">8.2f"),
    "median": ("median", ">8.2f"),
    "p95": ("95 %", ">8.2f"),
    "cover_x": ("cover x", ">8.3f"),
    "cover_y": ("cover y", ">8.3f"),
    "ellipse": ("ellipse", ">8.3f"),
    "rms/sd": ("rms/sd", ">7.2f"),
    "bias": ("bias", ">6.2f"),
    "cpu": ("CPU s", ">7.1f"),
}


def build_of(package: Path = Path(maloc.__file__).parent) -> str:
    """The version, and a digest of the package's source."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.read_bytes())
    return f"{maloc.__version__}-{digest.hexdigest()[:8]}"


def score(fitted: Fitted, case: Case) -> dict[str, float]:
    """Scores of the heard pings of one track that have truth."""
    table = fitted.table.filter("heard")
    place, sd = (table.select(c).to_numpy() for c in (("x", "y"), ("sd_x", "sd_y")))
    low, high = (table.select(f"x_{e}", f"y_{e}").to_numpy() for e in ("lo", "hi"))
    if case.gps:
        t, clock = table["t"].to_numpy(), case.truth[:, 2]
        true = np.column_stack([np.interp(t, clock, case.truth[:, a]) for a in (0, 1)])
        known = (t > clock[0]) & (t < clock[-1])
    else:
        row = {int(p): i for i, p in enumerate(case.toa.ping)}
        true = case.truth[[row[p] for p in table["ping"]]]
        known = np.ones(len(true), bool)
    off = (place - true)[known]
    error = np.hypot(*off.T)
    inside = ((low <= true) & (true <= high))[known].mean(axis=0)
    covariance = np.einsum("ti,tj->tij", sd, sd)[known]
    covariance[:, 0, 1] = covariance[:, 1, 0] = table["cov_xy"].to_numpy()[known]
    far = np.einsum("ti,ti->t", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    from_middle = (true - case.toa.receivers.xy.mean(axis=0))[known]
    away = np.linalg.norm(from_middle, axis=1)
    out = from_middle / away[:, None]
    return {
        "pings": len(error),
        "mean": float(error.mean()),
        "median": float(np.median(error)),
        "p95": float(np.quantile(error, 0.95)),
        "cover_x": float(inside[0]),
        "cover_y": float(inside[1]),
        "ellipse": float((far < 5.991).mean()),
        "square": float((error**2).mean()),
        "variance": float((sd[known] ** 2).sum(axis=1).mean()),
        "radial": float((np.linalg.norm(from_middle + off, axis=1) - away).mean()),
        "radial_sd": float(np.sqrt(np.einsum("ti,tij,tj->t", out, covariance, out)).mean()),
    }


def fit_case(case: Case, options: TrackOptions) -> dict[str, Any]:
    """Fit one track as `maloc track` does, and score it."""
    log = Log(quiet=True)  # never released: what it warns of is kept
    try:
        with log.listening():
            fitted = fit_tag(case.toa, options, case.toa.receivers, log)
    except FitError as problem:
        return {"failed": str(problem), "warned": log.warnings}
    cpu = sum(s["cpu"] for s in fitted.fit.seconds.values())
    return {**score(fitted, case), "cpu": cpu, "warned": log.warnings}


def run_world(
    world: World, data: Path, options: dict, kept: dict, put: Callable[[int, dict], None]
) -> list[dict]:
    """Scores of a world's tracks: those that are kept, and the others, handed to `put` as done."""
    asked = TrackOptions(toa=Path(world.name), **dict(world.options) | options)
    rows = []
    for i, make in enumerate(world.cases(data)):
        if (found := kept.get((world.name, i))) is None:
            found = fit_case(make(), asked)
            put(i, found)
        rows.append(found)
    return rows


def summed_up(rows: list[dict]) -> dict[str, float]:
    """A world's scores from those of its tracks."""
    fitted = [r for r in rows if "failed" not in r]
    if not fitted:
        return {"tracks": len(rows), "failed": len(rows), "warned": 0, "pings": 0}
    mean = {k: float(np.mean([r[k] for r in fitted])) for k in fitted[0] if k != "warned"}
    return mean | {
        "tracks": len(rows),
        "failed": len(rows) - len(fitted),
        "pings": sum(r["pings"] for r in fitted),
        "cover": (mean["cover_x"] + mean["cover_y"]) / 2,
        "rms/sd": (mean["square"] / mean["variance"]) ** 0.5,
        "bias": abs(mean["radial"]) / mean["radial_sd"],
        "cpu": float(np.median([r["cpu"] for r in fitted])),
        "warned": sum(bool(r["warned"]) for r in fitted),
    }


def missed(world: World, s: dict[str, float], before: float | None = None) -> list[str]:
    """What is asked of a world and not met; ``before``: the least mean error of earlier builds."""
    fine = {"mean": 2, "p95": 2}  # decimals, as what is asked has them
    out = []
    for name, (low, high) in world.asked.items():
        if not low <= round(s.get(name, np.nan), fine.get(name, 3)) <= high:
            out.append(name)
    if (
        world.worse is not None
        and before is not None
        and not s.get("mean", np.inf) <= world.worse * before
    ):
        out.append(f"mean over {world.worse:g} x {before:.3f}")
    return out + [f"{s['failed']} failed"] * bool(s["failed"])


def header() -> str:
    """The table's head."""
    head = f"{'world':24}{'tracks':>7}{'pings':>7}"
    head += "".join(f"{name:>{form[1]}}" for name, form in _COLUMNS.values())
    return f"{head}{'warned':>7}{'peer':>7}  met; asked"


def line(
    world: World, s: dict[str, float], peer: float, before: float | None = None, label: str = ""
) -> str:
    """A world's row, with the mean error of another program (m; NaN: none is known)."""
    out = f"{label or world.name:24}{s['tracks']:>7}{s['pings']:>7}"
    out += "".join(f"{s.get(k, np.nan):{form}}" for k, (_, form) in _COLUMNS.items())
    out += f"{s['warned']:>7}"
    if label:
        return out
    out += f"{'-' if np.isnan(peer) else f'{peer:.2f}':>7}"
    wanted = [
        f"{k} {lo:g}-{hi:g}" if lo else f"{k} <= {hi:g}" for k, (lo, hi) in world.asked.items()
    ]
    lost = missed(world, s, before)
    return f"{out}  {'no (' + ', '.join(lost) + ')' if lost else 'yes'}; {', '.join(wanted)}"


def read_results(path: Path) -> dict[str, dict[tuple[str, int], dict]]:
    """Kept scores by build, then by world and track; a line that was cut off is left out."""
    out: dict[str, dict[tuple[str, int], dict]] = {}
    for text in path.read_text("utf-8").splitlines() if path.exists() else ():
        try:
            found = json.loads(text)
        except json.JSONDecodeError:
            continue
        out.setdefault(found.pop("build"), {})[found.pop("world"), found.pop("track")] = found
    return out


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of the data sets")
    parser.add_argument("--worlds", default="", help="only those that begin so: walls,rays/s03")
    parser.add_argument("--tracks", type=int, default=16, help="tracks of a drawn world")
    parser.add_argument("--error", help="law of arrival errors; default: the build's")
    parser.add_argument("--results", type=Path, default=Path(".cache/worlds.jsonl"))
    parser.add_argument("--build", help="name to keep the results by")
    parser.add_argument("--beside", default="", help="builds to print beside: A,B")
    parser.add_argument("--again", action="store_true", help="fit what is kept anew, too")
    parser.add_argument("--list", action="store_true", help="list worlds and builds, fit nothing")
    given = parser.parse_args(argv)
    wanted = tuple(w.strip() for w in given.worlds.split(",") if w.strip()) or ("",)
    chosen = [w for w in worlds(given.tracks) if w.name.startswith(wanted)]
    if not chosen:
        parser.error(f"no world begins with {' or '.join(wanted)} (see --list)")
    results = read_results(given.results)
    beside = [b.strip() for b in given.beside.split(",") if b.strip()]
    if unknown := [b for b in beside if b not in results]:
        parser.error(f"{given.results} has no build {unknown[0]}: it has {', '.join(results)}")
    if given.list:
        print("\n".join(w.name for w in chosen))
        print("".join(f"build {b}: {len(found)} tracks\n" for b, found in results.items()))
        return
    options = {} if given.error is None else {"error": given.error}
    build = given.build or build_of() + "".join(f" {v}" for v in options.values())
    kept = {} if given.again else results.get(build, {})
    given.results.parent.mkdir(parents=True, exist_ok=True)
    print(f"build {build}\n{header()}", flush=True)
    met = 0
    with given.results.open("a", encoding="utf-8") as file:
        for world in chosen:

            def put(i: int, found: dict, name: str = world.name) -> None:
                file.write(json.dumps({"build": build, "world": name, "track": i} | found) + "\n")
                file.flush()

            try:
                peer = np.nan if world.peer is None else world.peer(given.data)
                s = summed_up(run_world(world, given.data, options, kept, put))
            except (FileNotFoundError, InputError) as problem:
                print(f"{world.name:24}not run: {problem}", flush=True)
                continue
            others = {b: _of(results[b], world.name, s["tracks"]) for b in beside}
            means = [o["mean"] for o in others.values() if o and "mean" in o]
            print(line(world, s, peer, min(means, default=None)), flush=True)
            for name, o in others.items():
                if o:
                    print(line(world, o, peer, label=f"  {name}"), flush=True)
            met += not missed(world, s, min(means, default=None))
    print(f"\n{met} of {len(chosen)} worlds met")


def _of(kept: dict[tuple[str, int], dict], world: str, tracks: float) -> dict[str, float]:
    """Another build's scores in a world, of the same tracks."""
    rows = [found for (name, i), found in kept.items() if name == world and i < tracks]
    return summed_up(rows) if rows else {}


if __name__ == "__main__":
    main()
