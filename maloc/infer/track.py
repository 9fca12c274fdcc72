"""From a fit to a track: one row a ping, heard or not.

A heard ping's row comes straight from the posterior. A ping that nobody heard adds nothing to the
likelihood, so its position is a prediction: times are drawn from what the schedule leaves open,
then positions from the exact bridge of the movement between the states around it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from maloc.data.arrivals import ArrivalTimes, Schedule
from maloc.errors import FitError
from maloc.infer._bridge import draw
from maloc.infer._depths import COLUMNS, draw_depths, summed_up
from maloc.infer._fit import Fitted
from maloc.infer._paths import path_draws
from maloc.infer._rows import Rows
from maloc.schedule import signal

if TYPE_CHECKING:
    import polars as pl

__all__ = ["find_rows", "gaps_outside", "track_table"]

_DRAWS = 1000


class _Rows(NamedTuple):
    """Columns of the track: emission time (s), position, sd and interval by axis, heard or not."""

    t: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray  # (n, 4) m: mean, sd, interval; no columns where the track is flat
    n_receivers: np.ndarray
    ping: np.ndarray  # id in the input, -1 = none


def track_table(fit: Fitted, toa: ArrivalTimes, seed: int = 0) -> pl.DataFrame:
    """Track of a fit as a table, every ping in order.

    Parameters
    ----------
    fit : Fit
        Fit of an arrival-time model (sites ``track``, ``emission_time``).
    toa : ArrivalTimes
        What was fitted, with pings that nobody heard.
    seed : int
        Seed of the draws for unheard pings.

    Returns
    -------
    polars.DataFrame
        Columns of track.csv: tag, time (ISO 8601 UTC or null), t (emission time, the input's
        seconds), x, y, sd_x, sd_y (m), cov_xy (m2), x_lo, x_hi, y_lo, y_hi (central 95 %), the
        depth z, sd_z, z_lo, z_hi (m) of a track that has it, n_receivers, heard, ping (id in the
        input, null where only the schedule calls for it); and longitude, latitude where the
        receivers' frame is known.
    """
    return _frame(find_rows(fit, toa, seed), toa)


def find_rows(fit: Fitted, toa: ArrivalTimes, seed: int = 0) -> _Rows:
    """Work the track's rows out, and note in the fit where its pings stand among them."""
    heard, more = _heard(fit, toa), _unheard(fit, toa, np.random.default_rng(seed))
    both, n = heard, len(heard.t)
    if more is not None:
        both = _Rows(*(np.concatenate(pair) for pair in zip(heard, more, strict=True)))
    order = np.argsort(both.t, kind="stable")
    row = np.argsort(order, kind="stable")
    fit._known["rows"] = Rows(
        row[:n],
        row[n:],
        both.ping[n:],
        np.zeros(len(row) - n, int),
        both.t[n:],
        both.position[n:],
        both.covariance[n:],
        both.low[n:],
        both.high[n:],
    )
    return _Rows(*(column[order] for column in both))


def _heard(fit: Fitted, toa: ArrivalTimes) -> _Rows:
    """Rows of the heard pings from the posterior's moments."""
    position, covariance, low, high = fit.positions()
    if fit.method == "laplace":
        x, u = fit.marginal.x, fit.marginal.u  # pyright: ignore[reportAttributeAccessIssue]
        emission = np.asarray(fit.cm.natural(x, u, fit.args)["emission_time"])[: fit.n_states]
    else:
        emission = fit.draws()["emission_time"].mean(axis=(0, 1))
    depth = np.array(fit.depths() or ()).T.reshape(len(emission), -1)
    known = toa.n_heard > 0
    return _Rows(
        emission, position, covariance, low, high, depth, toa.n_heard[known], toa.ping[known]
    )


def _unheard(fit: Fitted, toa: ArrivalTimes, rng: np.random.Generator) -> _Rows | None:
    """Rows of pings that nobody heard: those of the input, and those the schedule calls for."""
    gaps = _gaps(toa)
    if not gaps:
        return None
    path = path_draws(fit)
    keep = np.linspace(0, len(path.clock) - 1, min(len(path.clock), _DRAWS)).astype(int)
    path = path.take(keep)
    parts = []
    heard = np.flatnonzero(toa.n_heard > 0)
    pings: list[int] = []
    for k, n, schedule in gaps:
        after = 0 if k < 0 else int(heard[k]) + 1
        empty = range(after, int(heard[k + 1]) if k + 1 < len(heard) else toa.n_pings)
        pings += [int(toa.ping[row]) for row in empty] or [-1] * n
        times = _times(rng, path.clock, k, n, schedule, len(keep))
        places = draw(rng, path, times)[:, :, 0]  # (draw, n, 2)
        deep = None if path.depth is None else draw_depths(rng, path.depth, times, places)
        for i in range(n):
            place = places[:, i]
            low, high = np.quantile(place, [0.025, 0.975], axis=0)
            covariance = np.cov(place.T)
            depth = summed_up(deep, i)
            parts.append((times[:, i].mean(), place.mean(axis=0), covariance, low, high, depth))
    columns = [np.array(c) for c in zip(*parts, strict=True)]
    return _Rows(*columns, n_receivers=np.zeros(len(parts), int), ping=np.array(pings))


