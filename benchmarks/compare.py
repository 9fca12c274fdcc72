"""Compare tracks with the truth: ``python -m benchmarks.compare TRUTH.csv RUN...``.

TRUTH.csv is what ``maloc simulate`` writes; each RUN is a folder that ``maloc track`` wrote.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import polars as pl

import maloc
from maloc.evaluate import evaluate


def main() -> None:
    """Print a row a run, and draw the last run with the truth where a picture is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("truth", type=Path)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--receivers", type=Path, help="for the picture")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    truth = pl.read_csv(given.truth)
    print(
        f"{'error against the truth, m':<28}{'pings':>7}{'mean':>8}{'median':>8}{'95 %':>8}", end=""
    )
    print(f"{'coverage of 95 % intervals':>30}")
    for run in given.runs:
        s = evaluate(pl.read_csv(run / "track.csv"), truth).scores
        print(f"{run!s:<28}{s['n']:>7}{s['mean']:>8.2f}{s['median']:>8.2f}{s['p95']:>8.2f}", end="")
        print(f"{s['coverage']:>30.3f}")
        if s["lost"]:
            print(f"{'':<28}{s['lost']:>7} more pings have no truth within 5 s")
    if given.picture:
        track = pl.read_csv(given.runs[-1] / "track.csv")
        receivers = None if given.receivers is None else maloc.read_receivers(given.receivers)
        axes = maloc.plots.track(track, receivers, truth=truth["x", "y"].to_numpy())
        axes.legend(loc="lower left")
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.savefig(given.picture, dpi=110, bbox_inches="tight")
        print(f"picture: {given.picture}")


if __name__ == "__main__":
    main()
