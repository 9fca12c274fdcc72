"""Fine grid of the renewal equation and its quadrature weights (NumPy, once a data set).

Time s runs away from a heard ping: forward in "inside" and "after" gaps, backward in "before" gaps
(the sum over missed pings is the same read either way). All gaps then share one recursion

    H_i = sum_k A_ik q_k + sum_d beta_d q_(i-d) H_(i-d),   G = f + H,

at s_i = lo + i step, and differ in the end row alone: c0 + first . q + later . (q H). Products are
linear between nodes; weights are Gauss-Legendre between all break points, so jumps are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.schedule.intervals import Table

__all__ = [
    "Grid",
    "end_rows",
    "first_size",
    "grid_of",
    "recursion",
]

_GAUSS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Grid:
    """Where a law's renewal equation is solved.

    Attributes
    ----------
    start, step : float
        First node and distance of the nodes, s.
    block : int
        Nodes that are solved at once: none of them depends on another.
    coarse : int
        Steps from one knot of the path to the next.
    """

    start: float
    step: float
    block: int
    coarse: int

    @property
    def path_step(self) -> float:
        """Distance of the path's knots, s."""
        return self.coarse * self.step


def grid_of(law) -> Grid:
    """Grid of a law: an eighth of its shortest interval or less, knots about a shortest apart."""
    finest = min(law.mean / 12, (law.hi - law.lo) / 8)
    block = int(np.ceil(law.lo / finest - 1e-9))
    step = law.lo / block if block else finest
    if block and step < 0.5 * finest:  # a limit near 0: nodes depend on their own block
        step, block = finest, 0
    coarse = max(round(max(law.lo, law.mean / 2) / step), 1)
    return Grid(law.lo, step, max(block, 1), coarse)


def _row(edges, f, size, grid: Grid) -> np.ndarray:
    """Integrals of f(s, gap) times each node's hat, (N, size); f is smooth between `edges`."""
    edges = np.sort(edges, axis=1)
    half = np.diff(edges, axis=1)[..., None] / 2
    at = (edges[:, :-1] + edges[:, 1:])[..., None] / 2 + half * _GAUSS[0]
    value = f(at) * half * _GAUSS[1]
    place = (at - grid.start) / grid.step
    cell = np.clip(np.floor(place), 0, max(size - 2, 0)).astype(int)
    share = place - cell if size > 1 else np.zeros_like(place)
    flat = np.arange(len(edges))[:, None, None] * size + cell
    total = len(edges) * size
    out = np.bincount(flat.ravel(), (value * (1 - share)).ravel(), total)
    if size > 1:
        out += np.bincount(flat.ravel() + 1, (value * share).ravel(), total)
    return out.reshape(len(edges), size)


def _clipped(points, low, high):
    """Break points (N, P) and both ends, moved into each gap's range."""
    inside = np.clip(points, low[:, None], high[:, None])
    return np.concatenate([low[:, None], inside, high[:, None]], axis=1)


def end_rows(duration, law: Table, grid: Grid, size: int, end, end_breaks, end_reach: float):
    """End row of each gap: (c0 (N,), first (N, F), later (N, size)).

    Parameters
    ----------
    duration : (N,) s
    law : Table
        Law of the interval.
    grid : Grid
    size : int
        Nodes.
    end : callable
        What closes the gap, of the time since the last missed ping: density, survival or the
        first ping's density.
    end_breaks : tuple of float
        Where `end` is not smooth, s.
    end_reach : float
        Beyond it `end` is zero, s.
    """
    duration = np.asarray(duration, float)
    n = len(duration)
    nodes = grid.start + grid.step * np.arange(size)
    ends = duration[:, None] - np.asarray(end_breaks)
    low = np.maximum(grid.start, duration - end_reach)
    width = first_size(law, grid, size)

    def first(s):
        return law.density(s) * end(duration[:, None, None] - s)

    points = np.broadcast_to(np.concatenate([nodes[:width], law.breaks]), (n, width + len(law.x)))
    top = np.maximum(np.minimum(law.hi, duration), low)
    first_row = _row(_clipped(np.hstack([points, ends]), low, top), first, width, grid)
    top = np.maximum(np.minimum(duration, nodes[-1]), low)
    points = np.broadcast_to(nodes, (n, size))
    later_row = _row(
        _clipped(np.hstack([points, ends]), low, top),
        lambda s: end(duration[:, None, None] - s),
        size,
        grid,
    )
    return end(duration), first_row, later_row


def first_size(law: Table, grid: Grid, size: int) -> int:
    """Nodes that the first interval after a heard ping can reach."""
    return min(size, int(np.ceil((law.hi - law.lo) / grid.step - 1e-9)) + 1)


def recursion(law: Table, grid: Grid, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights that all gaps share: A (rows, F), blocks of beta (lags, block, block), its diagonal.

    Rows of A are whole blocks, up to twice the longest interval; ``beta[j][c, r]`` takes q H at
    node c of a block to H at node r of the block j + 1 later.
    """
    m = grid.block
    blocks = size // m
    reach = int(np.ceil((2 * law.hi - law.lo) / grid.step / m - 1e-9)) + 1
    rows = min(blocks, reach) * m
    at = grid.start + grid.step * np.arange(rows)
    _, a, _ = end_rows(at, law, grid, size, law.density, law.breaks, law.hi)
    widest = int(np.floor(law.hi / grid.step + 1e-9)) + 1
    beta = _lags(law, grid.step, widest)
    lags = min(-(-(widest + m - 1) // m), max(blocks - 1, 0))
    c, r = np.indices((m, m))
    lag = (np.arange(1, lags + 1) * m)[:, None, None] + (r - c)[None]
    inside = (lag >= 0) & (lag <= widest)
    shared = np.where(inside, beta[np.clip(lag, 0, widest)], 0.0)
    return a, shared, beta[0] if m == 1 else np.zeros(())


def _lags(law: Table, step: float, widest: int) -> np.ndarray:
    """beta_d: integral of f(x) times the hat around d steps, d = 0..widest."""
    cells = np.arange(widest + 1) * step
    points = np.concatenate([cells, law.breaks])[None]
    low, high = np.array([law.lo]), np.array([min(law.hi, cells[-1])])
    grid = Grid(0.0, step, 1, 1)
    return _row(_clipped(points, low, high), law.density, widest + 1, grid)[0]
