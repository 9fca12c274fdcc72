"""Score a track against a boat's GPS: ``python -m benchmarks.gps TRACK.csv... --gps gps.csv``.

Point positions (points.csv) are scored alike, those that were located.

The GPS (columns utm_x, utm_y, epo or x, y, t) is interpolated to each ping inside its span.
Coverage is given as the track states it and with the GPS's own sd (``--gps-sd``, metres an axis)
added.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import polars as pl


def errors(track: pl.DataFrame, gps: np.ndarray, gps_sd: float) -> dict[str, np.ndarray]:
    """Distance (m), and whether the 95 % limits hold the GPS, of rows inside the GPS's span.

    ``gps`` is (n, 3): x, y (m) and time (s). Keys: error, inside, inside_with_gps_sd, heard.
    """
    track = track.drop_nulls(["x", "y"])
    t = track["t"].to_numpy()
    within = (t > gps[0, 2]) & (t < gps[-1, 2])
    true = np.column_stack([np.interp(t, gps[:, 2], gps[:, a]) for a in (0, 1)])[within]
    xy = track["x", "y"].to_numpy()[within]
    off = np.abs(xy - true)
    own = track["sd_x", "sd_y"].to_numpy()[within]
    low, high = xy - 1.96 * own, xy + 1.96 * own
    if "x_lo" in track.columns:
        low, high = (track[f"x_{e}", f"y_{e}"].to_numpy()[within] for e in ("lo", "hi"))
    sd = np.hypot(own, gps_sd)
    return {
        "error": np.hypot(*off.T),
        "inside": ((low <= true) & (true <= high)).mean(axis=1),
        "inside_with_gps_sd": (off <= 1.96 * sd).mean(axis=1),
        "heard": track["heard"].to_numpy()[within]
        if "heard" in track.columns
        else np.ones(int(within.sum()), bool),
    }


def read_gps(path: Path) -> np.ndarray:
    """GPS fixes (n, 3) in time order."""
    table = pl.read_csv(path)
    names = ("utm_x", "utm_y", "epo") if "epo" in table.columns else ("x", "y", "t")
    return table.sort(names[2]).select(pl.col(names).cast(pl.Float64)).to_numpy()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tracks", type=Path, nargs="+")
    parser.add_argument("--gps", type=Path, required=True)
    parser.add_argument("--gps-sd", type=float, default=3.0)
    given = parser.parse_args()
    gps = read_gps(given.gps)
    print(f"{'':36}{'pings':>6}{'mean':>7}{'median':>8}{'95 %':>7}{'cover':>7}{'with GPS sd':>13}")
    for path in given.tracks:
        e = errors(pl.read_csv(path), gps, given.gps_sd)
        groups = {
            "heard": e["heard"],
            "unheard": ~e["heard"],
            "all": np.ones(len(e["heard"]), bool),
        }
        for name, rows in groups.items():
            if not rows.any():
                continue
            error = e["error"][rows]
            middle, high = np.quantile(error, [0.5, 0.95])
            line = f"{path.parent.name + ' ' + name:36}{rows.sum():>6}{error.mean():>7.2f}"
            line += f"{middle:>8.2f}{high:>7.2f}{e['inside'][rows].mean():>7.2f}"
            print(line + f"{e['inside_with_gps_sd'][rows].mean():>13.3f}")


if __name__ == "__main__":
    main()