def _gaps(toa: ArrivalTimes) -> list[tuple[int, int, Schedule]]:
    """Gaps with unheard pings: heard ping before it (-1 = before the first), how many, schedule."""
    heard = np.flatnonzero(toa.n_heard > 0)
    first = toa.first[heard]
    known = np.diff(np.concatenate([[-1], heard, [toa.n_pings]])) - 1  # empty rows around
    schedule = toa.schedule
    if schedule.kind == "unknown":
        alone = np.diff(heard) == 1
        steps = np.diff(first)[alone] if alone.any() else np.diff(first) / np.diff(heard)
        if len(steps) == 0 and known.any():
            raise FitError("one heard ping and no burst interval: when were the others sent?")
        if len(steps) == 0:
            return []
        spread = max(float(np.std(steps)), 1e-3)
        schedule = Schedule("stable", float(np.mean(steps)), spread)
    gaps = [(-1, int(known[0]), schedule)] if known[0] else []
    missed = np.zeros(max(len(heard) - 1, 0), int)
    if toa.schedule.kind != "unknown" and len(first) > 1:
        missed = _missed(toa).most_probable
    for k in range(len(heard) - 1):
        n = int(known[k + 1] or missed[k])
        if n:
            gaps.append((k, n, schedule))
    if known[-1]:
        gaps.append((len(heard) - 1, int(known[-1]), schedule))
    return gaps


def gaps_outside(toa: ArrivalTimes) -> int:
    """Gaps between heard pings that no number of the schedule's intervals explains."""
    if toa.schedule.kind == "unknown" or (toa.n_heard > 0).sum() < 2:
        return 0
    return int(_missed(toa).outside.sum())


def _missed(toa: ArrivalTimes) -> signal.MissedCounts:
    """Missed pings in the gaps between heard ones."""
    steps = np.diff(toa.first[toa.n_heard > 0])
    slack = _travel(toa)  # first arrivals stand for emissions: that much may differ
    chance = signal.estimate_p_missed(steps, toa.schedule, slack=slack)
    return signal.missed_counts(steps, toa.schedule, chance, slack=slack)


def _travel(toa: ArrivalTimes) -> float:
    """Largest travel time between receivers that heard something (s)."""
    xy = toa.receivers.xy[toa.heard.any(axis=0)]
    return float(np.linalg.norm(np.ptp(xy, axis=0)) / np.mean(toa.sound_speed))


def _times(rng, emission, k: int, n: int, schedule: Schedule, size: int) -> np.ndarray:
    """Draws (size, n) of the unheard pings' emission times (s from the origin)."""
    if 0 <= k < emission.shape[1] - 1:
        gap = float(np.mean(emission[:, k + 1] - emission[:, k]))
        offsets = signal.draw_missed_times(rng, gap, n, schedule, size)
        share = offsets / gap  # the draw's own gap differs by milliseconds
        return emission[:, k, None] + share * (emission[:, k + 1] - emission[:, k])[:, None]
    if schedule.kind == "random":
        steps = rng.uniform(schedule.lo, schedule.hi, (size, n))
    else:
        steps = np.maximum(rng.normal(schedule.lo, schedule.hi, (size, n)), 1e-3)
    ends = np.cumsum(steps, axis=1)
    return emission[:, :1] - ends[:, ::-1] if k < 0 else emission[:, -1:] + ends


def _frame(rows: _Rows, toa: ArrivalTimes) -> pl.DataFrame:
    import polars as pl

    sd = np.sqrt(np.einsum("tii->ti", rows.covariance))
    time, t = pl.Series([None] * len(rows.t), dtype=pl.String), rows.t
    if toa.origin is not None:
        ns = pl.Series(toa.origin + np.round(rows.t * 1e9).astype(np.int64))
        time = ns.cast(pl.Datetime("ns")).dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        t = toa.origin / 1e9 + rows.t
    columns = {
        "tag": [toa.tag] * len(t),
        "time": time,
        "t": t,
        "x": rows.position[:, 0],
        "y": rows.position[:, 1],
        "sd_x": sd[:, 0],
        "sd_y": sd[:, 1],
        "cov_xy": rows.covariance[:, 0, 1],
        "x_lo": rows.low[:, 0],
        "x_hi": rows.high[:, 0],
        "y_lo": rows.low[:, 1],
        "y_hi": rows.high[:, 1],
        **dict(zip(COLUMNS, rows.depth.T, strict=False)),
        "n_receivers": rows.n_receivers,
        "heard": rows.n_receivers > 0,
        "ping": pl.Series(rows.ping).replace(-1, None),
    }
    if toa.receivers.crs is not None:
        lon, lat = toa.receivers.lonlat(rows.position[:, 0], rows.position[:, 1])
        columns |= {"longitude": lon, "latitude": lat}
    return pl.DataFrame(columns)
