"""How simulated animals move: an exact CTCRW, or a correlated random walk in a polygon."""

from __future__ import annotations

import math

import numpy as np

__all__ = ["correlated_walk", "ctcrw", "in_polygon"]


def ctcrw(
    rng: np.random.Generator,
    time: np.ndarray,
    sigma_vel: float = 0.1,
    t05: float = 300.0,
    start: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Draw a continuous-time correlated random walk at given times, without discretising it.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    time : array (P,)
        Increasing, s.
    sigma_vel : float
        Standard deviation of the velocity, m/s an axis.
    t05 : float
        Time after which 5 % of the velocity's correlation is left, s.
    start : pair of float
        First position, m; the first velocity is drawn from its stationary law.

    Returns
    -------
    array (P, 2)
        Positions, m.

    References
    ----------
    Johnson et al. (2008) Ecology 89(5): 1208-1215, eqs 5-7.
    """
    beta = -math.log(0.05) / t05
    x = beta * np.diff(time)
    e = np.exp(-x)
    # The position's variance in units of (sigma_vel / beta)^2; its series where digits cancel.
    series = x**3 * (2 / 3 - x / 2 + 7 * x**2 / 30)
    var_x = np.where(x < 1e-2, series, 2 * x - 3 + 4 * e - e * e) * (sigma_vel / beta) ** 2
    var_v = sigma_vel**2 * -np.expm1(-2 * x)
    cov = sigma_vel**2 / beta * np.expm1(-x) ** 2
    z = rng.standard_normal((2, len(x), 2))
    sd_v = np.sqrt(var_v)[:, None]
    slope = (cov / np.where(var_v > 0, var_v, 1.0))[:, None]
    rest = np.sqrt(np.maximum(var_x[:, None] - slope**2 * sd_v**2, 0.0))
    dv = sd_v * z[0]
    dx = slope * dv + rest * z[1]
    path = np.empty((len(time), 2))
    path[0] = start
    velocity = sigma_vel * rng.standard_normal(2)
    for k in range(len(x)):
        path[k + 1] = path[k] + velocity * (1 - e[k]) / beta + dx[k]
        velocity = velocity * e[k] + dv[k]
    return path


def correlated_walk(
    rng: np.random.Generator,
    time: np.ndarray,
    polygon: np.ndarray,
    speed: float = 0.15,
    turn: float = 0.135,
    start: tuple[float, float] | None = None,
) -> np.ndarray:
    """Draw a correlated random walk that is reflected by the sides of a polygon.

    Steps of one second: the heading turns by N(0, `turn`), the step is exponential with mean
    `speed`, and a step that would leave the polygon is mirrored in the side it crosses, like the
    simulated canal tracks of the yaps studies but kept in the water.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    time : array (P,)
        Increasing, s.
    polygon : array (V, 2)
        Corners in order, m; need not be convex.
    speed : float
        Mean speed, m/s.
    turn : float
        Standard deviation of the change of heading in a second, radians.
    start : pair of float, optional
        First position, m; drawn uniformly in the polygon when not given.

    Returns
    -------
    array (P, 2)
        Positions at `time`, m, linear between whole seconds.
    """
    corners = [(float(a), float(b)) for a, b in polygon]
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
    if start is None:
        lo, hi = polygon.min(0), polygon.max(0)
        p = rng.uniform(lo, hi)
        while not in_polygon(p[None], polygon)[0]:
            p = rng.uniform(lo, hi)
        start = (float(p[0]), float(p[1]))
    n = int(math.ceil(time[-1] - time[0])) + 1
    steps = rng.exponential(speed, n)
    turns = rng.normal(0.0, turn, n)
    heading = rng.uniform(-math.pi, math.pi)
    path = np.empty((n + 1, 2))
    path[0] = x, y = start
    for k in range(n):
        heading += turns[k]
        dx, dy = steps[k] * math.cos(heading), steps[k] * math.sin(heading)
        x, y, heading = _step_inside(x, y, dx, dy, heading, sides)
        path[k + 1] = x, y
    seconds = time[0] + np.arange(n + 1)
    return np.stack([np.interp(time, seconds, path[:, i]) for i in (0, 1)], 1)


def _step_inside(x, y, dx, dy, heading, sides):
    """Take one step, mirrored in every side that it meets; stay put in a corner too tight."""
    px, py = x, y
    for _ in range(8):
        hit = None
        for (ax, ay), (bx, by) in sides:
            ex, ey = bx - ax, by - ay
            cross = dx * ey - dy * ex
            if cross == 0.0:
                continue
            u = ((ax - px) * ey - (ay - py) * ex) / cross
            v = ((ax - px) * dy - (ay - py) * dx) / cross
            if 1e-12 < u <= 1.0 and 0.0 <= v <= 1.0 and (hit is None or u < hit[0]):
                hit = (u, ex, ey)
        if hit is None:
            return px + dx, py + dy, heading
        u, ex, ey = hit
        # A hair short of the side, so that the next look starts inside.
        px, py = px + u * (1 - 1e-9) * dx, py + u * (1 - 1e-9) * dy
        along = 2.0 * math.atan2(ey, ex)
        heading = along - heading
        left = (1.0 - u) * math.hypot(dx, dy)
        dx, dy = left * math.cos(heading), left * math.sin(heading)
    return x, y, heading + math.pi


def in_polygon(xy: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Whether each point (P, 2) lies inside a polygon (V, 2), by counting crossings; (P,) bool."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    x, y = xy[:, :1], xy[:, 1:]
    spans = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return (spans & (x < at)).sum(1) % 2 == 1
