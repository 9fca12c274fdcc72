"""The README's numbers: ``python -m benchmarks.readme SSU1 CANAL [--write]``.

SSU1 holds VUE_Export_ssu1.csv, hydros.csv, gps.csv and YAPS's peer_yaps_track.csv; CANAL
arrival-time matrices with their truth, and YAPS's yaps_results.csv. ``--write`` keeps them in
docs/readme_numbers.csv and puts the table into README.md.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

ROOT = Path(__file__).resolve().parents[1]
NUMBERS = ROOT / "docs" / "readme_numbers.csv"
BEGIN, END = "<!-- numbers: python -m benchmarks.readme -->\n", "<!-- end of numbers -->\n"
_LOST = 3.0
_MALOC = [str(Path(sys.executable).parent / "maloc")]


def timed(command: list[str], cache: Path) -> tuple[float, float]:
    """CPU and wall seconds of a whole command."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "MALOC_CACHE_DIR": str(cache)}
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, wall


def towed(folder: Path) -> dict[str, float]:
    """Tag 15266 of ssu1 from its raw export, heard pings, against the GPS."""
    from benchmarks.gps import errors, read_gps

    gps, found = read_gps(folder / "gps.csv"), {}
    files = [str(folder / "VUE_Export_ssu1.csv"), "--receivers", str(folder / "hydros.csv")]
    how = ["track", *files, "--tag", "15266", "--interval", "20", "40", "--quiet"]
    with tempfile.TemporaryDirectory() as place:
        out, cache = Path(place), Path(place) / "cache"
        for name in ("first", "second"):
            seconds = timed([*_MALOC, *how, "--out", str(out / name)], cache)
            found[f"ssu1_{name}_cpu"], found[f"ssu1_{name}_wall"] = seconds
        presence = ["--model", "detections", "--out", str(out / "presence")]
        timed([*_MALOC, *how, *presence], cache)
        for name, run in (("ssu1", "second"), ("presence", "presence")):
            e = errors(pl.read_csv(out / run / "track.csv"), gps, 0.0)
            found[f"{name}_mean"] = float(e["error"][e["heard"]].mean())
        heard = pl.read_csv(out / "second" / "track.csv").filter(pl.col("heard"))
        found["ssu1_receivers_a_ping"] = float(heard["n_receivers"].to_numpy().mean())
        found["hearing_receivers_mean"] = _middles(out / "presence", folder, gps)
    yaps = (
        pl.read_csv(folder / "peer_yaps_track.csv")
        .rename({"epo": "t"})
        .with_columns(sd_x=pl.col("x_sd"), sd_y=pl.col("y_sd"), heard=pl.col("nobs") > 0)
    )
    e = errors(yaps, gps, 0.0)
    found["ssu1_mean_yaps"] = float(e["error"][e["heard"]].mean())
    return found


def _middles(run: Path, folder: Path, gps: np.ndarray) -> float:
    """Mean distance to the GPS of the mean place of the receivers that heard each ping."""
    places = pl.read_csv(folder / "hydros.csv").select(pl.col("serial").cast(pl.String), "x", "y")
    used = pl.read_csv(run / "arrivals.csv").filter(pl.col("used"))
    used = used.with_columns(pl.col("receiver").cast(pl.String))
    each = (
        used.join(places, left_on="receiver", right_on="serial")
        .group_by("ping")
        .agg(pl.col("t", "x", "y").mean())
    )
    each = each.filter(pl.col("t").is_between(gps[0, 2], gps[-1, 2], closed="none"))
    t = each["t"].to_numpy()
    true = np.column_stack([np.interp(t, gps[:, 2], gps[:, a]) for a in (0, 1)])
    return float(np.hypot(*(each["x", "y"].to_numpy() - true).T).mean())


