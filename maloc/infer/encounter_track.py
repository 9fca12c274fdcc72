"""From the fit of a detection model to tables: track and missed pings.

A known ping's row comes straight from the posterior. Pings that nobody heard are placed where the
gap's most probable number of them says: their times are drawn given number and path, their places
from the exact bridge of the movement between the states around them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.data.encounters import EncounterHistory
from maloc.infer._bridge import draw
from maloc.infer._depths import COLUMNS, draw_depths, summed_up
from maloc.infer._fit import Fitted
from maloc.infer._paths import path_draws
from maloc.infer._rows import Rows
from maloc.model_data.gaps import Silence, find_gaps, most_missed
from maloc.schedule import signal

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Counted", "count_missed", "flat_draws", "missed_table", "track_table"]

_DRAWS = 200  # of the path, for what is drawn or averaged over it
_MOST = 60  # more missed pings in one gap than this are counted, not placed
_FEW = 5  # draws with the most probable count that place its pings


class Counted(NamedTuple):
    """Missed pings of G gaps.

    Attributes
    ----------
    gaps : list of Silence
    pmf : array (G, M)
        Probability of 0, 1, ... missed pings, the path's uncertainty included.
    times : list of D lists of G arrays
        Draws of the missed pings' times, s after each gap's start.
    draws : array (D,)
        Which flat draws of the fit they go with.
    """

    gaps: list[Silence]
    pmf: np.ndarray
    times: list[list[np.ndarray]]
    draws: np.ndarray


def flat_draws(fit: Fitted) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Draws of all sites (D, ...), chains joined, and which 200 or fewer of them to use."""
    draws = {k: v.reshape(-1, *v.shape[2:]) for k, v in fit.draws().items()}
    n = len(draws["position"])
    return draws, np.unique(np.linspace(0, n - 1, min(n, _DRAWS)).astype(int))


def count_missed(fit: Fitted, history: EncounterHistory, seed: int = 0) -> Counted | None:
    """Count the missed pings of every gap, and draw their times.

    Parameters
    ----------
    fit : Fit
        Of a model with the site ``log_q``.
    history : EncounterHistory
        What was fitted.
    seed : int
        Of the draws of times.

    Returns
    -------
    Counted, or None where no gap was summed over.
    """
    gaps = getattr(fit.args[0], "gaps", None)
    found = find_gaps(history)
    if gaps is None or not found:
        return None
    from maloc._jax import jax, jnp
    from maloc.schedule import renewal

    draws, keep = flat_draws(fit)
    log_q = draws["log_q"][keep]
    most = int(max(most_missed(history, g) for g in found)) + 1

    @jax.jit
    def mean_pmf(gaps, log_q):
        return jnp.mean(jax.lax.map(lambda q: renewal.missed_pmf(gaps, q, most), log_q), axis=0)

    pmf = np.asarray(mean_pmf(gaps, jnp.asarray(log_q)))[: len(found)]
    rng = np.random.default_rng(seed)
    times = [renewal.draw_missed(rng, gaps, q)[: len(found)] for q in log_q]
    return Counted(found, pmf / pmf.sum(axis=1, keepdims=True), times, keep)


def missed_table(history: EncounterHistory, counted: Counted) -> pl.DataFrame:
    """Missed pings, one row a gap.

    Returns
    -------
    polars.DataFrame
        tag, kind (before the first heard ping, inside, after the last), from, to (ISO 8601 UTC, or
        s), duration (s), n (most probable), mean, sd, n_lo, n_hi (5 % and 95 % points), least and
        most (what the interval's limits allow), outside (they allow nothing: only the outlier floor
        explains the gap), pmf ("0:0.913 1:0.087").
    """
    import polars as pl

    gaps, pmf = counted.gaps, counted.pmf
    n = np.arange(pmf.shape[1])
    mean = pmf @ n
    below = np.cumsum(pmf, axis=1)
    least, most, outside = _feasible(history, gaps)
    rows = {
        "tag": [history.tags[g.tag] for g in gaps],
        "kind": [g.kind for g in gaps],
        "from": _stamps(history, [g.start for g in gaps]),
        "to": _stamps(history, [g.start + g.duration for g in gaps]),
        "duration": [round(g.duration, 6) for g in gaps],
        "n": pmf.argmax(axis=1),
        "mean": mean.round(6),
        "sd": np.sqrt(np.maximum(pmf @ n**2 - mean**2, 0.0)).round(6),
        "n_lo": (below < 0.05).sum(axis=1),
        "n_hi": (below < 0.95 - 1e-12).sum(axis=1),
        "least": least,
        "most": most,
        "outside": outside,
        "pmf": [" ".join(f"{k}:{p:.4f}" for k, p in enumerate(row) if p >= 5e-5) for row in pmf],
    }
    return pl.DataFrame(rows)


