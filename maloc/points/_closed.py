"""Closed forms: both roots of minimal sets, and Smith and Abel's estimates from any number.

Everything is in ranges (m): arrivals are sound speed x seconds from some instant. The functions
see one ping, or a batch of sets of arrivals of one ping along trailing axes.

References
----------
Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife Tracking.
Sensors 23: 9460, section 2.9.
Smith & Abel (1987) Closed-form least-squares source location estimation from range-difference
measurements. IEEE Trans. Acoust. Speech Signal Process. 35: 1661-1669.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from maloc._jax import jnp
from maloc.points._choose import choose
from maloc.points._lm import distances
from maloc.points._problem import Found, Problem, in_batches
from maloc.points._small import dot, solve, under_determined

__all__ = ["Roots", "closed_form", "minimal", "spherical"]

_SAME = 1e-9  # m; arrivals that differ by less are simultaneous


class Roots(NamedTuple):
    """The two solutions of a minimal set.

    Attributes
    ----------
    position : array (2, d, ...)
        Metres.
    emission : array (2, ...)
        Emission's range, m, on the arrivals' scale.
    exact : array (2, ...) bool
        Solves the equations: real, and no arrival before the emission. Where the squared
        equations have no real solution both roots are the nearest real one, and not exact.
    """

    position: Any
    emission: Any
    exact: Any


def minimal(arrival: Any, place: Any, d: int, emission: Any = None) -> Roots:
    """Multilateration, or trilateration where the emission is known, from as many as unknowns.

    Differences of the squared equations are linear; their solutions w + alpha v put into one of
    the squared equations give a quadratic in alpha (Arnon et al. 2023, eqs. 7-9).

    Parameters
    ----------
    arrival : array (m, ...)
        Ranges, m: m = d + 1, or d where the emission is known.
    place : array (m, 3, ...)
        Receivers' x, y and depth, m; the depth is below the tag where d = 2.
    d : int
        2: in the plane, the tag's depth known; 3: in space.
    emission : array (...), optional
        The emission's range, m, on the arrivals' scale.

    Returns
    -------
    Roots
    """
    origin, above = place[0], place[0, 2] ** 2 if d == 2 else jnp.zeros(place.shape[2:])
    later = [arrival[i] - arrival[0] for i in range(1, len(arrival))]
    rows, right = [], []
    for i, q in enumerate(later, start=1):
        step = place[i, :d] - origin[:d]
        square = dot(step, step) - q**2
        if d == 2:
            square = square + place[i, 2] ** 2 - above
        if emission is None:
            rows.append(jnp.concatenate([2 * step, -2 * q[None]]))
        else:
            rows.append(2 * step)
            square = square + 2 * q * (emission - arrival[0])
        right.append(square)
    w, v, volume = under_determined(rows, right)
    if emission is None:
        sign = jnp.asarray([1.0] * d + [-1.0]).reshape((d + 1,) + (1,) * above.ndim)
        constant = -above
    else:
        sign = jnp.ones((d,) + (1,) * above.ndim)
        constant = (arrival[0] - emission) ** 2 - above
    alpha, real = _quadratic(dot(sign * v, v), dot(sign * v, w), dot(sign * w, w) - constant)
    root = w[None] + alpha[:, None] * v[None]
    scale = jnp.sqrt(sum(dot(a, a) for a in rows))
    if emission is None:
        sent = root[:, d]
        at_once = abs(jnp.stack(later)).sum(axis=0) < _SAME
        sent = jnp.where(at_once[None] & (sent > 0), -sent, sent)  # the seed's sign repair
        earliest = jnp.minimum(0.0, jnp.stack(later).min(axis=0))
        causal = sent <= (earliest + 1e-9 * scale + _SAME)[None]
        sent = sent + arrival[0][None]
    else:
        sent = jnp.broadcast_to(emission[None], alpha.shape)
        causal = sent <= jnp.min(arrival, axis=0)[None]
    finite = jnp.isfinite(alpha) & (volume > 0)[None]
    position = jnp.where(finite[:, None], root[:, :d] + origin[None, :d], jnp.nan)
    return Roots(position, jnp.where(finite, sent, jnp.nan), finite & causal & real[None])


def _quadratic(a: Any, h: Any, k: Any) -> tuple[Any, Any]:
    """Both roots (2, ...) of a x^2 + 2 h x + k = 0, and whether they are real.

    Where they are not, both are -h / a, the least of a x^2 + 2 h x + k.
    """
    square = h**2 - a * k
    real = square >= -1e-9 * (h**2 + abs(a * k))
    q = -(h + jnp.where(h >= 0, 1.0, -1.0) * jnp.sqrt(jnp.maximum(square, 0.0)))
    some = jnp.where(q == 0, 1.0, q)
    first = jnp.where(a == 0, jnp.inf, q / jnp.where(a == 0, 1.0, a))
    second = jnp.where(q == 0, first, k / some)
    second = jnp.where(real, second, first)
    return jnp.stack([first, second]), real


def spherical(ping: Any, d: int, kind: str) -> Roots:
    """Position from any number of arrivals, linear in it given the range to the first receiver.

    Parameters
    ----------
    ping : Problem
        One ping of at least d + 1 arrivals, the first the reference; d + 2 to interpolate.
    d : int
        2 or 3.
    kind : {"intersection", "interpolation"}
        The range from the sphere around the reference (two roots), or from least squares of the
        equation error (one, given twice).

    Returns
    -------
    Roots
        Not exact in the sense of a minimal set: `exact` is true where the range is positive, no
        arrival comes before the emission, and the receivers span the space.
    """
    step = [ping.place[:, i] - ping.place[0, i] for i in range(d)]
    later = ping.range - ping.range[0]
    above = ping.place[0, 2] ** 2 if d == 2 else jnp.zeros(())
    delta = sum(s**2 for s in step) - later**2
    if d == 2:
        delta = delta + ping.place[:, 2] ** 2 - above
    weight = jnp.where(ping.heard, 1 / (ping.sigma**2 + ping.sigma[0] ** 2), 0.0)
    weight = weight.at[0].set(0.0)

    def project(right: Any) -> Any:
        return jnp.stack([jnp.sum(weight * s * right) for s in step])

    gram = jnp.stack([project(s) for s in step])
    shape = gram / jnp.where(gram[0, 0] > 0, jnp.trace(gram), 1.0)
    spans = _det(shape) > 1e-8
    fixed = solve(jnp.where(spans, gram, jnp.eye(d)), project(delta)) / 2
    slope = solve(jnp.where(spans, gram, jnp.eye(d)), project(later))
    # position = fixed - range x slope, range that of the reference
    if kind == "interpolation":
        rest = delta - 2 * sum(fixed[i] * step[i] for i in range(d))
        beyond = later - sum(slope[i] * step[i] for i in range(d))
        square = jnp.sum(weight * beyond**2)
        free = square > 1e-12 * jnp.sum(weight * later**2)
        radius = jnp.sum(weight * beyond * rest) / jnp.where(free, 2 * square, 1.0)
        radius = jnp.where(free, radius, jnp.nan)
        radius = jnp.stack([radius, radius])
        real = jnp.asarray(True)
    else:
        radius, real = _quadratic(
            dot(slope, slope) - 1, -dot(fixed, slope), dot(fixed, fixed) + above
        )
    position = fixed[None] - radius[:, None] * slope[None] + ping.place[0, :d][None]
    emission = ping.range[0] - radius
    first = jnp.min(jnp.where(ping.heard, ping.range, jnp.inf))
    good = spans & real & jnp.isfinite(radius) & (emission <= first + 1e-6)
    bad = jnp.logical_not(spans & jnp.isfinite(radius))
    return Roots(
        jnp.where(bad[:, None], jnp.nan, position), jnp.where(bad, jnp.nan, emission), good
    )


def _det(a: Any) -> Any:
    """Determinant of a 2 x 2 or 3 x 3 matrix."""
    if len(a) == 2:
        return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


def _closed(ping: Problem, tolerance: Any, *, d: int, kind: str) -> tuple[dict, dict]:
    few = minimal(ping.range[: d + 1], ping.place[: d + 1], d)
    many = spherical(ping, d, kind)
    only = jnp.sum(ping.heard) == d + 1
    position = jnp.where(only, few.position, many.position)
    emission = jnp.where(only, few.emission, many.emission)
    reach = jnp.stack([ping.range - distances(ping.place, position[k]) for k in range(2)])
    z = (reach - emission[:, None]) / ping.sigma[None]
    cost = jnp.sum(jnp.where(ping.heard[None], z**2, 0.0), axis=1)
    # noise can leave a minimal set without a real solution: the nearest place is good if it fits
    good = jnp.where(only, few.exact | (cost <= (d + 1) * tolerance**2), many.exact)
    return {"position": position, "emission": emission, "cost": cost, "any": good}, {}


def closed_form(
    problem: Problem,
    d: int,
    *,
    kind: Literal["intersection", "interpolation"] = "intersection",
    tolerance: float = 5.0,
    reach: float = np.inf,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
) -> Found:
    """Positions without iteration; one wild arrival spoils them.

    Parameters
    ----------
    problem : Problem
        P pings of at least d + 1 arrivals.
    d : int
        2 or 3.
    kind : {"intersection", "interpolation"}
        Of pings with more than d + 1 arrivals: Smith and Abel's spherical intersection or
        interpolation.
    tolerance : float
        Standard deviations by which d + 1 arrivals that no place fits exactly may be off.
    reach, region, prior
        As of `maloc.points._choose.choose`.
    """
    value, _ = in_batches(
        _closed, problem, (), (tolerance,), static={"d": d, "kind": kind}, largest=2048
    )
    used = np.repeat(problem.heard[:, :, None], 2, axis=2)
    return choose(problem, value, used, d, reach=reach, region=region, prior=prior)
