"""Where a fit of the clocks begins, how its unknowns are laid out, and what it ends with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.sync._arrivals import DELAY_SD, Geometry, Links, distances, travel_derivative
from maloc.sync._normal import Step
from maloc.sync._prior import V_START

__all__ = ["Grid", "Jumps", "Layout", "Solution", "Start"]

JUMP_SD = 0.5  # prior of a jump about its coarse size, s


class Grid(NamedTuple):
    """Knots: first (s), distance (s), number."""

    first: float
    spacing: float
    n: int

    @property
    def time(self) -> np.ndarray:
        """Common time of the knots (K,), s."""
        return self.first + self.spacing * np.arange(self.n)


class Jumps(NamedTuple):
    """Clock, place in the order of that clock's jumps, and size (s), arrays (S,)."""

    clock: np.ndarray
    order: np.ndarray
    size: np.ndarray

    def before(self, clock: np.ndarray, segment: np.ndarray) -> np.ndarray:
        """Which jumps (N, S) lie before these segments of these clocks."""
        mine = clock[:, None] == self.clock
        return np.asarray(mine & (self.order < segment[:, None]))

    def lead(self, clock: np.ndarray, segment: np.ndarray) -> np.ndarray:
        """Sum (N,) of the jumps before these segments, s."""
        table = np.zeros((1 + int(clock.max(initial=0)), 1 + int(segment.max(initial=0))))
        c, s = np.indices(table.shape)
        table = (self.before(c.ravel(), s.ravel()) @ self.size).reshape(table.shape)
        return table[clock, segment]


class Start(NamedTuple):
    """Where a fit begins: from coarse clocks, or where another fit ended.

    Attributes
    ----------
    state : array (K, R, 2)
        Offset, and slope times spacing, at the knots, good to some .05 s; 0 for the reference.
    jumps : Jumps
    sigma, reflected : float, optional
        Those of a fit that has settled: there is no annealing then.
    intensity : array (R,), optional
    xyz : array (D, 3), optional
    slowness : float
        Relative deviation of the mean slowness from the given one.
    varying : array (K,), optional
    varying_sd : float
    delay : array (D,), optional
    """

    state: np.ndarray
    jumps: Jumps
    sigma: float | None = None
    reflected: float = 0.1
    intensity: np.ndarray | None = None
    xyz: np.ndarray | None = None
    slowness: float = 0.0
    varying: np.ndarray | None = None
    varying_sd: float = V_START
    delay: np.ndarray | None = None


class Layout(NamedTuple):
    """Columns: clocks that are free, deployments with delays and free places, parts of the border.

    The border holds mean slowness, delays, jumps, constants of the clocks (where curves are held)
    and x, y of free places, in this order.
    """

    free: np.ndarray  # (C,) clocks other than the reference
    delayed: np.ndarray  # (T,) deployments
    jumps: Jumps
    held: bool
    placed: np.ndarray  # (F,) deployments

    @property
    def parts(self) -> tuple[slice, slice, slice, slice]:
        """Delays, jumps, constants and places in the border."""
        sizes = [1, len(self.delayed), len(self.jumps.size),
                 len(self.free) if self.held else 0, 2 * len(self.placed)]  # fmt: skip
        edge = np.cumsum(sizes)
        a, b, c, d = (slice(int(i), int(j)) for i, j in zip(edge[:-1], edge[1:], strict=True))
        return a, b, c, d

    def precision(self, geometry: Geometry) -> np.ndarray:
        """Prior precision of the border."""
        relative = geometry.sound_speed_sd / geometry.sound_speed
        speed = 1 / relative**2 if relative > 0 else 1.0  # any number: its column is zero
        return np.concatenate([
            [speed],
            np.full(len(self.delayed), 1 / DELAY_SD**2),
            np.full(len(self.jumps.size), 1 / JUMP_SD**2),
            np.full(len(self.free) if self.held else 0, 1.0),
            np.repeat(1 / geometry.sd[self.placed] ** 2, 2),
        ])  # fmt: skip

    def rows(self, at: Links, xyz: np.ndarray, slowness: float, g: Geometry) -> np.ndarray:
        """Derivative (L, B) of the recorded time to the border."""
        given = 0.0 if g.sound_speed_sd == 0 else 1 / g.sound_speed
        parts = [
            given * distances(xyz, at.place, at.source)[:, None],
            (at.own[:, None] & (at.place[:, None] == self.delayed)).astype(float),
            self.jumps.before(at.receiver, at.segment).astype(float),
        ]
        if self.held:
            parts.append((at.receiver[:, None] == self.free).astype(float))
        travel = travel_derivative(at, xyz, slowness).reshape(len(at.place), -1, 2)
        parts.append(travel[:, self.placed].reshape(len(at.place), -1))
        return np.concatenate(parts, axis=1)


class Solution(NamedTuple):
    """Result of `solve`.

    Attributes
    ----------
    end : Start
        All values, to begin another fit from.
    state_sd : array (K, R, 2)
    xyz : array (D, 3)
    delay : array (D,)
        With which each deployment hears its own sync tag, s.
    xy_sd : array (D, 2)
        Posterior sd of the places, m; 0 where held.
    speed, speed_sd : array (K,)
        Sound speed at the knots, m/s.
    sigma, reflected : float
        Error sd of direct arrivals (s), share of late ones.
    jump_sd : array (S,)
    delay_sd : array (D,)
    emission : array (P,)
        Emission times on the common clock, s.
    common, residual, p_direct : array (N,)
    layout : Layout
    step : Step
        The last one, with its covariances.
    rounds : int
    converged : bool
    """

    end: Start
    state_sd: np.ndarray
    xyz: np.ndarray
    delay: np.ndarray
    xy_sd: np.ndarray
    speed: np.ndarray
    speed_sd: np.ndarray
    sigma: float
    reflected: float
    jump_sd: np.ndarray
    delay_sd: np.ndarray
    emission: np.ndarray
    common: np.ndarray
    residual: np.ndarray
    p_direct: np.ndarray
    layout: Layout
    step: Step
    rounds: int
    converged: bool
