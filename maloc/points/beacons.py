"""Point positions without synchronised clocks: each ping against sync tags' pings near in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from maloc.data._time import NS
from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.points._beacons import (
    Beacons,
    differenced,
    distances_to,
    rank_beacons,
)
from maloc.points._methods import accepted, assemble, checked_prior, method_of
from maloc.points._problem import Problem, problem_of
from maloc.points._shared_offsets import refine_shared, share_offsets
from maloc.points._sigma import UNKNOWN, diameter, spread_of
from maloc.points.altitude import depths
from maloc.points.result import Points

__all__ = ["locate_by_beacons"]


def locate_by_beacons(
    toa: ArrivalTimes,
    beacons: Sequence[ArrivalTimes],
    method: Any = "consensus",
    *,
    multiple: bool = False,
    sigma: float | np.ndarray | None = None,
    depth: Any = "auto",
    most: int = 5,
    window: float = 5.0,
    near: float = 2.0,
    reach: float | None = None,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    **options: Any,
) -> Points:
    """Locate pings whose receivers' clocks were never brought together.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings of the tag, each arrival on its receiver's own clock. Offsets may be anything that
        does not upset the grouping into pings; they must hold still for `window` seconds.
    beacons : sequence of ArrivalTimes
        One a sync tag, of the same receivers, on the same clocks. Their places are those of the
        receivers with that `sync_tag`.
    method : "consensus", "cluster" or "closed-form"
        How each differenced problem is solved; the one with the largest consensus counts.
    multiple : bool
        Use the inliers of all beacon pings, offsets eliminated together, instead of the best one's.
    sigma : float or array (P, R), optional
        Standard deviation of an arrival's error, m; beacons' arrivals have its mean. Estimated
        from the pings when not given.
    depth, reach, region, prior
        As of `maloc.points.locate`; no terrain.
    most : int
        Beacon pings a ping.
    window, near : float
        Largest time to a beacon's ping, s; and within what time it is preferred.
    **options
        Of the method.

    Returns
    -------
    Points
        `emission` is on the mean of the clocks of the receivers used.

    Raises
    ------
    InputError
        If a beacon has no place, receivers differ, or no ping can be paired.

    References
    ----------
    Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife
    Tracking. Sensors 23: 9460, sections 1.2 and 2.1 to 2.3.
    """
    run = method_of(method)
    below, d = depths(toa, depth)
    each = np.broadcast_to(np.asarray(UNKNOWN if sigma is None else sigma, float), toa.toa.shape)
    known = _gather(toa, beacons, float(each.mean()))
    best = rank_beacons(toa.toa, known, most=most, window=window, near=near)
    ping, slot = np.nonzero(best >= 0)
    beacon = best[ping, slot]
    receivers = np.column_stack([toa.receivers.xy, toa.receivers.depth])
    ranges, spread = differenced(toa.toa, toa.sound_speed, each, receivers, known, ping, beacon)
    enough = np.isfinite(ranges).sum(axis=1) > d
    ping, slot, beacon, ranges, spread = (a[enough] for a in (ping, slot, beacon, ranges, spread))
    if not len(ping):
        raise InputError(
            f"no ping shares {d + 1} receivers with a sync tag's ping within {window:g} s",
            mend="widen window=, or synchronise the clocks (maloc.sync)",
        )
    reach = 2 * diameter(toa) if reach is None else reach
    if sigma is None:  # a difference has the errors of both
        one = slot == 0
        found_sd = spread_of(ranges[one], toa.receivers.xy, below[ping[one]], d, reach) / np.sqrt(2)
        each, spread = each * found_sd / UNKNOWN, spread * found_sd / UNKNOWN
        known = replace(known, sigma=known.sigma * found_sd / UNKNOWN)
    limits = {"reach": reach, "region": region, "prior": None}
    if prior is not None:
        limits["prior"] = checked_prior(prior, len(toa))[ping]
    problem, column = problem_of(ranges, toa.receivers.xy, below[ping], spread)
    found = run(problem, d, **accepted(run, method, limits, options))
    size = found.used.sum(axis=1)
    away = np.zeros(len(ping))
    if limits["prior"] is not None:
        away = np.nan_to_num(np.linalg.norm(found.position[:, :2] - limits["prior"], axis=1))
    order = np.lexsort((slot, away, found.ambiguous, -size, ping))
    rows, first = np.unique(ping[order], return_index=True)
    pick = order[first]
    mine = found.rows(pick)

    def spread_rows(a: np.ndarray) -> np.ndarray:
        out = np.zeros((len(toa), *a.shape[1:]), a.dtype)
        out[rows] = a[pick]
        return out

    whole = Problem(*(spread_rows(a) for a in problem))
    points = assemble(toa, method, mine, whole, spread_rows(column), rows, d)
    nothing = (points.why == "") & ~points.located
    points = points.replace(why=np.where(nothing, "no sync tag's ping to compare with", points.why))
    if multiple:
        points = _share(toa, points, known, best, each, receivers, below, options)
    sd = float(each.mean()) if sigma is None or np.ndim(sigma) == 0 else points.sigma
    return points.replace(emission=_emission(toa, points, below), sigma=sd)


def _gather(toa: ArrivalTimes, beacons: Sequence[ArrivalTimes], sigma: float) -> Beacons:
    """All sync tags' pings on the tag's origin, with their places."""
    times, places = [], []
    table = toa.receivers
    for one in beacons:
        if tuple(one.receivers.labels) != tuple(table.labels):
            raise InputError(f"sync tag {one.tag} has other receivers than tag {toa.tag}")
        at = [bool(s) and (one.tag == s or one.tag.endswith(f"-{s}")) for s in table.sync_tag]
        if not any(at):
            raise InputError(f"no receiver has sync tag '{one.tag}'")
        shift = ((one.origin or 0) - (toa.origin or 0)) / NS
        moment = np.nan_to_num(one.first) * NS + (one.origin or 0)
        place = np.full((len(one), 3), np.nan)
        for j in np.flatnonzero(at):
            now = (moment >= table.start[j]) & (moment < table.end[j])
            place[now] = table.x[j], table.y[j], table.depth[j]
        there = np.isfinite(place[:, 0])
        times.append(one.toa[there] + shift)
        places.append(place[there])
    if not times:
        raise InputError("no sync tags given")
    together = np.concatenate(times)
    return Beacons(together, np.concatenate(places), np.full(together.shape, sigma))


def _emission(toa: ArrivalTimes, points: Points, below: np.ndarray) -> np.ndarray:
    """Mean over the receivers used of arrival less travel, s."""
    d = points.position.shape[1]
    square = ((points.position[:, None, :2] - toa.receivers.xy) ** 2).sum(-1)
    drop = below if d == 2 else points.position[:, 2:] - below
    sent = toa.toa - np.sqrt(square + drop**2) / toa.sound_speed[:, None]
    used = points.inlier & np.isfinite(sent)
    total = np.where(used, sent, 0.0).sum(axis=1)
    return np.where(used.any(axis=1), total / np.maximum(used.sum(axis=1), 1), np.nan)


def _share(
    toa: ArrivalTimes,
    points: Points,
    beacons: Beacons,
    best: np.ndarray,
    sigma: np.ndarray,
    receivers: np.ndarray,
    below: np.ndarray,
    options: dict[str, Any],
) -> Points:
    """Least squares of the inliers of all beacon pings together, from the best one's position."""
    delta = float(options.get("delta", 3.0))
    d = points.position.shape[1]
    position, covariance = points.position.copy(), points.covariance.copy()
    count, inlier, rms = points.n_used.copy(), points.inlier.copy(), points.residual_rms.copy()
    for i in np.flatnonzero(points.located):
        k = best[i][best[i] >= 0]
        ranges, spread = differenced(
            toa.toa, toa.sound_speed, sigma, receivers, beacons, np.full(len(k), i), k
        )
        place = np.column_stack([receivers[:, :2], below[i]])
        step = np.pad(position[i], (0, 3 - d)) - place
        reach = ranges - np.linalg.norm(step, axis=1)
        late = np.abs(reach - np.nanmedian(reach, axis=1, keepdims=True))
        used = np.nan_to_num(late, nan=np.inf) <= delta * spread
        speed, start = toa.sound_speed[i], np.nanmin(toa.toa[i])
        away = distances_to(receivers, beacons.place[k])
        pseudo, precision = share_offsets(
            speed * (toa.toa[i] - start),
            sigma[i],
            speed * (beacons.toa[k] - start) - away,
            beacons.sigma[k],
            used,
        )
        position[i], covariance[i] = refine_shared(position[i], place, pseudo, precision)
        inlier[i], count[i] = used.any(axis=0), used.any(axis=0).sum()
        step = np.pad(position[i], (0, 3 - d)) - place
        left = pseudo - np.linalg.norm(step, axis=1)
        left = left[inlier[i]] - left[inlier[i]].mean()
        rms[i] = np.sqrt(np.mean(left**2)) if len(left) else np.nan
    return points.replace(
        position=position, covariance=covariance, n_used=count, inlier=inlier, residual_rms=rms
    )