def _feasible(history: EncounterHistory, gaps: list[Silence]):
    """Counts that the schedule's limits allow in each gap, and gaps that they do not allow."""
    least = np.zeros(len(gaps), int)
    most = np.array([max(int(most_missed(history, g)), 0) for g in gaps])
    outside = np.zeros(len(gaps), bool)
    inside = np.array([g.kind == "inside" for g in gaps])
    if inside.any() and history.schedule.kind in ("random", "stable"):
        length = np.array([g.duration for g in gaps])[inside]
        found = signal.missed_counts(length, history.schedule, 0.5, slack=history.slack)
        least[inside], most[inside] = found.least, found.most
        outside[inside] = found.outside
    return least, most, outside


def _stamps(history: EncounterHistory, seconds: list[float]) -> list:
    if history.origin is None:
        return [round(s, 6) for s in seconds]
    ns = history.origin + np.round(np.asarray(seconds) * 1e9).astype(np.int64)
    return [f"{s}Z" for s in np.datetime_as_string(ns.astype("datetime64[ns]"), "us")]


# -- the track ---------------------------------------------------------------------------------


def track_table(
    fit: Fitted, history: EncounterHistory, counted: Counted | None = None, seed: int = 0
) -> pl.DataFrame:
    """Track of every tag: its known pings, and those missed in its gaps.

    Parameters
    ----------
    fit : Fit
        Fit of a detection model (sites ``track``, ``position``).
    history : EncounterHistory
        What was fitted.
    counted : Counted, optional
        Missed pings; each gap with 60 or fewer gets its most probable number of rows.
    seed : int
        Seed of the draws for unheard pings.

    Returns
    -------
    polars.DataFrame
        Columns of track.csv, by tag and time: tag, time (ISO 8601 UTC or null), t (the input's
        seconds), x, y, sd_x, sd_y (m), cov_xy (m2), x_lo, x_hi, y_lo, y_hi (central 95 %),
        the depth z, sd_z, z_lo, z_hi (m) of tracks that have it, n_receivers, heard, ping (rows of
        a tag's pings from 1, null where only the schedule calls for one).
    """
    import polars as pl

    columns, n = _known(fit, history), len(history)
    if counted is not None and (more := _placed(fit, history, counted, seed)) is not None:
        columns = {k: np.concatenate([v, more[k]]) for k, v in columns.items()}
    order = np.lexsort((columns["t"], columns["tag"]))
    fit._known["rows"] = _rows(columns, np.argsort(order), n)
    columns = {k: v[order] for k, v in columns.items()}
    ping = pl.Series(columns.pop("ping")).replace(-1, None)
    t = columns.pop("t")
    tag = [history.tags[i] for i in columns.pop("tag")]
    if history.origin is None:
        head = {"tag": tag, "time": pl.Series([None] * len(t), dtype=pl.String), "t": t}
    else:
        ns = pl.Series(history.origin + np.round(t * 1e9).astype(np.int64))
        time = ns.cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        head = {"tag": tag, "time": time, "t": history.origin / 1e9 + t}
    return pl.DataFrame(head | columns | {"heard": columns["n_receivers"] > 0, "ping": ping})


