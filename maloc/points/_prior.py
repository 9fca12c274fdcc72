"""Where a tag may be before its arrivals are seen, and places spread over it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc._jax import jnp
from maloc.points._problem import Problem

__all__ = ["Prior", "edges", "hull", "log_prior", "spread", "start_in"]


class Prior(NamedTuple):
    """Where the tag may be: flat in a convex polygon, a Gaussian fall-off beyond its edges.

    Attributes
    ----------
    edge : array (E, 3)
        Outward normal and offset: normal . x <= offset inside, m. Padding: 0, 0, 1.
    fade : array ()
        Standard deviation of the fall-off, m.
    vertical : array (2,)
        Shallowest and deepest, m; the fall-off beyond is the same.
    region : array (V, 2)
        Polygon that the tag cannot have left, m; no rows: none.
    """

    edge: Any
    fade: Any
    vertical: Any
    region: Any


def log_prior(prior: Prior, x: list) -> Any:
    """Log of the prior density up to a constant, of coordinates (d arrays)."""
    beyond = prior.edge[:, 0, None] * x[0][None] + prior.edge[:, 1, None] * x[1][None]
    beyond = jnp.maximum(jnp.max(beyond - prior.edge[:, 2, None], axis=0), 0.0)
    out = -0.5 * (beyond / prior.fade) ** 2
    if len(x) == 3:
        over = jnp.maximum(jnp.maximum(prior.vertical[0] - x[2], x[2] - prior.vertical[1]), 0.0)
        out = out - 0.5 * (over / prior.fade) ** 2
    if prior.region.shape[0]:
        (ax, ay), (bx, by) = prior.region.T[:, :, None], jnp.roll(prior.region, -1, 0).T[:, :, None]
        crosses = (ay > x[1][None]) != (by > x[1][None])  # even-odd rule
        rise = jnp.where(by == ay, 1.0, by - ay)
        right = x[0][None] < ax + (x[1][None] - ay) * (bx - ax) / rise
        out = jnp.where(jnp.sum(crosses & right, axis=0) % 2 == 1, out, -jnp.inf)
    return out


def hull(problem: Problem) -> tuple[np.ndarray, float]:
    """Corners (V, 2) of the convex polygon around the receivers heard, and its diameter, m."""
    from scipy.spatial import ConvexHull, QhullError

    xy = np.unique(problem.place[problem.heard][:, :2], axis=0)
    diameter = max(float(np.linalg.norm(np.ptp(xy, axis=0))), 1.0)
    try:
        corners = xy[ConvexHull(xy).vertices]
    except (QhullError, ValueError):
        corners = np.empty((0, 2))
    area = 0.5 * abs(_shoelace(corners)) if len(corners) else 0.0
    if area < 0.05 * diameter**2:  # receivers on a line: the polygon is given some width
        middle = xy.mean(axis=0)
        _, _, axes = np.linalg.svd(np.vstack([xy - middle, np.zeros((2, 2))]), full_matrices=False)
        half = np.abs((xy - middle) @ axes.T).max(axis=0)
        half = np.maximum(half, diameter / 4)
        sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = middle + (sides * half) @ axes
    return corners if _shoelace(corners) > 0 else corners[::-1], diameter


def _shoelace(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def edges(corners: np.ndarray) -> np.ndarray:
    """Half planes (E, 3) of a convex polygon, counter-clockwise; padded to eights."""
    step = np.roll(corners, -1, axis=0) - corners
    normal = np.column_stack([step[:, 1], -step[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    edge = np.column_stack([normal, (normal * corners).sum(axis=1)])
    padding = np.tile([0.0, 0.0, 1.0], (-len(edge) % 8, 1))
    return np.concatenate([edge, padding])


def spread(n: int, dimensions: int) -> np.ndarray:
    """N points (dimensions, n) spread evenly in the unit cube: Roberts' R sequence."""
    ratio = 1.5
    for _ in range(40):  # the root of r^(d + 1) = r + 1
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    step = ratio ** -np.arange(1.0, dimensions + 1)
    return (0.5 + step[:, None] * np.arange(1, n + 1)) % 1


def start_in(corners: np.ndarray, n: int) -> np.ndarray:
    """N points (n, 2) spread evenly over a convex polygon (V, 2): a low-discrepancy sequence."""
    triangles = np.stack(
        [np.broadcast_to(corners[0], corners[1:-1].shape), corners[1:-1], corners[2:]], axis=1
    )
    a, b, c = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area = np.abs(b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    u, v = spread(n, 2)
    total = np.concatenate([[0.0], np.cumsum(area) / area.sum()])
    which = np.minimum(np.searchsorted(total, u, side="right") - 1, len(area) - 1)
    u = (u - total[which]) / (total[which + 1] - total[which])
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return a[which] + u[:, None] * b[which] + v[:, None] * c[which]
