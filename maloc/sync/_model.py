"""The joint clock model: all clocks, the sound speed and the receivers' places in one fit.

A sync ping p, emitted at common time e_p by the tag beside deployment g, is recorded by receiver r
(at deployment j) as

    recorded = t + offset_r(t) + error,    t = e_p + |x_j - x_g| / c.

Offsets are cubic Hermite curves between knots (`_curve`) with an integrated-random-walk prior
(`_prior`); the weight of an arrival is its probability of the direct path (`_arrivals`, EM).
Emission times are eliminated ping by ping, so the normal matrix is block-tridiagonal in the knots
(all clocks of a knot are one block) with a narrow dense border for sound speed and places: the
cost is linear in the length of the record.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from maloc.sync import _blocks
from maloc.sync._arrivals import (
    BACKGROUND,
    Arrivals,
    Geometry,
    distances,
    low_quantile,
    p_direct,
    travel_derivative,
)
from maloc.sync._curve import hermite, to_common
from maloc.sync._prior import Q_START, ClockPrior

__all__ = ["Solution", "solve"]

ANNEAL = (0.05, 0.02, 0.01, 0.005, 0.002)  # error sd of the first rounds, s
LEAST_SIGMA = 2e-5  # s
LEAST_WEIGHT = 1e-9  # keeps the emission time of a ping without any direct arrival
FARTHEST = 3.0  # places move at most so far in one round, m: distances are not linear


class Solution(NamedTuple):
    """Result of `solve`.

    Attributes
    ----------
    state, state_sd : array (K, R, 2)
        Offset, and slope times spacing, at the knots, s; 0 for the reference.
    xyz, xy_sd : array (D, 3), array (D, 2)
        Places and their posterior sd (0 where held), m.
    sound_speed, sound_speed_sd : float
    sigma, reflected : float
        Error sd of direct arrivals (s), share of late ones.
    intensity : array (R,)
        Clock noise, s^2/s^3; 0 for the reference.
    emission : array (P,)
        Emission times on the common clock, s.
    residual, p_direct : array (N,)
    rounds : int
    converged : bool
    """

    state: np.ndarray
    state_sd: np.ndarray
    xyz: np.ndarray
    xy_sd: np.ndarray
    sound_speed: float
    sound_speed_sd: float
    sigma: float
    reflected: float
    intensity: np.ndarray
    emission: np.ndarray
    residual: np.ndarray
    p_direct: np.ndarray
    rounds: int
    converged: bool


class _Normal(NamedTuple):
    """Normal equations: blocks of the knots, the border, and both right-hand sides."""

    diag: np.ndarray  # (K, n, n)
    off: np.ndarray  # (K - 1, n, n)
    side: np.ndarray  # (K, n, B)
    corner: np.ndarray  # (B, B)
    rhs: np.ndarray  # (K, C, 2)
    rhs_border: np.ndarray  # (B,)


class _Layout(NamedTuple):
    """Where the unknowns stand."""

    arrivals: Arrivals
    geometry: Geometry
    first: float
    spacing: float
    n_knots: int
    free: np.ndarray  # (C,) clocks other than the reference
    column: np.ndarray  # (R,) first column of a clock in its block, -1 = reference
    by_ping: sp.csr_matrix  # (P, N) sums over the arrivals of a ping


def _design(u: _Layout, common: np.ndarray, emission: np.ndarray) -> sp.csr_matrix:
    """Derivative (N, K n) of the recorded time to the knots."""
    a, n = u.arrivals, 2 * len(u.free)
    # all arrivals of a ping share its pair of knots, so that blocks couple neighbours only
    k = np.clip(((emission - u.first) / u.spacing).astype(int), 0, u.n_knots - 2)[a.ping]
    moving = np.flatnonzero(u.column[a.receiver] >= 0)
    weights = hermite((common - u.first) / u.spacing - k)[moving]
    base = (k * n + u.column[a.receiver])[moving]
    columns = (base[:, None] + np.array([0, 1, n, n + 1])).ravel()
    entries = (weights.ravel(), (np.repeat(moving, 4), columns))
    return sp.csr_matrix(entries, shape=(len(common), u.n_knots * n))


def _blocks_of(matrix: sp.csr_matrix, n_knots: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal and upper off-diagonal blocks of a block-tridiagonal sparse matrix."""
    m = matrix.tocoo()
    k, i, away, j = m.row // n, m.row % n, m.col // n - m.row // n, m.col % n
    diag, off = np.zeros((n_knots, n, n)), np.zeros((n_knots - 1, n, n))
    same, up = away == 0, away == 1
    diag[k[same], i[same], j[same]] = m.data[same]
    off[k[up], i[up], j[up]] = m.data[up]
    return diag, off