def canal(folder: Path) -> dict[str, float]:
    """Canal tracks beside YAPS's results on the same files."""
    from benchmarks.tracks import fit_case, folder_cases

    peer = {
        r["file"].removesuffix(".csv"): r
        for r in pl.read_csv(folder / "yaps_results.csv").rows(named=True)
    }
    cases = list(folder_cases(folder, None, None, None))
    fit_case(cases[0], "laplace", 50, 0)  # compilation
    rows = [fit_case(case, "laplace", 1000, 0) for case in cases]
    own = {r.file: r.mean for r in rows}
    lost = {name for name, mean in own.items() if mean > _LOST * peer[name]["mean"]}
    lost_by_yaps = {name for name, mean in own.items() if peer[name]["mean"] > _LOST * mean}
    cells = {name.split("_", 1)[1] for name in lost_by_yaps}
    whole = [r for r in rows if r.file.split("_", 1)[1] not in cells]
    seconds = np.array([r.start + r.theta for r in rows])
    spent = np.array([r["user_s"] for r in peer.values()])
    return {
        "canal_files": len(rows),
        "canal_ratio": float(
            np.mean([r.mean for r in whole]) / np.mean([peer[r.file]["mean"] for r in whole])
        ),
        "canal_cover": float(np.mean([r.cover for r in rows])),
        "canal_lost": len(lost),
        "canal_lost_yaps": len(lost_by_yaps),
        "canal_cpu": float(np.median(seconds)),
        "canal_cpu_yaps_least": float(spent.min()),
        "canal_cpu_yaps_most": float(spent.max()),
    }


def table(numbers: dict[str, float]) -> str:
    """The README's table."""
    n = numbers
    rows = [
        ("", "maloc", "YAPS 1.2.5"),
        ("---", "---", "---"),
        (
            "towed tag with GPS (ssu1), heard pings: mean error",
            f"{n['ssu1_mean']:.2f} m",
            f"{n['ssu1_mean_yaps']:.2f} m",
        ),
        (
            "the same: the whole command from the raw export, CPU s (clock)",
            f"{n['ssu1_first_cpu']:.0f} ({n['ssu1_first_wall']:.0f}) the first time, "
            f"{n['ssu1_second_cpu']:.0f} ({n['ssu1_second_wall']:.0f}) later",
            "",
        ),
        (
            f"{n['canal_files']:.0f} canal tracks: mean error where YAPS lost none",
            f"{n['canal_ratio']:.3f} x",
            "1",
        ),
        ("the same: 95 % limits hold the truth", f"{n['canal_cover']:.3f}", ""),
        (
            "the same: tracks lost (error above three times the other's)",
            f"{n['canal_lost']:.0f}",
            f"{n['canal_lost_yaps']:.0f}",
        ),
        (
            "the same: CPU seconds of the fit alone, once compiled",
            f"{n['canal_cpu']:.1f}",
            f"{n['canal_cpu_yaps_least']:.0f} to {n['canal_cpu_yaps_most']:.0f}",
        ),
        (
            "ssu1 by presence alone (`--model detections`): mean error; mean place of the "
            "receivers that heard the ping",
            f"{n['presence_mean']:.0f} m; {n['hearing_receivers_mean']:.0f} m",
            "",
        ),
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def read_numbers(path: Path = NUMBERS) -> dict[str, float]:
    """The numbers as they were written."""
    found = pl.read_csv(path)
    return dict(zip(found["name"], found["value"], strict=True))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ssu1", type=Path)
    parser.add_argument("canal", type=Path)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    numbers = towed(given.ssu1) | canal(given.canal)
    print(table(numbers))
    if given.write:
        pl.DataFrame({"name": [*numbers], "value": [float(v) for v in numbers.values()]}).write_csv(
            NUMBERS, float_precision=4
        )
        page = (ROOT / "README.md").read_text()
        head, rest = page.split(BEGIN)
        text = head + BEGIN + table(read_numbers()) + END + rest.split(END)[1]
        (ROOT / "README.md").write_text(text)


if __name__ == "__main__":
    main()
