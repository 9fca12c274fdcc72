"""The joint clock model: all clocks, the sound speed and the receivers' places in one fit.

A sync ping p, emitted at common time e_p by the tag beside deployment g, is recorded by receiver r
(at deployment j) as

    recorded = t + offset_r(t) + error,    t = e_p + |x_j - x_g| / c.

Offsets are cubic Hermite curves between knots with an integrated-random-walk prior of intensity
q_r (s^2/s^3), fitted per receiver; errors are Gaussian for the direct path, uniformly late for a
reflection, or anything for a small background, and the probability of the direct path is the
weight of an arrival (EM). Emission times are eliminated ping by ping, so the normal matrix is
block-tridiagonal in the knots (all clocks of a knot are one block) with a narrow dense border for
sound speed and places: the cost is linear in the length of the record.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.special import ndtr

from maloc.sync import _blocks
from maloc.sync._curve import evaluate, hermite, to_common

__all__ = ["Arrivals", "Geometry", "Solution", "distances", "solve"]

LATEST = 0.3  # largest lateness of a reflection, s
BACKGROUND = 0.003  # share of arrivals that are anything
ANNEAL = (0.05, 0.02, 0.01, 0.005, 0.002)  # error sd of the first rounds, s
START_SD = 1.0, 1e-5  # prior of the first knot about the coarse offset: s, s/s
Q_START, Q_RANGE = 1e-15, (1e-20, 1e-9)  # clock noise intensity, s^2/s^3
SHORTEST = 1e-6  # receiver and tag closer than this have no direction, m
_STEP = np.array([[1.0, 1.0], [0.0, 1.0]])  # [offset, slope] one knot on
_NOISE_INVERSE = np.linalg.inv(np.array([[1 / 3, 0.5], [0.5, 1.0]]))


class Arrivals(NamedTuple):
    """Sync arrivals, all arrays (N,).

    Attributes
    ----------
    recorded : float
        Time on the receiver's clock, s.
    receiver : int
        Clock.
    ping : int
        0..P-1, every one present.
    place, source : int
        Deployment that heard it and deployment beside which it was emitted.
    """

    recorded: np.ndarray
    receiver: np.ndarray
    ping: np.ndarray
    place: np.ndarray
    source: np.ndarray


class Geometry(NamedTuple):
    """Where deployments are and how well that is known.

    Attributes
    ----------
    xyz : array (D, 3)
        Metres; z = 0 everywhere where depths are not all known.
    sd : float
        Prior sd of x and of y of each deployment, m; 0 = as given.
    sound_speed, sound_speed_sd : float
        Prior of the sound speed, m/s; sd 0 = as given.
    """

    xyz: np.ndarray
    sd: float
    sound_speed: float
    sound_speed_sd: float


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
        Clock noise, s^2/s^3.
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


def distances(xyz: np.ndarray, place: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Distance (N,) between two deployments each, m."""
    return np.linalg.norm(xyz[place] - xyz[source], axis=1)


def p_direct(residual: np.ndarray, sigma: float, reflected: float) -> np.ndarray:
    """Probability (N,) that an arrival with this residual (s) came by the direct path."""
    z = residual / sigma
    direct = (1 - reflected - BACKGROUND) * np.exp(-0.5 * z * z) / (sigma * np.sqrt(2 * np.pi))
    late = reflected * (ndtr(z) - ndtr((residual - LATEST) / sigma)) / LATEST
    return direct / (direct + late + BACKGROUND / (2 * LATEST))


def _low_quantile(y: np.ndarray, ping: np.ndarray, quantile: float = 0.35) -> np.ndarray:
    """Low quantile of each ping (P,): reflections are only late, so the middle lies too high."""
    order = np.lexsort((y, ping))
    count = np.bincount(ping)
    return y[order][np.cumsum(count) - count + ((count - 1) * quantile).astype(int)]


