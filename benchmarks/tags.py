"""Many tags: ``python -m benchmarks.tags --tags 100 --pings 500 --nuts 3 --workers 2 --kill 40``.

Simulated canal tracks whose fish differ. CPU seconds of Laplace fits and of hierarchical SVI (on
from the Laplace fits), compilation paid before; SVI against NUTS on the first tags (errors of
means in NUTS's sds, ratios of sds); wall seconds in one process and in several; and ``maloc
track`` killed (kill -9) half way, started again, and compared with a run that was left alone.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import filecmp
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

import maloc
from maloc._jax import jax
from maloc.runs.tags import Job, run_each
from maloc.simulate import canal_toa

LAW = ("sigma_vel", "t05")


def simulated(tags: int, pings: int, seed: int) -> list[maloc.ArrivalTimes]:
    """Arrival times of several tags."""
    drawn = (canal_toa(np.random.default_rng([seed, i]), n_pings=pings)[0] for i in range(tags))
    return [toa.replace(tag=f"T{i:03d}") for i, toa in enumerate(drawn)]


def laplace_only(toa: maloc.ArrivalTimes) -> dict[str, bytes]:
    """A tag's fit alone, for the comparison of processes."""
    fit = maloc.infer.laplace(maloc.models.toa_track, toa)
    return {"mean.npy": fit.marginal.x.tobytes()}


