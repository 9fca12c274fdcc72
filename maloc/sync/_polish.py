"""Coarse clocks to about a millisecond before the joint fit, with the jumps that votes miss.

Clock by clock, what its arrivals say less what all clocks together say of each ping is a smooth
curve with steps. The largest step of a moment is taken first: it may be what shows in all others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.sync import _jumps
from maloc.sync._jumps import QUANTILE

__all__ = ["Jump", "polish"]

LEAST = 0.008  # smallest step that is looked for, s
NODE, ENOUGH = 1800.0, 8  # a piece of a curve is at least so long (s) and has so many detections
ROUNDS = 12
APART = 2 * 3600.0  # steps of two clocks nearer than this may be one, s
NEAR = 12  # detections within which two jumps of a clock are one
SIGMA, LATE = 2e-3, 0.15  # of arrivals about polished curves: sd (s), share that is late


class Jump(NamedTuple):
    """Clock, its first arrival after the jump in the time order of its arrivals, size (s)."""

    clock: int
    first: int
    size: float


class Polished(NamedTuple):
    """Jumps, and per clock the nodes (time, offset) of a piecewise linear curve; None = no data."""

    jumps: list[Jump]
    nodes: list[tuple[np.ndarray, np.ndarray] | None]


def polish(
    whole: np.ndarray,
    ping: np.ndarray,
    curve: np.ndarray,
    time: np.ndarray,
    rows: list[np.ndarray],
    jumps: list[Jump],
) -> Polished:
    """Sharpen curves and find steps.

    Parameters
    ----------
    whole : array (N,)
        Recorded less travel time, s; pings ascending.
    ping : array (N,) of int
    curve : array (N,)
        Coarse offset, jumps taken out, s.
    time : array (N,)
        Coarse common time, s.
    rows : list of int arrays
        Arrivals of each clock in time order.
    jumps : list of Jump
        Those known from votes.
    """
    clock = np.empty(len(whole), int)
    for j, mine in enumerate(rows):
        clock[mine] = j
    nodes: list[tuple[np.ndarray, np.ndarray] | None] = [None] * len(rows)
    curve = curve.copy()
    lines = [np.zeros(2)] * len(rows)
    for _ in range(ROUNDS):
        offset = _offsets(whole, ping, clock, curve, time, rows, jumps, nodes, lines)
        candidates = []
        for j, mine in enumerate(rows):
            if not len(mine):
                continue
            t, straight = time[mine], np.polyval(lines[j], time[mine])
            x, y = nodes[j] or (t, straight)
            curve[mine] = np.interp(t, x, y - np.polyval(lines[j], x)) + straight
            for first, size in _jumps.steps(t, offset[mine] - straight, LEAST, most=4):
                at = float(t[min(first, len(t) - 1)])
                candidates.append((abs(size), at, Jump(j, first, size)))
        jumps = _dated(rows, jumps, offset - curve)
        new: list[tuple[float, Jump]] = []
        for _, at, jump in sorted(candidates, key=lambda c: -c[0]):
            if all(abs(at - t) > APART for t, _ in new):
                new.append((at, jump))
        if not new:
            break
        jumps = joined(jumps + [jump for _, jump in new])
    # dating may have undone a jump at an end: curves as the jumps that are left want them
    _offsets(whole, ping, clock, curve, time, rows, jumps, nodes, lines)
    return Polished(jumps, nodes)


def _offsets(
    whole: np.ndarray,
    ping: np.ndarray,
    clock: np.ndarray,
    curve: np.ndarray,
    time: np.ndarray,
    rows: list[np.ndarray],
    jumps: list[Jump],
    nodes: list[tuple[np.ndarray, np.ndarray] | None],
    lines: list[np.ndarray],
) -> np.ndarray:
    """Offset that each arrival shows, jumps taken out (N,); writes nodes and straight lines."""
    flat = whole - lead(rows, jumps, len(whole))
    emission = _jumps.backfit(flat - curve, ping, clock)
    offset = flat - emission[ping]
    for _ in range(2):  # before and after what all share is taken off
        for j, mine in enumerate(rows):
            if len(mine):
                nodes[j], lines[j] = _nodes(time[mine], offset[mine])
        offset = offset - _shared(nodes, lines, time)
    return offset


def lead(rows: list[np.ndarray], jumps: list[Jump], n: int) -> np.ndarray:
    """Sum (N,) of the jumps before each arrival, s."""
    out = np.zeros(n)
    for jump in jumps:
        out[rows[jump.clock][jump.first :]] += jump.size
    return out


def joined(jumps: list[Jump], near: int = NEAR) -> list[Jump]:
    """Sorted; jumps of a clock within `near` arrivals are one, where the larger is."""
    out: list[Jump] = []
    for jump in sorted(jumps, key=lambda j: (j.clock, j.first)):
        if out and out[-1].clock == jump.clock and jump.first - out[-1].first <= near:
            larger = max(out[-1], jump, key=lambda j: abs(j.size))
            out[-1] = larger._replace(size=out[-1].size + jump.size)
        else:
            out.append(jump)
    return [j for j in out if abs(j.size) >= 0.5 * LEAST]


def _nodes(t: np.ndarray, d: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Nodes of low quantiles about a straight line, and the line (a polynomial in `t`)."""
    line = np.array([0.0, np.median(d)])
    if len(t) > 2 and np.ptp(t) > 0:
        middle = t.mean()
        slope, level = np.polyfit(t - middle, d, 1)
        line = np.array([slope, level - slope * middle])
    straight = np.polyval(line, t)
    bins = ((t - t[0]) / NODE).astype(int)
    cut = np.r_[0, np.flatnonzero(np.diff(bins)) + 1, len(t)]
    edges = [0]
    for c in cut[1:]:
        if c - edges[-1] >= ENOUGH:
            edges.append(int(c))
    if len(edges) == 1:
        edges.append(len(t))
    edges[-1] = len(t)
    x, y = [], []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        x.append(t[a:b].mean())
        y.append(np.sort((d - straight)[a:b])[int((b - a - 1) * QUANTILE)])
    x = np.maximum.accumulate(np.array(x))
    return (x, np.array(y) + np.polyval(line, x)), line


