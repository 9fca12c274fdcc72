"""Normal equations of the clock model: emission times projected out, block-tridiagonal in time.

The unknowns of a knot are one block: offset and slope of every clock but the reference, and, where
the sound speed varies, its deviation. What all knots share (mean slowness, delays, jumps, places)
is a dense border; its derivatives are the same for all arrivals of a link, so that sums over links
serve. Everything is linear in the number of arrivals, and worked through in stretches of knots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from maloc.sync import _blocks

__all__ = ["Normal", "Step", "Unknowns", "normal_equations", "solve_bordered"]

STRETCH = 40_000  # arrivals worked through at a time


class Unknowns(NamedTuple):
    """Where the arrivals and the unknowns stand.

    Attributes
    ----------
    knot : array (N,) of int
        Knot before the arrival's ping, ascending.
    ping : array (N,) of int
        Ascending.
    clock : array (N,) of int
        Number of the arrival's clock among those that are free, -1 = the reference.
    link : array (N,) of int
    link_clock : array (L,) of int
        As `clock`, ascending but for the reference's.
    n_knots, n_clocks : int
    varying : bool
        Whether the sound speed has a deviation at each knot.
    """

    knot: np.ndarray
    ping: np.ndarray
    clock: np.ndarray
    link: np.ndarray
    link_clock: np.ndarray
    n_knots: int
    n_clocks: int
    varying: bool

    @property
    def size(self) -> int:
        """Number of unknowns of a knot."""
        return 2 * self.n_clocks + self.varying


class Normal(NamedTuple):
    """Normal equations: blocks of the knots, the border, and both right-hand sides."""

    diag: np.ndarray  # (K, n, n)
    off: np.ndarray  # (K - 1, n, n)
    side: np.ndarray  # (K, n, B)
    corner: np.ndarray  # (B, B)
    rhs: np.ndarray  # (K, n)
    rhs_border: np.ndarray  # (B,)


class Step(NamedTuple):
    """One Gauss-Newton step, and covariances at it."""

    knots: np.ndarray  # (K, n)
    border: np.ndarray  # (B,)
    cov: np.ndarray  # (K, n, n)
    cross: np.ndarray  # (K - 1, n, n) with the next knot
    cov_border: np.ndarray  # (K, n, B)
    border_cov: np.ndarray  # (B, B)
    factor: _blocks.BlockFactor
    through: np.ndarray  # (K, n, B)


def normal_equations(
    u: Unknowns,
    hermite: np.ndarray,
    speed: np.ndarray | None,
    border: np.ndarray,
    precision: np.ndarray,
    residual: np.ndarray,
) -> Normal:
    """Sum up A' W A - A' W E (E' W E)^-1 E' W A, border and right-hand sides likewise.

    Parameters
    ----------
    u : Unknowns
    hermite : array (N, 4)
        Derivative of the recorded time to offset and slope of the clock at both knots.
    speed : array (N, 2), optional
        The same to the sound speed's deviation at both knots, s.
    border : array (L, B)
        The same to the border, a row a link.
    precision, residual : array (N,)
        Residuals have mean zero in each ping, so that there is nothing to project.
    """
    n, n_border = u.size, border.shape[1]
    e = Normal(
        np.zeros((u.n_knots, n, n)),
        np.zeros((u.n_knots - 1, n, n)),
        np.zeros((u.n_knots, n, n_border)),
        np.zeros((n_border, n_border)),
        np.zeros((u.n_knots, n)),
        np.zeros(n_border),
    )
    edge = np.searchsorted(u.knot, np.arange(u.n_knots))  # (K,) first arrival of each interval
    edge[-1] = len(u.knot)
    first = 0
    while first < u.n_knots - 1:
        last = int(np.searchsorted(edge, edge[first] + STRETCH, "right")) - 1
        last = min(max(last, first + 1), u.n_knots - 1)
        if edge[last] > edge[first]:
            rows = slice(int(edge[first]), int(edge[last]))
            _add(e, u, rows, first, last - first, edge[first : last + 1],
                 hermite[rows], None if speed is None else speed[rows], border,
                 precision[rows], residual[rows])  # fmt: skip
        first = last
    weight = np.bincount(u.link, precision, len(border))
    e.corner[:] += border.T @ (weight[:, None] * border)
    e.rhs_border[:] = np.bincount(u.link, precision * residual, len(border)) @ border
    return e


def _add(e, u: Unknowns, rows, first: int, m: int, edge, h, v, border, w, r) -> None:
    """Add the arrivals of `m` intervals between knots, from knot `first` on."""
    n, n_clocks, n_links = u.size, u.n_clocks, len(border)
    k, link = u.knot[rows] - first, u.link[rows]
    moving = u.clock[rows] >= 0
    clock = u.clock[rows][moving]
    base, wh = k[moving] * n_clocks + clock, w[moving, None] * h[moving]
    # columns of an interval: those of the knot before, then those of the knot after
    column = [2 * np.arange(n_clocks) + a % 2 + n * (a // 2) for a in range(4)]
    block, rhs = np.zeros((m, 2 * n, 2 * n)), np.zeros((m, 2 * n))
    side = np.zeros((m, 2 * n, border.shape[1]))
    at_link = k * n_links + link

    def by_clock(x: np.ndarray) -> np.ndarray:
        return np.bincount(base, x, m * n_clocks).reshape(m, n_clocks)

    split = np.searchsorted(u.link_clock, np.arange(n_clocks + 1))
    for a in range(4):
        for b in range(a, 4):
            total = by_clock(wh[:, a] * h[moving, b])
            block[:, column[a], column[b]] = total
            block[:, column[b], column[a]] = total
        rhs[:, column[a]] = by_clock(wh[:, a] * r[moving])
        sums = np.bincount(at_link[moving], wh[:, a], m * n_links).reshape(m, n_links)
        for c in range(n_clocks):
            mine = slice(split[c], split[c + 1])
            side[:, column[a][c]] = sums[:, mine] @ border[mine]
    if v is not None:
        own = [n - 1, 2 * n - 1]
        for a in range(2):
            wv = w * v[:, a]
            for b in range(2):
                block[:, own[a], own[b]] = np.bincount(k, wv * v[:, b], m)
            for b in range(4):
                total = by_clock(wv[moving] * h[moving, b])
                block[:, own[a], column[b]] = total
                block[:, column[b], own[a]] = total
            rhs[:, own[a]] = np.bincount(k, wv * r, m)
            side[:, own[a]] = np.bincount(at_link, wv, m * n_links).reshape(m, -1) @ border

    # means over the arrivals of each ping, times the root of its precision
    ping = u.ping[rows] - u.ping[rows.start]
    n_pings = int(ping[-1]) + 1
    root = 1 / np.sqrt(np.bincount(ping, w, n_pings))
    mean = np.zeros((n_pings, 2 * n))
    scaled = wh * root[ping[moving], None]
    for a in range(4):
        mean[ping[moving], column[a][clock]] = scaled[:, a]  # one arrival a receiver and ping
    if v is not None:
        for a in range(2):
            mean[:, own[a]] = np.bincount(ping, w * v[:, a], n_pings) * root
    entries = (w * root[ping], (ping, link))
    mean_border = sp.csr_matrix(entries, shape=(n_pings, n_links)) @ border
    begin = np.append(ping, n_pings)[edge - edge[0]]
    for i in range(m):
        own_mean, own_border = mean[begin[i] : begin[i + 1]], mean_border[begin[i] : begin[i + 1]]
        block[i] -= own_mean.T @ own_mean
        side[i] -= own_mean.T @ own_border
    e.corner[:] -= mean_border.T @ mean_border

    e.diag[first : first + m] += block[:, :n, :n]
    e.diag[first + 1 : first + m + 1] += block[:, n:, n:]
    e.off[first : first + m] += block[:, :n, n:]
    e.side[first : first + m] += side[:, :n]
    e.side[first + 1 : first + m + 1] += side[:, n:]
    e.rhs[first : first + m] += rhs[:, :n]
    e.rhs[first + 1 : first + m + 1] += rhs[:, n:]


def solve_bordered(e: Normal) -> Step:
    """Solve the normal equations, and invert what is needed of them.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not positive definite.
    """
    factor = _blocks.factor(e.diag, e.off)
    both = _blocks.solve(factor, np.concatenate([e.rhs[..., None], e.side], axis=2))
    plain, through = both[..., 0], both[..., 1:]
    flat, n_border = through.reshape(-1, through.shape[-1]), len(e.corner)
    corner = e.corner - e.side.reshape(-1, n_border).T @ flat
    border_cov = np.linalg.inv(0.5 * (corner + corner.T))
    border = border_cov @ (e.rhs_border - e.side.reshape(-1, n_border).T @ plain.ravel())
    inverse, inverse_off = _blocks.selected_inverse(factor)
    spread = through @ border_cov
    return Step(
        plain - through @ border,
        border,
        inverse + spread @ through.swapaxes(-1, -2),
        inverse_off + spread[:-1] @ through[1:].swapaxes(-1, -2),
        -spread,
        border_cov,
        factor,
        through,
    )