class _Prior:
    """Precision of the knots under integrated random walks, about the coarse start."""

    def __init__(self, start: np.ndarray, spacing: float) -> None:
        self.start, self.spacing = start, spacing  # start: (C, 2) first knot of C clocks
        self.first = np.array([1 / START_SD[0] ** 2, 1 / (START_SD[1] * spacing) ** 2])

    def add(self, diag: np.ndarray, off: np.ndarray, grad: np.ndarray, s: np.ndarray, q) -> None:
        """Add precision to `diag` (K, n, n), `off`, and minus the gradient at s (K, C, 2)."""
        n_clocks = s.shape[1]
        each = np.arange(n_clocks)
        precision = _NOISE_INVERSE / (q * self.spacing**3)[:, None, None]
        cross = _STEP.T @ precision
        d = diag.reshape(len(s), n_clocks, 2, n_clocks, 2)
        o = off.reshape(len(s) - 1, n_clocks, 2, n_clocks, 2)
        d[:-1, each, :, each, :] += (cross @ _STEP)[:, None]
        d[1:, each, :, each, :] += precision[:, None]
        o[:, each, :, each, :] -= cross[:, None]
        d[0, each, :, each, :] += np.diag(self.first)
        pull = np.einsum("cab,kcb->kca", precision, self.innovation(s))
        grad[1:] -= pull
        grad[:-1] += pull @ _STEP
        grad[0] -= self.first * (s[0] - self.start)

    @staticmethod
    def innovation(s: np.ndarray) -> np.ndarray:
        """Change of state not foreseen from the knot before (K - 1, C, 2)."""
        return s[1:] - s[:-1] @ _STEP.T

    def intensity(self, s: np.ndarray, cov, cross, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """New intensities (C,) and the numbers of innovations that the data determine.

        MacKay's fixed point, shrunk to the geometric mean of all clocks by one pseudo-innovation.
        """
        ahead = np.einsum("ab,kcbd->kcad", _STEP, cross)
        spread = cov[1:] + _STEP @ cov[:-1] @ _STEP.T - ahead - ahead.swapaxes(-1, -2)
        v = self.innovation(s)
        squares = np.einsum("kca,ab,kcb->c", v, _NOISE_INVERSE, v) / self.spacing**3
        trace = np.einsum("ab,kcba->c", _NOISE_INVERSE, spread) / self.spacing**3
        known = np.maximum(2.0 * len(v) - trace / q, 0.3)
        pool = np.exp(np.log(q).mean())
        new = np.clip((squares + 2 * pool) / (known + 2), q / 30, q * 30)
        return np.clip(new, *Q_RANGE), known


def _border(a: Arrivals, xyz, distance, slowness, geometry: Geometry) -> sp.csr_matrix:
    """Derivative (N, 1 + 2 D) of the travel time to slowness (in 1/c0) and to x, y of places."""
    n, n_places = len(a.recorded), len(xyz)
    rows = np.arange(n)
    data, row, col = [distance / geometry.sound_speed], [rows], [np.zeros(n, int)]
    if geometry.sd > 0:
        away = (xyz[a.place, :2] - xyz[a.source, :2]) / np.maximum(distance, SHORTEST)[:, None]
        away = np.where(distance[:, None] > SHORTEST, away, 0.0) * slowness
        for axis in range(2):
            data += [away[:, axis], -away[:, axis]]
            row += [rows, rows]
            col += [1 + 2 * a.place + axis, 1 + 2 * a.source + axis]
    shape = (n, 1 + 2 * n_places)
    entries = (np.concatenate(data), (np.concatenate(row), np.concatenate(col)))
    return sp.csr_matrix(entries, shape=shape)


def _to_blocks(matrix: sp.csr_matrix, n_knots: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal and upper off-diagonal blocks of a block-tridiagonal sparse matrix."""
    m = matrix.tocoo()
    k, i, away, j = m.row // n, m.row % n, m.col // n - m.row // n, m.col % n
    diag, off = np.zeros((n_knots, n, n)), np.zeros((n_knots - 1, n, n))
    same, up = away == 0, away == 1
    diag[k[same], i[same], j[same]] = m.data[same]
    off[k[up], i[up], j[up]] = m.data[up]
    return diag, off


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
    most_rounds: int = 80,
) -> Solution:
    """Fit the clocks.

    Parameters
    ----------
    arrivals : Arrivals
        No self-detections; pings of at least two arrivals.
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
    """
    a = arrivals
    n_knots, n_clocks = start.shape[:2]
    free = np.array([r for r in range(n_clocks) if r != reference])
    column = np.full(n_clocks, -1)
    column[free] = 2 * np.arange(len(free))
    n, n_rows, n_pings = 2 * len(free), len(a.recorded), int(a.ping.max()) + 1
    state, xyz = start.copy(), geometry.xyz.copy()
    prior = _Prior(start[0, free], spacing)
    q = np.full(len(free), intensity or Q_START)
    slowness0 = 1.0 / geometry.sound_speed
    slowness = slowness0
    n_border = 1 + 2 * len(xyz)
    held = np.ones(n_border, bool)
    held[0] = geometry.sound_speed_sd == 0
    held[1:] = geometry.sd == 0
    tight = 1e12  # precision that holds a border parameter
    border_precision = np.full(n_border, tight)
    if not held[0]:
        border_precision[0] = (geometry.sound_speed / geometry.sound_speed_sd) ** 2
    if geometry.sd > 0:
        border_precision[1:] = 1 / geometry.sd**2
    moved = np.zeros(n_border)  # border parameters, prior mean 0
    by_ping = sp.csr_matrix((np.ones(n_rows), (a.ping, np.arange(n_rows))), (n_pings, n_rows))
    s, w = (sigma or ANNEAL[0]), (0.1 if robust else 0.0)
    emission: np.ndarray | None = None
    known = np.zeros(len(free))
    converged, rounds = False, 0
    result = None
    mover = column[a.receiver] >= 0

    while True:
        distance = distances(xyz, a.place, a.source)
        common = to_common(state, first, spacing, a.receiver, a.recorded)
        y = common - distance * slowness
        if emission is None:
            emission = _low_quantile(y, a.ping) if robust else by_ping @ y / np.bincount(a.ping)
        residual = y - emission[a.ping]
        weight = p_direct(residual, s, w) if robust else np.ones(n_rows)
        precision = np.maximum(weight, 1e-9) / s**2
        total = by_ping @ precision
        emission = (by_ping @ (precision * y)) / total
        residual = y - emission[a.ping]
        if result is not None and (converged or rounds >= most_rounds):
            break
        rounds += 1

        # all arrivals of a ping share its knots, so that blocks couple neighbours only
        place = (emission - first) / spacing
        k = np.clip(place.astype(int), 0, n_knots - 2)[a.ping]
        weights4 = hermite((common - first) / spacing - k)[mover]
        rows = np.repeat(np.flatnonzero(mover), 4)
        base = (k * n + column[a.receiver])[mover]
        cols = (base[:, None] + np.array([0, 1, n, n + 1])).ravel()
        design = sp.csr_matrix((weights4.ravel(), (rows, cols)), (n_rows, n_knots * n))
        border = _border(a, xyz, distance, slowness, geometry)

        root = sp.diags(1 / np.sqrt(total)) @ by_ping @ sp.diags(precision)
        ping_design, ping_border = (root @ design).tocsr(), (root @ border).toarray()
        weighted = sp.diags(precision)
        normal = (design.T @ weighted @ design - ping_design.T @ ping_design).tocsr()
        diag, off = _to_blocks(normal, n_knots, n)
        corner = (border.T @ weighted @ border).toarray() - ping_border.T @ ping_border
        side = (design.T @ weighted @ border).toarray() - ping_design.T @ ping_border
        # residuals are already free of their ping's mean, so these need no projection
        rhs = (design.T @ (precision * residual)).reshape(n_knots, len(free), 2)
        rhs_border = border.T @ (precision * residual)

        at = state[:, free]
        prior.add(diag, off, rhs, at, q)
        corner[np.diag_indices(n_border)] += border_precision
        rhs_border = rhs_border - border_precision * moved
        side = side.reshape(n_knots, n, n_border)
        factor = _blocks.factor(diag, off)
        both = _blocks.solve(factor, np.concatenate([rhs.reshape(n_knots, n, 1), side], axis=2))
        plain, through = both[..., 0], both[..., 1:]
        schur = corner - np.einsum("kng,knh->gh", side, through)
        border_cov = np.linalg.inv(schur)
        step_border = border_cov @ (rhs_border - np.einsum("kng,kn->g", side, plain))
        if geometry.sd > 0:  # bends of the distances: never more than 3 m at once
            step_border *= min(1.0, 3.0 / max(float(np.abs(step_border[1:]).max()), 1e-12))
        step = plain - through @ step_border
        state[:, free] += step.reshape(n_knots, len(free), 2)
        moved += step_border
        slowness = slowness0 * (1 + moved[0])
        if geometry.sd > 0:
            xyz[:, :2] = geometry.xyz[:, :2] + moved[1:].reshape(-1, 2)

        cov, cross = _clock_covariances(factor, through, border_cov, len(free))
        result = cov, border_cov
        s_before = s
        if intensity is None and rounds > 2:
            q, known = prior.intensity(state[:, free], cov, cross, q)
        if rounds < len(ANNEAL) and robust and sigma is None:
            s = ANNEAL[rounds]
        else:
            used = weight.sum()
            freedom = used - (total * s**2 > 0.5).sum() - known.sum() - (~held).sum()
            if sigma is None:
                s = np.sqrt((weight * residual**2).sum() / max(freedom, 1.0))
                s = float(np.clip(s, max(s_before / 3, 2e-5), s_before * 3))
            if robust:
                w = float(np.clip(1 - BACKGROUND - used / n_rows, 1e-3, 0.5))
        biggest = np.abs(step.reshape(n_knots, len(free), 2)[..., 0]).max() if len(free) else 0.0
        settled = abs(s / s_before - 1) < 2e-3 and biggest < 0.02 * s
        converged = bool(settled and rounds > len(ANNEAL) + 3)

    cov, border_cov = result
    state_sd = np.zeros_like(state)
    state_sd[:, free] = np.sqrt(np.diagonal(cov, axis1=2, axis2=3))
    border_sd = np.where(held, 0.0, np.sqrt(border_cov.diagonal()))
    c = 1 / slowness
    return Solution(
        state,
        state_sd,
        xyz,
        border_sd[1:].reshape(-1, 2),
        c,
        c * border_sd[0] / (1 + moved[0]),
        float(s),
        w,
        _all(q, free, n_clocks),
        emission,
        residual,
        weight,
        rounds,
        converged,
    )


def _all(q: np.ndarray, free: np.ndarray, n_clocks: int) -> np.ndarray:
    out = np.zeros(n_clocks)
    out[free] = q
    return out


def _clock_covariances(factor, through, border_cov, n_clocks: int):
    """Each clock's own covariance at a knot (K, C, 2, 2) and to the next knot (K - 1, C, 2, 2)."""
    diag, off = _blocks.selected_inverse(factor)
    each = np.arange(n_clocks)
    shape = (n_clocks, 2, n_clocks, 2)
    own = diag.reshape(-1, *shape)[:, each, :, each, :].swapaxes(0, 1)
    next_ = off.reshape(-1, *shape)[:, each, :, each, :].swapaxes(0, 1)
    t = through.reshape(len(through), n_clocks, 2, -1)
    spread = t @ border_cov
    own = own + spread @ t.swapaxes(-1, -2)
    return own, next_ + spread[:-1] @ t[1:].swapaxes(-1, -2)
