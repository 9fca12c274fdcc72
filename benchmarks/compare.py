"""Compare tracks with the truth: ``python -m benchmarks.compare TRUTH.csv RUN...``.

TRUTH.csv is what ``maloc simulate`` writes; each RUN is a folder that ``maloc track`` wrote.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl


class Score(NamedTuple):
    """Distances from the truth (m) and how often 95 % limits hold it."""

    n: int
    mean: float
    median: float
    p95: float
    coverage: float


def score(track: pl.DataFrame, truth: np.ndarray) -> Score:
    """Score the rows of a track.csv against true positions (P, 2); rows without truth are NaN."""
    known = np.isfinite(truth).all(1)
    xy, truth = track["x", "y"].to_numpy()[known], truth[known]
    lo = track["x_lo", "y_lo"].to_numpy()[known]
    hi = track["x_hi", "y_hi"].to_numpy()[known]
    error = np.linalg.norm(xy - truth, axis=1)
    inside = (lo <= truth) & (truth <= hi)
    median, p95 = np.quantile(error, [0.5, 0.95])
    return Score(len(error), error.mean(), median, p95, inside.mean())


def true_positions(track: pl.DataFrame, truth: pl.DataFrame, within: float = 5.0) -> np.ndarray:
    """Return the position (P, 2) of the true ping nearest to each row, NaN beyond `within` s.

    Times are compared as dates where the track has them, else as seconds.
    """
    column = "time" if track["time"].is_not_null().all() else "t"
    mine, true = (_seconds(table[column]) for table in (track, truth))
    nearest = np.abs(mine[:, None] - true).argmin(1)
    found = truth["x", "y"].to_numpy()[nearest].copy()
    found[np.abs(mine - true[nearest]) > within] = np.nan
    return found


def _seconds(column: pl.Series) -> np.ndarray:
    if column.dtype != pl.String:
        return column.to_numpy()
    text = column.str.strip_chars_end("Z").to_numpy().astype("datetime64[ns]")
    return text.astype(np.int64) * 1e-9


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
        track = pl.read_csv(run / "track.csv")
        s = score(track, true_positions(track, truth))
        print(f"{run!s:<28}{s.n:>7}{s.mean:>8.2f}{s.median:>8.2f}{s.p95:>8.2f}{s.coverage:>30.3f}")
        if lost := len(track) - s.n:
            print(f"{'':<28}{lost:>7} more pings have no truth within 5 s")
    if given.picture:
        import maloc

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