def _rows(columns: dict[str, np.ndarray], row: np.ndarray, n: int) -> Rows:
    """Where the columns' rows stand in the table; the first n are in the fit's chain."""
    more = {k: v[n:] for k, v in columns.items()}
    covariance = np.empty((len(row) - n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = more["sd_x"] ** 2, more["sd_y"] ** 2
    covariance[:, 0, 1] = covariance[:, 1, 0] = more["cov_xy"]

    def pair(x: str, y: str) -> np.ndarray:
        return np.column_stack([more[x], more[y]])

    where = pair("x", "y"), covariance, pair("x_lo", "y_lo"), pair("x_hi", "y_hi")
    return Rows(row[:n], row[n:], more["ping"], more["tag"], more["t"], *where)


def _columns(tag, t, position, covariance, low, high, depth, n_receivers, ping):
    return {
        "tag": np.asarray(tag),
        "t": np.asarray(t),
        "x": position[:, 0],
        "y": position[:, 1],
        "sd_x": np.sqrt(covariance[:, 0, 0]),
        "sd_y": np.sqrt(covariance[:, 1, 1]),
        "cov_xy": covariance[:, 0, 1],
        "x_lo": low[:, 0],
        "x_hi": high[:, 0],
        "y_lo": low[:, 1],
        "y_hi": high[:, 1],
        **dict(zip(COLUMNS, depth.T, strict=False)),
        "n_receivers": np.asarray(n_receivers),
        "ping": np.asarray(ping),
    }


def _known(fit: Fitted, history: EncounterHistory) -> dict[str, np.ndarray]:
    """Rows of the pings that are rows of the history, from the posterior's moments."""
    states = np.flatnonzero(np.asarray(fit.args[0].ping)[: fit.n_states])
    position, covariance, low, high = (part[states] for part in fit.positions())
    time = _sent(fit, history, states)
    depth = np.array(fit.depths() or ()).T.reshape(fit.n_states, -1)[states]
    number = np.arange(len(history)) - history.first_rows[history.tag] + 1
    known = (position, covariance, low, high, depth, history.n_heard, number)
    return _columns(history.tag, time, *known)


def _sent(fit: Fitted, history: EncounterHistory, states: np.ndarray) -> np.ndarray:
    """Emission times (P,), s: as the fit has them, where arrivals or a beat tell; else as given."""
    draws = fit.draws()
    if "emission_time" not in draws:
        return history.time
    told = (history.n_heard > 0) | (fit.args[0].schedule in ("stable", "sequence"))
    return np.where(told, draws["emission_time"].mean(axis=(0, 1))[states], history.time)


def _placed(
    fit: Fitted, history: EncounterHistory, counted: Counted, seed: int
) -> dict[str, np.ndarray] | None:
    """Rows of the missed pings, as many in each gap as are most probable."""
    rng = np.random.default_rng(seed)
    paths = {tag: path_draws(fit, tag) for tag in {gap.tag for gap in counted.gaps}}
    parts = []
    for g, gap in enumerate(counted.gaps):
        n = int(counted.pmf[g].argmax())
        if not 0 < n <= _MOST:
            continue
        mine = [d for d, times in enumerate(counted.times) if len(times[g]) == n]
        if len(mine) < _FEW:  # evenly spaced: too few draws say more
            mine = list(range(len(counted.draws)))
            at = np.tile(gap.duration * np.arange(1, n + 1) / (n + 1), (len(mine), 1))
        else:
            at = np.array([counted.times[d][g] for d in mine])
        at = gap.start + at
        path = paths[gap.tag].take(counted.draws[mine])
        places = draw(rng, path, at)[:, :, 0]
        deep = None if path.depth is None else draw_depths(rng, path.depth, at, places)
        for i in range(n):
            place = places[:, i]
            low, high = np.quantile(place, [0.025, 0.975], axis=0)
            where = (place.mean(axis=0), np.cov(place.T), low, high, summed_up(deep, i))
            parts.append((gap.tag, at[:, i].mean(), *where, 0, -1))
    if not parts:
        return None
    return _columns(*(np.array(column) for column in zip(*parts, strict=True)))
