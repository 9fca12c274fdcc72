"""Arrays, pings and arrival times with known truth, for the tests of point positions."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc import ArrivalTimes, Receivers

C = 1500.0


def ring(m, size=400.0, depth: Any = None):
    """Receivers on an uneven ring around the origin."""
    k = np.arange(m)
    angle = 2 * np.pi * (k + 0.2 * np.sin(3 * k)) / m
    radius = size * (1 + 0.2 * np.cos(5 * k))
    xy = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    depth = None if depth is None else np.broadcast_to(depth, (m,))
    return Receivers(np.array([f"R{i}" for i in k]), xy[:, 0], xy[:, 1], depth)


def arrivals(
    receivers,
    xy,
    *,
    depth: Any = None,
    sent: Any = None,
    noise: Any = 0.0,
    late: Any = None,
    heard: Any = None,
    **fields: Any,
):
    """Arrival times of pings at points (P, 2); `noise` and `late` (P, R) in m."""
    square = ((xy[:, None] - receivers.xy) ** 2).sum(-1)
    if depth is not None:
        square = square + (receivers.depth - np.broadcast_to(depth, (len(xy),))[:, None]) ** 2
    sent = 60.0 * np.arange(len(xy)) if sent is None else sent
    reach = np.sqrt(square) + noise + (0.0 if late is None else late)
    toa = sent[:, None] + reach / C
    if heard is not None:
        toa = np.where(heard, toa, np.nan)
    return ArrivalTimes(toa, receivers, np.full(len(toa), C), **fields)


def error(points, xy):
    """Distance (P,) from the truth, m."""
    return np.linalg.norm(points.position[:, :2] - xy, axis=1)
