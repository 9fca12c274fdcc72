"""Score a track against the truth: any two tables, maloc's, YAPS's, a VPS's or a GPS's.

References
----------
Error, local error, third quartile, share within 2.5 m, length: the performance measures of studies
of the canal that the project grew from; range and bearing: Ren et al. (2012), as they use them.
Gneiting & Raftery (2007) J. Am. Stat. Assoc. 102: 359-378 (CRPS, energy score).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._limits import Z95
from maloc.errors import InputError
from maloc.evaluate.scores import deciles, ping_scores, track_scores
from maloc.evaluate.tables import as_track

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

    from maloc.data.positions import Positions

__all__ = ["Evaluation", "evaluate", "true_positions"]

_PAIRS = 200  # pairs of draws behind an energy score


@dataclass(frozen=True)
class Evaluation:
    """How a track compares with the truth.

    Attributes
    ----------
    scores : dict of str to float
        ``n`` rows with truth, ``lost`` without; ``mean``, ``median``, ``q3``, ``p95`` error (m);
        ``correct``, share within `correct` metres; ``local``, mean error within `near` of the
        centre (m); ``range`` (m) and ``bearing`` (degrees) errors seen from it; ``length``, of the
        track over the true one's through the same rows. Where the track has standard deviations:
        ``rho``, rank correlation of expected with true error; ``coverage`` of 95 % limits, each
        coordinate by itself; ``crps`` (m, mean of both axes) and ``energy`` score (m) of the normal
        law with the track's covariance: less is better, and an honest width is rewarded.
    deciles : (10,) array
        Root mean square error over the expected one, by tenths of rows from the surest: 1 is
        honest. NaN without standard deviations.
    rows : polars.DataFrame
        One row of the track each: ``x_true``, ``y_true``, ``error``, ``expected``, ``range``,
        ``bearing``; null where there is no truth.
    """

    scores: dict[str, float]
    deciles: np.ndarray
    rows: pl.DataFrame

    def __str__(self) -> str:
        return "\n".join(f"{name:10}{value:10.3f}" for name, value in self.scores.items())


def evaluate(
    track: pl.DataFrame | Positions | str | Path,
    truth: pl.DataFrame | Positions | str | Path,
    *,
    centre: Any = None,
    near: float = 150.0,
    correct: float = 2.5,
    within: float = 5.0,
    seed: int = 0,
) -> Evaluation:
    """Compare a track with the truth.

    Parameters
    ----------
    track : polars.DataFrame, Positions, str or Path
        A table or the CSV that it is in: ``time`` (dates as text or datetimes) or ``t`` (s), ``x``
        and ``y`` (m); optional ``sd_x``, ``sd_y`` and ``cov_xy``, and the 95 % limits ``x_lo``,
        ``x_hi``, ``y_lo``, ``y_hi``. YAPS's, a VPS's, kaltoa's and a GPS's words for these are
        known; numbers of a time that can be seconds since 1970 are, others count from an origin
        that both tables share. Positions in degrees: `maloc.read_positions`.
    truth : polars.DataFrame, Positions, str or Path
        Times, ``x``, ``y``: pings, or fixes of a GPS.
    centre : (2,) array, optional
        Where ranges and bearings are from (m): the middle receiver, say. Not given: the middle of
        the true positions.
    near : float
        What "local" means, m from the centre.
    correct : float
        Largest error of a correct position, m.
    within : float
        Truth is interpolated between rows at most twice as far apart, else the nearest row's if it
        is no farther off than this, s.
    seed : int
        Of the draws behind the energy score.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        If a column is missing, a table is of several tags, or no row has truth.
    """
    track, truth = as_track(track, "track"), as_track(truth, "truth")
    position, true = _xy(track), true_positions(track, truth, within)
    known = np.isfinite(true).all(axis=1) & np.isfinite(position).all(axis=1)
    if not known.any():
        raise InputError(
            f"no row of the track has truth within {within:g} s",
            mend="times of both tables count from one origin, or are dates",
        )
    sd, corner = _widths(track)
    lo, hi = _limits(track, position, sd)
    middle = true[known].mean(axis=0) if centre is None else np.asarray(centre, float)
    each = ping_scores(true, position, sd, lo, hi, middle)
    each = {name: np.where(known, value, np.nan) for name, value in each.items()}
    error = each["error"][known]
    local = error[each["away"][known] <= near]
    whole = track_scores(true[known], position[known], error, each["expected"][known])
    scores: dict[str, float] = {
        "n": int(known.sum()),
        "lost": int((~known).sum()),
        "mean": float(error.mean()),
        "median": float(np.median(error)),
        "q3": float(np.quantile(error, 0.75)),
        "p95": float(np.quantile(error, 0.95)),
        "correct": float(np.mean(error <= correct)),
        "local": float(local.mean()) if len(local) else float("nan"),
        "range": float(each["range"][known].mean()),
        "bearing": float(each["bearing"][known].mean()),
        "length": whole["length"],
    }
    sure = known & np.isfinite(sd).all(axis=1)
    if sure.any():
        off = (true - position)[sure]
        scores["rho"] = whole["rho"]
        scores["coverage"] = float(np.nanmean(each["covered"][sure]))
        scores["crps"] = float(crps(off, sd[sure]).mean())
        scores["energy"] = float(energy(off, sd[sure], corner[sure], seed).mean())
    tenths = np.full(10, np.nan)
    if sure.sum() >= 10:
        tenths = deciles(each["expected"][sure], each["error"][sure])
    return Evaluation(scores, tenths, _rows(each, true))


def crps(off: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score of normal laws, of errors and sds of any one shape."""
    from scipy.stats import norm

    z = off / sd
    return sd * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))


