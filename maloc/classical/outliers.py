"""What cannot be: filters by speed, turning angle, an error measure, land and burst interval.

References
----------
McConnell, Chambers & Fedak (1992) Antarctic Science 4: 393-398 (speed).
Austin, McMillan & Bowen (2003) Marine Mammal Science 19: 371-383 (two stages).
Freitas, Lydersen, Fedak & Kovacs (2008) Marine Mammal Science 24: 315-325 (three stages).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes

__all__ = [
    "Screened",
    "interval_filter",
    "land_filter",
    "speed_filter",
    "three_stage_filter",
    "threshold_filter",
    "two_stage_filter",
]

_SHARP = 165.0  # degrees


class Screened(NamedTuple):
    """What a filter leaves: ``keep`` (P,) bool, and ``why`` (P,) str, "" where it is kept.

    Pings without a position are kept out with the reason "no position".
    """

    keep: np.ndarray
    why: np.ndarray

    def __str__(self) -> str:
        reasons, counts = np.unique(self.why[~self.keep], return_counts=True)
        parts = [f"{n} {reason}" for reason, n in zip(reasons, counts, strict=True)]
        return f"{self.keep.sum()} of {len(self.keep)} kept" + "".join(f"; {p}" for p in parts)


def speed_filter(time: Any, xy: Any, limit: float, *, neighbours: int = 2) -> Screened:
    """Take out positions that are only reached and left too fast.

    Parameters
    ----------
    time : (P,) array
        s, ascending.
    xy : (P, 2) array
        m; NaN where there is none.
    limit : float
        Highest speed, m/s: of root mean squares over the neighbours.
    neighbours : int
        On each side: 2 as McConnell et al. have it, 1 for burst speeds.

    Returns
    -------
    Screened

    Raises
    ------
    InputError
        If times do not ascend, shapes differ, or `limit` or `neighbours` is not positive.

    Notes
    -----
    Round by round the worst position of each run of too fast ones goes, until none is too fast.
    """
    time, xy, why = _checked(time, xy, limit)
    if neighbours < 1:
        raise InputError(f"{neighbours} neighbours: give 1 or more")
    _drop_fast(time, xy, why, limit, neighbours)
    return _screened(why)


def two_stage_filter(time: Any, xy: Any, limit: float, *, neighbours: int = 2) -> Screened:
    """Take out positions whose speeds to all four neighbours are too high, then `speed_filter`.

    Parameters, errors and result as in `speed_filter`; Austin et al. (2003).
    """
    time, xy, why = _checked(time, xy, limit)
    rows = np.flatnonzero(why == "")
    speed = _speeds(time[rows], xy[rows], 2)
    # at the ends fewer neighbours are all there are; one alone proves nothing
    whole = np.isfinite(speed).sum(axis=1) >= 2
    why[rows[whole & (np.nan_to_num(speed, nan=np.inf) > limit).all(axis=1)]] = "all speeds"
    _drop_fast(time, xy, why, limit, neighbours)
    return _screened(why)


def three_stage_filter(
    time: Any, xy: Any, limit: float, *, neighbours: int = 2, angle: float = _SHARP
) -> Screened:
    """Take out what `two_stage_filter` does, then positions where the track turns back on itself.

    Parameters
    ----------
    time, xy, limit, neighbours
        See `speed_filter`.
    angle : float
        Largest turning angle, degrees (165): 0 is straight on, 180 straight back.

    Returns
    -------
    Screened

    Raises
    ------
    InputError
        As `speed_filter`; or if `angle` is not within 0 to 180.
    """
    if not 0 < angle <= 180:
        raise InputError(f"angle {angle:g} is not within 0 to 180 degrees")
    first = two_stage_filter(time, xy, limit, neighbours=neighbours)
    why, xy = first.why.astype(object), np.asarray(xy, float)
    rows = np.flatnonzero(first.keep)
    step = np.diff(xy[rows], axis=0)
    length = np.linalg.norm(step, axis=1)
    along = np.sum(step[:-1] * step[1:], axis=1)
    product = length[:-1] * length[1:]
    turned = np.degrees(np.arccos(np.clip(along / np.where(product > 0, product, 1.0), -1.0, 1.0)))
    why[rows[1:-1][(turned > angle) & (product > 0)]] = "turning angle"
    return _screened(why)


def threshold_filter(measure: Any, limit: float) -> Screened:
    """Take out positions whose error measure (HPE, say) is above a limit, or unknown.

    Parameters
    ----------
    measure : (P,) array
        NaN: no position.
    limit : float
        Largest that is kept.
    """
    value = np.asarray(measure, float)
    why = np.where(np.isnan(value), "no position", np.where(value > limit, "error measure", ""))
    return _screened(why)


def land_filter(xy: Any, water: Any) -> Screened:
    """Take out positions that are not in the water.

    Parameters
    ----------
    xy : (P, 2) array
        m; NaN where there is none.
    water : polygon
        Corners (V, 2) m, or a Shapely or GeoJSON polygon.

    Raises
    ------
    InputError
        If it is no polygon.
    """
    from maloc.biology.space import inside

    xy = np.asarray(xy, float)
    why = np.where(np.isfinite(xy).all(axis=1), "", "no position")
    rows = np.flatnonzero(why == "")
    why = why.astype(object)
    why[rows[~inside(xy[rows], water)]] = "on land"
    return _screened(why)


def interval_filter(toa: ArrivalTimes, shortest: float | None = None) -> Screened:
    """Take out pings that follow another sooner than the tag can have sent them.

    Of pings too near each other those stay that most receivers heard, of equals the earlier: a
    reflection that arrives late enough to look like a ping is heard by fewer.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings of one tag.
    shortest : float, optional
        Shortest interval between emissions, s; that of the schedule when not given.

    Returns
    -------
    Screened
        Pings that nobody heard are kept out with the reason "not heard".

    Raises
    ------
    InputError
        If the shortest interval is not known, or not positive.

    Notes
    -----
    First arrivals may be nearer than emissions by what sound takes across the array. What a
    receiver hears too soon after itself, and detections of a single receiver, are set aside before,
    by `maloc.data.prepare` and `maloc.toa_matrix`.
    """
    from maloc.data._screen import TOO_SOON, _heaviest

    shortest = toa.schedule.shortest if shortest is None else shortest
    if not shortest > 0:
        raise InputError("the shortest burst interval is not known", mend="give it, in s")
    count = toa.n_heard
    why = np.where(count > 0, "", "not heard").astype(object)
    rows = np.flatnonzero(count > 0)
    if len(rows):
        first = np.nanmin(toa.toa[rows], axis=1)
        rows, first = rows[np.argsort(first, kind="stable")], np.sort(first)
        across = np.linalg.norm(np.ptp(toa.receivers.xy, axis=0)) / np.min(toa.sound_speed)
        keep = _heaviest(first, count[rows].astype(float), shortest - across)
        why[np.delete(rows, keep)] = TOO_SOON
    return _screened(why)


def _checked(time: Any, xy: Any, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    time, xy = np.asarray(time, float), np.asarray(xy, float)
    if time.ndim != 1 or xy.shape != (len(time), 2):
        raise InputError(f"time (P,) and xy (P, 2) are wanted, got {time.shape} and {xy.shape}")
    if not limit > 0:
        raise InputError(f"limit {limit:g} is no speed")
    there = np.isfinite(xy).all(axis=1) & np.isfinite(time)
    if np.any(np.diff(time[there]) <= 0):
        raise InputError("times do not ascend", mend="sort the positions, each time once")
    return time, xy, np.where(there, "", "no position").astype(object)


def _screened(why: np.ndarray) -> Screened:
    why = why.astype(str)
    return Screened(why == "", why)


def _speeds(time: np.ndarray, xy: np.ndarray, neighbours: int) -> np.ndarray:
    """Speeds (P, 2 neighbours) to the neighbours, m/s; NaN beyond the ends."""
    n = len(time)
    out = np.full((n, 2 * neighbours), np.nan)
    for k in range(1, neighbours + 1):
        if n > k:
            speed = np.linalg.norm(xy[k:] - xy[:-k], axis=1) / (time[k:] - time[:-k])
            out[:-k, 2 * k - 2], out[k:, 2 * k - 1] = speed, speed
    return out


def _drop_fast(
    time: np.ndarray, xy: np.ndarray, why: np.ndarray, limit: float, neighbours: int
) -> None:
    while len(rows := np.flatnonzero(why == "")) > 2:
        squared = _speeds(time[rows], xy[rows], neighbours) ** 2
        mean = np.sqrt(np.nanmean(squared, axis=1))
        fast = np.flatnonzero(mean > limit)
        if not len(fast):
            break
        for run in np.split(fast, np.flatnonzero(np.diff(fast) > 1) + 1):
            why[rows[run[np.argmax(mean[run])]]] = "speed"
