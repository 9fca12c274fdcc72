"""Least squares of one ping by Levenberg and Marquardt, the emission time eliminated.

The emission enters linearly, so at every position its best value is a weighted mean, and only the
coordinates are searched (Golub and Pereyra's variable projection; Arnon et al. 2023, section 1.4).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.points._choose import choose
from maloc.points._problem import Found, Problem, in_batches
from maloc.points._small import dot, solve

__all__ = ["Fitted", "distances", "fit", "least_squares"]

_TINY = 1e-4  # m; a step shorter than this ends the search


class Fitted(NamedTuple):
    """A minimum: position (d,) m, emission's range () m, weighted sum of squares ()."""

    position: Any
    emission: Any
    cost: Any


def distances(place: Any, position: Any) -> Any:
    """Distances (M,) m from receivers (M, 3) to a position (2,) at depth 0, or (3,)."""
    square = sum((position[i] - place[:, i]) ** 2 for i in range(len(position)))
    if len(position) == 2:
        square = square + place[:, 2] ** 2
    return jnp.sqrt(jnp.maximum(square, 1e-12))


def fit(ping: Problem, start: Any, weight: Any, precision: Any = None, steps: int = 30) -> Fitted:
    """Weighted least squares from a start.

    Parameters
    ----------
    ping : Problem
        One ping.
    start : array (d,)
        Metres.
    weight : array (M,)
        1 / sigma^2 of the arrivals used, 0 elsewhere, 1/m^2.
    steps : int
        Largest number of steps.

    Returns
    -------
    Fitted
        Where the search stood when a step was below .1 mm, or after `steps` steps.
    """
    d = len(start)
    total = jnp.maximum(jnp.sum(weight), 1e-300)

    def state(x: Any) -> tuple:
        distance = distances(ping.place, x)
        reach = ping.range - distance
        residual = reach - jnp.sum(weight * reach) / total
        slope = [(x[i] - ping.place[:, i]) / distance for i in range(d)]
        slope = [s - jnp.sum(weight * s) / total for s in slope]
        weighted = [weight * s for s in slope]
        gradient = jnp.stack([jnp.sum(w * residual) for w in weighted])
        rows = [jnp.stack([jnp.sum(w * s) for s in slope]) for w in weighted]
        return jnp.sum(weight * residual**2), gradient, jnp.stack(rows)

    def going(carry: tuple) -> Any:
        return (carry[0] < steps) & (carry[-1] > _TINY)

    def step(carry: tuple) -> tuple:
        k, x, (cost, gradient, gram), damping, _ = carry
        ridge = damping * jnp.trace(gram) / d + 1e-300
        move = solve(gram + ridge * jnp.eye(d), gradient)
        new = state(x + move)
        better = new[0] < cost
        kept = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, (cost, gradient, gram))
        x = jnp.where(better, x + move, x)
        length = jnp.sqrt(dot(move, move)) * (1 + damping)  # a damped step is short anyway
        damping = jnp.where(better, jnp.maximum(damping / 10, 1e-9), damping * 10)
        # no further: the step is tiny, or no step of any length lowers the cost
        length = jnp.where(better, length, jnp.where(damping > 1e6, 0.0, jnp.inf))
        length = jnp.where(~better & (jnp.sqrt(dot(move, move)) < _TINY), 0.0, length)
        return k + 1, x, kept, damping, length

    start = jnp.where(jnp.isfinite(start), start, 0.0)
    first = (0, start, state(start), jnp.asarray(1e-3), jnp.asarray(jnp.inf))
    _, x, (cost, _, _), _, _ = jax.lax.while_loop(going, step, first)
    reach = ping.range - distances(ping.place, x)
    return Fitted(x, jnp.sum(weight * reach) / total, cost)


def _plain(ping: Problem, d: int) -> tuple[dict, dict]:
    weight = jnp.where(ping.heard, 1 / ping.sigma**2, 0.0)
    count = jnp.sum(weight)
    middle = jnp.stack([jnp.sum(weight * ping.place[:, i]) / count for i in range(d)])
    if d == 3:  # the middle of receivers at one depth is a saddle
        middle = middle + jnp.asarray([0.0, 0.0, 1.0])
    found = fit(ping, middle, weight)
    return {"position": found.position, "emission": found.emission, "cost": found.cost}, {}


def least_squares(
    problem: Problem, d: int, *, reach: float = np.inf, region: np.ndarray | None = None
) -> Found:
    """Least squares of all arrivals from the middle of the receivers: the naive reference.

    Parameters
    ----------
    problem : Problem
        P pings.
    d : int
        2 or 3.
    reach, region
        As of `maloc.points._choose.choose`.
    """
    value, _ = in_batches(_plain, problem, static={"d": d})
    twice = {k: np.repeat(v[:, None], 2, axis=1) for k, v in value.items()}
    twice["any"] = np.tile([True, False], (len(problem.heard), 1))
    used = np.repeat(problem.heard[:, :, None], 2, axis=2)
    return choose(problem, twice, used, d, reach=reach, region=region)
