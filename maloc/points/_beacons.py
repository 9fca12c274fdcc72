"""Constraints against transmitters at known places, for clocks that were never brought together.

A receiver's clock offset is the same for a tag's ping and for a beacon's (a sync tag's) shortly
before or after, so it is gone from the difference of the two arrivals: what is left is a range
plus one unknown that all receivers share (Arnon et al. 2023, eq. 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.errors import InputError

__all__ = ["Beacons", "differenced", "distances_to", "rank_beacons"]


@dataclass(frozen=True, eq=False)
class Beacons:
    """Pings of transmitters at known places, in time order.

    Parameters
    ----------
    toa : array (B, R)
        When each receiver heard each, s from the tags' origin, each on its own clock; NaN = not.
    place : array (B, 3)
        x, y and depth of the transmitter, m; a depth that plays no part is NaN.
    sigma : array (B, R)
        Standard deviation of the arrival's error, m.

    Raises
    ------
    InputError
        If shapes do not agree.
    """

    toa: np.ndarray
    place: np.ndarray
    sigma: np.ndarray

    def __post_init__(self) -> None:
        toa = np.asarray(self.toa, float)
        if toa.ndim != 2 or np.shape(self.place) != (len(toa), 3):
            raise InputError("beacons' toa must be (B, R) and their place (B, 3)")
        order = np.argsort(_middle(toa), kind="stable")
        sigma = np.broadcast_to(np.asarray(self.sigma, float), toa.shape)
        object.__setattr__(self, "toa", toa[order])
        object.__setattr__(self, "place", np.asarray(self.place, float)[order])
        object.__setattr__(self, "sigma", sigma[order])


def _middle(toa: np.ndarray) -> np.ndarray:
    """Median arrival (P,); inf where nothing was heard."""
    filled = np.sort(np.where(np.isfinite(toa), toa, np.inf), axis=1)
    count = np.isfinite(toa).sum(axis=1)
    return filled[np.arange(len(toa)), np.maximum(count - 1, 0) // 2]


def rank_beacons(
    toa: np.ndarray,
    beacons: Beacons,
    *,
    most: int = 5,
    window: float = 5.0,
    near: float = 2.0,
) -> np.ndarray:
    """Return the best beacon pings for each ping: index (P, most), -1 where there are no more.

    By the number of receivers that heard both, then whether the two were less than `near` apart,
    then the beacon's mean variance at those receivers, then the time between them.

    Parameters
    ----------
    toa : array (P, R)
        The tag's arrivals, s.
    beacons : Beacons
    most : int
        Beacon pings a ping.
    window : float
        Largest time between a ping and a beacon's, s ("a few seconds").
    near : float
        Beacons within this time (s) are preferred to those beyond.
    """
    n, first = len(toa), _middle(beacons.toa)
    when, heard = _middle(toa), np.isfinite(toa)
    # raw clocks may differ by more than a few ms: one second more than asked is looked through
    low = np.searchsorted(first, when - window - 1)
    high = np.where(np.isfinite(when), np.searchsorted(first, when + window + 1), low)
    out = np.full((n, most), -1)
    for rows in np.array_split(np.arange(n), max(1, int((high - low).sum()) // 200_000)):
        count: np.ndarray = (high - low)[rows]
        ping = np.repeat(rows, count)
        before = np.repeat(low[rows] - np.cumsum(count) + count, count)
        beacon = before + np.arange(len(before))
        both = heard[ping] & np.isfinite(beacons.toa[beacon])
        shared = both.sum(axis=1)
        with np.errstate(invalid="ignore"):
            gap = np.abs(_middle(np.where(both, toa[ping] - beacons.toa[beacon], np.nan)))
        keep = (shared > 0) & (gap <= window)
        ping, beacon, both, shared, gap = (a[keep] for a in (ping, beacon, both, shared, gap))
        variance = np.where(both, beacons.sigma[beacon] ** 2, 0.0).sum(axis=1) / shared
        order = np.lexsort((gap, variance, gap >= near, np.negative(shared), ping))
        ping, beacon = ping[order], beacon[order]
        place = np.arange(len(ping)) - np.asarray(np.searchsorted(ping, ping))
        chosen = place < most
        out[ping[chosen], place[chosen]] = beacon[chosen]
    return out


def differenced(
    toa: np.ndarray,
    speed: np.ndarray,
    sigma: np.ndarray,
    receivers: np.ndarray,
    beacons: Beacons,
    ping: np.ndarray,
    beacon: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Ranges of the differenced constraints of N pairs of pings, and their standard deviations.

    Parameters
    ----------
    toa : array (P, R)
        The tag's arrivals, s, each on its receiver's clock.
    speed : array (P,)
        Sound speed, m/s.
    sigma : array (P, R)
        Standard deviation of the tag's arrivals, m.
    receivers : array (R, 3)
        x, y, depth, m.
    beacons : Beacons
    ping, beacon : array (N,) of int
        The pairs.

    Returns
    -------
    ranges, sigma : array (N, R)
        c (t_ir - t_br) + |receiver - beacon| less the pair's smallest, m (NaN where either did not
        hear), and the root of the sum of the two variances.
    """
    step = (toa[ping] - beacons.toa[beacon]) * speed[ping][:, None]
    ranges = step + distances_to(receivers, beacons.place[beacon])
    least = np.where(np.isfinite(ranges), ranges, np.inf).min(axis=1, keepdims=True)
    ranges = ranges - np.where(np.isfinite(least), least, 0.0)
    return ranges, np.hypot(sigma[ping], beacons.sigma[beacon])


def distances_to(receivers: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Distances (N, R) m; depths that are not known play no part."""
    offset = place[:, None] - receivers[None]
    return np.sqrt((np.nan_to_num(offset) ** 2).sum(-1))