def _normal_equations(
    u: _Layout, design: sp.csr_matrix, border: sp.csr_matrix, precision, residual
) -> _Normal:
    """Project the emission times out: A' W A - A' W E (E' W E)^-1 E' W A, the border likewise."""
    n_clocks = len(u.free)
    total = u.by_ping @ precision
    mean = sp.diags(1 / np.sqrt(total)) @ u.by_ping @ sp.diags(precision)
    mean_design, mean_border = (mean @ design).tocsr(), (mean @ border).toarray()
    weighted = sp.diags(precision)
    normal = (design.T @ (weighted @ design) - mean_design.T @ mean_design).tocsr()
    weighted_border = weighted @ border
    side = (design.T @ weighted_border).toarray() - mean_design.T @ mean_border
    corner = (border.T @ weighted_border).toarray() - mean_border.T @ mean_border
    # residuals have mean zero in each ping already: nothing to project
    rhs = design.T @ (precision * residual)
    return _Normal(
        *_blocks_of(normal, u.n_knots, 2 * n_clocks),
        side.reshape(u.n_knots, 2 * n_clocks, -1),
        corner,
        rhs.reshape(u.n_knots, n_clocks, 2),
        border.T @ (precision * residual),
    )


class _Step(NamedTuple):
    """One Gauss-Newton step, and covariances at it."""

    state: np.ndarray  # (K, C, 2)
    border: np.ndarray  # (B,)
    cov: np.ndarray  # (K, C, 2, 2)
    cross: np.ndarray  # (K - 1, C, 2, 2) with the next knot
    border_cov: np.ndarray  # (B, B)


def _solve_bordered(e: _Normal) -> _Step:
    """Solve the normal equations, places damped, and invert what is needed of them."""
    n_knots, n_clocks = e.rhs.shape[:2]
    factor = _blocks.factor(e.diag, e.off)
    rhs = e.rhs.reshape(n_knots, 2 * n_clocks, 1)
    both = _blocks.solve(factor, np.concatenate([rhs, e.side], axis=2))
    plain, through = both[..., 0], both[..., 1:]
    border_cov = np.linalg.inv(e.corner - np.einsum("kng,knh->gh", e.side, through))
    border = border_cov @ (e.rhs_border - np.einsum("kng,kn->g", e.side, plain))
    border *= min(1.0, FARTHEST / max(float(np.abs(border[1:]).max(initial=0.0)), 1e-12))
    state = (plain - through @ border).reshape(n_knots, n_clocks, 2)

    inverse, inverse_off = _blocks.selected_inverse(factor)
    each, shape = np.arange(n_clocks), (-1, n_clocks, 2, n_clocks, 2)
    t = through.reshape(n_knots, n_clocks, 2, -1)
    spread = t @ border_cov
    cov = inverse.reshape(shape)[:, each, :, each, :].swapaxes(0, 1)
    cross = inverse_off.reshape(shape)[:, each, :, each, :].swapaxes(0, 1)
    cov = cov + spread @ t.swapaxes(-1, -2)
    cross = cross + spread[:-1] @ t[1:].swapaxes(-1, -2)
    return _Step(state, border, cov, cross, border_cov)