def parallel(toas: list[maloc.ArrivalTimes], workers: int) -> tuple[float, float]:
    """Wall seconds of all fits in so many processes, and of the later half of them."""
    with tempfile.TemporaryDirectory() as place:
        jobs = [Job(t.tag, f"{t.tag:0>24}", laplace_only, (t,)) for t in toas]
        begun = time.time()
        run_each(jobs, Path(place), workers=workers, quiet=True)
        done = sorted(file.stat().st_mtime for file in Path(place).glob("*/mean.npy"))
        return time.time() - begun, done[-1] - done[len(done) // 2 - 1]


def against_nuts(found, tags: list[str], draws: int, seed: int) -> list[str]:
    """SVI's positions and parameters beside NUTS's, under the law as SVI took it."""
    out, errors, ratios = [], [], []
    for i, tag in enumerate(tags):
        fit = found.fits[tag]
        start = maloc.infer.laplace(fit.cm.model, *fit.args, **fit.options)
        key = jax.random.key(seed + i)
        wanted = maloc.infer.nuts(key, start, draws=draws, progress=False)
        for mine, theirs in zip(fit.flat_draws(4000), (wanted.x, wanted.u), strict=True):
            mine, theirs = (p.reshape(-1, *p.shape[2:])[:, : fit.n_states] for p in (mine, theirs))
            sd = theirs.std(axis=0)
            errors.append(np.abs(mine.mean(axis=0) - theirs.mean(axis=0)).ravel() / sd.ravel())
            ratios.append((mine.std(axis=0) / sd).ravel())
    for what, part in (("states", slice(0, None, 2)), ("parameters", slice(1, None, 2))):
        error, ratio = np.concatenate(errors[part]), np.concatenate(ratios[part])
        out.append(
            f"  {what:11} error of mean: median {np.median(error):.3f}, 95 % "
            f"{np.quantile(error, 0.95):.3f}, worst {error.max():.3f} sd; ratio of sd "
            f"{np.quantile(ratio, 0.025):.2f} to {np.quantile(ratio, 0.975):.2f}"
        )
    return out


def write(folder: Path, toas: list[maloc.ArrivalTimes]) -> list[str]:
    """Tables of the tags and the array; the arguments of `maloc track` that read them."""
    receivers = toas[0].receivers
    xy = {"receiver": receivers.labels, "x": receivers.xy[:, 0], "y": receivers.xy[:, 1]}
    pl.DataFrame(xy).write_csv(folder / "receivers.csv")
    tables = []
    for toa in toas:
        columns = {str(r): toa.toa[:, j] for j, r in enumerate(receivers.labels)}
        columns |= {"tag": [toa.tag] * toa.n_pings, "sound_speed": toa.sound_speed}
        tables.append(pl.DataFrame(columns).fill_nan(None))
    pl.concat(tables).write_csv(folder / "toa.csv")
    command = [sys.executable, "-c", "from maloc.cli import main; main()", "track", "--toa"]
    command += [str(folder / "toa.csv"), "--receivers", str(folder / "receivers.csv")]
    return [*command, "--tag", "all", "-q", "--draws", "100", "--interval", "20.6", "36.6"]


def killed(toas: list[maloc.ArrivalTimes]) -> str:
    """Kill a run half way, start it again, and compare with one that was left alone."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        command = write(folder, toas)
        run = subprocess.Popen([*command, "--out", str(folder / "a")])
        kept = folder / ".a.tags"
        while len(list(kept.glob("*/record.json"))) < len(toas) // 2:
            time.sleep(0.05)
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
        before = {p: p.stat().st_mtime_ns for p in kept.glob("*/record.json")}
        again = subprocess.Popen([*command, "--out", str(folder / "a")])
        touched: set[Path] = set()
        while again.poll() is None:
            for p, made in before.items():
                try:
                    touched |= {p} if p.stat().st_mtime_ns != made else set()
                except FileNotFoundError:
                    continue  # all are done, and put in their place
            time.sleep(0.05)
        subprocess.run([*command, "--out", str(folder / "b")], check=True)
        names = ["track.csv", "arrivals.csv", "parameters.csv"]
        same = filecmp.cmpfiles(folder / "a", folder / "b", names, shallow=False)[0]
        return (
            f"killed after {len(before)} of {len(toas)} tags; recomputed {len(touched)} of them; "
            f"tables the same: {', '.join(same) or 'none'}"
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tags", type=int, default=3)
    parser.add_argument("--pings", type=int, default=40)
    parser.add_argument("--nuts", type=int, default=0)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--steps", type=int, default=100, help="of SVI")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--kill", type=int, default=0)
    parser.add_argument("--no-svi", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    toas = simulated(given.tags, given.pings, given.seed)
    print(f"{given.tags} tags x {given.pings} pings, CPU seconds without compilation", flush=True)
    quiet = {"progress": False, "hierarchical": LAW}
    method = "laplace" if given.no_svi else "svi"
    maloc.tags.fit(toas[:1], method=method, **quiet)  # compiles
    begun = time.process_time()
    maloc.tags.fit(toas, **quiet)
    laplace = time.process_time() - begun
    print(f"Laplace             {laplace:8.1f}  ({laplace / len(toas):.3f} a tag)", flush=True)
    if not given.no_svi:
        begun = time.process_time()
        found = maloc.tags.fit(toas, method="svi", steps=given.steps, **quiet)
        both = time.process_time() - begun
        print(f"SVI with its start  {both:8.1f}  ({both / len(toas):.3f} a tag)", flush=True)
        for row in found.population():
            print(
                f"  {row['name']:10} median {row['median']:.3g} [{row['median_low']:.3g}, "
                f"{row['median_high']:.3g}], spread {row['spread']:.3g}"
            )
        k = [fit.k_hat for fit in found.fits.values()]  # pyright: ignore
        print(f"  k-hat: median {np.median(k):.2f}, largest {np.max(k):.2f}")
        if given.nuts:
            print("\n".join(against_nuts(found, list(found.fits)[: given.nuts], given.draws, 1)))
    if given.workers:
        (one, half), (more, later) = (parallel(toas, n) for n in (1, given.workers))
        print(
            f"wall s: 1 process {one:.1f}, {given.workers} workers {more:.1f} (starting them "
            f"included): {one / more:.2f} times faster; the later half {half:.1f} and {later:.1f}: "
            f"{half / later:.2f} times"
        )
    if given.kill:
        print(killed(simulated(given.kill, given.pings, given.seed + 1)))


if __name__ == "__main__":
    main()