def energy(off: np.ndarray, sd: np.ndarray, corner: np.ndarray, seed: int) -> np.ndarray:
    """Energy score (P,) of bivariate normal laws: E |X - y| - E |X - X'| / 2, by draws.

    Parameters
    ----------
    off : (P, 2) array
        Truth minus mean, m.
    sd : (P, 2) array
        m.
    corner : (P,) array
        Covariance of the two coordinates, m2.
    """
    slope = corner / sd[:, 0] ** 2
    rest = np.sqrt(np.maximum(sd[:, 1] ** 2 - slope * corner, 0.0))
    z = np.random.default_rng(seed).normal(size=(2, _PAIRS, 2))
    z = np.concatenate([z, -z], axis=1)
    east = z[..., 0][..., None] * sd[:, 0]
    north = east * slope + z[..., 1][..., None] * rest
    to_truth = np.hypot(east - off[:, 0], north - off[:, 1]).mean(axis=(0, 1))
    # a draw with its own mirror image would not be a pair of independent ones
    apart = np.hypot(east[0] - east[1], north[0] - north[1]).mean(axis=0)
    return to_truth - 0.5 * apart


def true_positions(
    track: pl.DataFrame | Positions | str | Path,
    truth: pl.DataFrame | Positions | str | Path,
    within: float = 5.0,
) -> np.ndarray:
    """Return the true position (P, 2) at each row's time, NaN where the truth says nothing.

    Parameters and errors as in `evaluate`. Times are compared as dates where both tables have them,
    else as seconds.
    """
    track, truth = as_track(track, "track"), as_track(truth, "truth")
    both = set(track.columns) & set(truth.columns)
    if not {"time", "t"} & both:
        one = "truth" if "t" in track.columns else "track"
        raise InputError(
            f"the {one} has dates, the other table seconds from an origin of its own",
            mend="give both dates, or both seconds from one origin",
        )
    column = "time" if "time" in both else "t"
    mine, clock = _seconds(track[column]), _seconds(truth[column])
    told = np.isfinite(clock)
    clock, xy = clock[told], _xy(truth)[told]
    order = np.argsort(clock, kind="stable")
    clock, xy = clock[order], xy[order]
    after = np.clip(np.searchsorted(clock, mine), 1, max(len(clock) - 1, 1))
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, len(clock) - 1)
    gap = clock[after] - clock[before]
    share = np.where(gap > 0, (mine - clock[before]) / np.where(gap > 0, gap, 1.0), 0.0)
    between = xy[before] + share[:, None] * (xy[after] - xy[before])
    nearest = np.where(np.abs(mine - clock[before]) <= np.abs(mine - clock[after]), before, after)
    close = np.abs(mine - clock[nearest]) <= within
    inside = (share >= 0) & (share <= 1) & (gap <= 2 * within)
    out = np.where(inside[:, None], between, xy[nearest])
    return np.where((inside | close)[:, None], out, np.nan)


def _seconds(values: pl.Series) -> np.ndarray:
    if values.name == "t":
        return values.to_numpy()
    return (values.dt.epoch("ns").cast(float) * 1e-9).to_numpy()


def _xy(table: pl.DataFrame) -> np.ndarray:
    return np.asarray(table["x", "y"].to_numpy(), float)


def _widths(track: pl.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (P, 2) and covariance (P,); NaN and 0 where there are none."""
    if not {"sd_x", "sd_y"} <= set(track.columns):
        return np.full((len(track), 2), np.nan), np.zeros(len(track))
    corner = track["cov_xy"].to_numpy() if "cov_xy" in track.columns else np.zeros(len(track))
    return np.asarray(track["sd_x", "sd_y"].to_numpy(), float), np.nan_to_num(corner)


def _limits(track: pl.DataFrame, position: np.ndarray, sd: np.ndarray) -> tuple:
    names = ("x_lo", "y_lo", "x_hi", "y_hi")
    if not set(names) <= set(track.columns):
        return position - Z95 * sd, position + Z95 * sd
    values = np.asarray(track.select(names).to_numpy(), float)
    return values[:, :2], values[:, 2:]


def _rows(each: dict[str, np.ndarray], true: np.ndarray) -> pl.DataFrame:
    import polars as pl

    columns = {"x_true": true[:, 0], "y_true": true[:, 1]}
    columns |= {n: each[n] for n in ("error", "expected", "range", "bearing")}
    return pl.DataFrame(columns).fill_nan(None)