def solve(
    arrivals: Arrivals,
    geometry: Geometry,
    start: np.ndarray,
    first: float,
    spacing: float,
    reference: int,
    *,
    robust: bool = True,
    sigma: float | None = None,
    intensity: float | None = None,
    most_rounds: int = 60,
) -> Solution:
    """Fit the clocks.

    Parameters
    ----------
    arrivals : Arrivals
        Pings of at least two arrivals.
    geometry : Geometry
    start : array (K, R, 2)
        Coarse state (see `_curve`), good to some .05 s; 0 for the reference.
    first, spacing : float
        First knot and distance between knots, common time, s.
    reference : int
        Clock that is the common time.
    robust : bool
        False: every arrival is direct, an ordinary least-squares fit.
    sigma, intensity : float, optional
        Hold the error sd (s) or all clock noise intensities (s^2/s^3).
    most_rounds : int
        Give up then, `converged` False.

    Returns
    -------
    Solution

    Raises
    ------
    numpy.linalg.LinAlgError
        If the normal matrix is not positive definite (numbers that are no clocks).
    """
    a, n_rows = arrivals, len(arrivals.recorded)
    n_knots, n_clocks = start.shape[:2]
    free = np.flatnonzero(np.arange(n_clocks) != reference)
    column = np.full(n_clocks, -1)
    column[free] = 2 * np.arange(len(free))
    by_ping = sp.csr_matrix((np.ones(n_rows), (a.ping, np.arange(n_rows))))
    u = _Layout(a, geometry, first, spacing, n_knots, free, column, by_ping)
    prior = ClockPrior(start[0, free], spacing)
    border_precision = _border_precision(geometry)
    moved = np.zeros(len(border_precision))
    state, xyz = start.copy(), geometry.xyz.copy()
    q, known = np.full(len(free), intensity or Q_START), 0.0
    s, w = sigma or ANNEAL[0], 0.1 if robust else 0.0
    common, emission, step = None, None, None
    converged, rounds = False, 0

    while True:
        slowness = (1 + moved[0]) / geometry.sound_speed
        distance = distances(xyz, a.place, a.source)
        common = to_common(state, first, spacing, a.receiver, a.recorded, common)
        y = common - distance * slowness
        if emission is None:
            emission = low_quantile(y, a.ping) if robust else by_ping @ y / np.bincount(a.ping)
        weight = p_direct(y - emission[a.ping], s, w) if robust else np.ones(n_rows)
        precision = np.maximum(weight, LEAST_WEIGHT) / s**2
        total = by_ping @ precision
        emission = (by_ping @ (precision * y)) / total
        residual = y - emission[a.ping]
        if step is not None and (converged or rounds >= most_rounds):
            break

        border = travel_derivative(a, xyz, distance, slowness, geometry)
        design = _design(u, common, emission)
        e = _normal_equations(u, design, border, precision, residual)
        prior.add(e.diag, e.off, e.rhs, state[:, free], q)
        e.corner[np.diag_indices(len(moved))] += border_precision
        step = _solve_bordered(e._replace(rhs_border=e.rhs_border - border_precision * moved))
        state[:, free] += step.state
        moved += step.border
        if geometry.sd > 0:
            xyz[:, :2] = geometry.xyz[:, :2] + moved[1:].reshape(-1, 2)
        rounds += 1

        if intensity is None and rounds > 2:
            q, known = prior.intensity(state[:, free], step.cov, step.cross, q)
        before = s
        if robust and rounds < len(ANNEAL):
            s = s if sigma else ANNEAL[rounds]
        else:
            used = float(weight.sum())
            if sigma is None:
                freedom = used - (total * s**2 > 0.5).sum() - known - len(moved)
                s = np.sqrt((weight * residual**2).sum() / max(freedom, 1.0))
                s = float(np.clip(s, max(before / 3, LEAST_SIGMA), before * 3))
            if robust:
                w = float(np.clip(1 - BACKGROUND - used / n_rows, 1e-3, 0.5))
        settled = abs(s / before - 1) < 2e-3 and np.abs(step.state[..., 0]).max() < 0.02 * s
        converged = bool(settled and rounds > len(ANNEAL) + 3)

    state_sd, all_q = np.zeros_like(state), np.zeros(n_clocks)
    state_sd[:, free] = np.sqrt(np.diagonal(step.cov, axis1=2, axis2=3))
    all_q[free] = q
    border_sd = np.sqrt(step.border_cov.diagonal())
    xy_sd = border_sd[1:].reshape(-1, 2) if geometry.sd > 0 else np.zeros((len(xyz), 2))
    speed = geometry.sound_speed / (1 + moved[0])
    speed_sd = speed * border_sd[0] / (1 + moved[0]) if geometry.sound_speed_sd > 0 else 0.0
    return Solution(
        state, state_sd, xyz, xy_sd, speed, speed_sd, s, w, all_q, emission, residual, weight,
        rounds, converged,
    )  # fmt: skip


def _border_precision(geometry: Geometry) -> np.ndarray:
    """Prior precision (B,) of relative slowness and of the places."""
    relative = geometry.sound_speed_sd / geometry.sound_speed
    speed = 1 / relative**2 if relative > 0 else 1.0  # any number: its column is zero
    places = np.full(geometry.xyz[:, :2].size if geometry.sd > 0 else 0, 1.0)
    return np.concatenate([[speed], places / geometry.sd**2 if geometry.sd > 0 else places])