def _shared(
    nodes: list[tuple[np.ndarray, np.ndarray] | None], lines: list[np.ndarray], time: np.ndarray
) -> np.ndarray:
    """What most clocks do at a time besides drifting evenly (N,): the common time does it, s."""
    grid = np.arange(time.min(), time.max() + NODE, NODE / 2)
    bent = np.full((len(nodes), len(grid)), np.nan)
    for j, node in enumerate(nodes):
        if node is not None:
            x, y = node
            flat = np.interp(grid, x, y - np.polyval(lines[j], x))
            bent[j] = np.where((grid >= x[0] - NODE) & (grid <= x[-1] + NODE), flat, np.nan)
    heard = np.isfinite(bent).any(0)
    middle = np.zeros(len(grid))
    middle[heard] = np.nanmedian(bent[:, heard], axis=0)
    return np.interp(time, grid, middle)


def _dated(rows: list[np.ndarray], jumps: list[Jump], rest: np.ndarray) -> list[Jump]:
    """Move jumps to where the arrivals around them say."""
    out = []
    for n, jump in enumerate(jumps):
        mine = rows[jump.clock]
        own = [j.first for j in jumps if j.clock == jump.clock]
        at = own.index(jump.first)
        begin = own[at - 1] if at else 0
        end = own[at + 1] if at + 1 < len(own) else len(mine)
        best, *_ = _jumps.date(
            mine[begin:end], jumps[n].first - begin, jump.size, rest, SIGMA, LATE
        )
        if 0 < begin + best < len(mine):
            out.append(jump._replace(first=begin + best))
    return out
