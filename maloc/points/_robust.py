"""Consensus: hypotheses from minimal sets, the one that most arrivals agree with, least squares.

References
----------
Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife Tracking.
Sensors 23: 9460, sections 2.1 and 2.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc._jax import jax, jnp
from maloc.points._choose import SAME, choose
from maloc.points._hypotheses import allowed, hypotheses
from maloc.points._lm import distances, fit
from maloc.points._problem import Found, Problem, in_batches

__all__ = ["EARLY", "consensus", "hypotheses", "rank", "refine", "truncated_cost"]

EARLY = 1000.0
_PLACES = 4  # of the best hypotheses that are refined


def truncated_cost(z: Any, heard: Any, delta: Any, early: Any) -> Any:
    """Sum over arrivals (axis 0) of squared weighted residuals, no more than delta^2 each.

    Of early ones no more than delta^2 + 2 log `early`: no detour is shorter than the direct path.
    """
    cost = jnp.minimum(z**2, delta**2 + jnp.where(z < 0, 2 * jnp.log(early), 0.0))
    return jnp.sum(jnp.where(heard, cost, 0.0), axis=0)


def _weighted(ping: Problem, position: Any, emission: Any) -> Any:
    """Residuals in standard deviations (M, H) of hypotheses (d, H) with their emissions (H,)."""
    square = sum((position[i][None] - ping.place[:, i, None]) ** 2 for i in range(len(position)))
    if len(position) == 2:
        square = square + ping.place[:, 2, None] ** 2
    return (ping.range[:, None] - emission[None] - jnp.sqrt(square)) / ping.sigma[:, None]


def rank(z: Any, heard: Any, distance: Any, allowed: Any, delta: Any, early: Any) -> Any:
    """Index of the best hypothesis: largest consensus, nearest to the prior, smallest residual.

    Parameters
    ----------
    z : array (M, H)
        Residuals in standard deviations.
    heard : array (M,) bool
        Arrivals.
    distance : array (H,)
        To the prior position, m; 0 where there is none.
    allowed : array (H,) bool
        Others are never chosen (as long as one is allowed).
    delta : float
        Standard deviations beyond which an arrival disagrees.
    early : float
        Above 1: of two sets of one size, the one with fewer early outliers is better.

    Returns
    -------
    array ()
    """
    agrees = (abs(z) <= delta) & heard[:, None]
    too_early = jnp.sum((z < -delta) & heard[:, None], axis=0) * (early > 1)
    size = jnp.where(allowed, jnp.sum(agrees, axis=0) * len(heard) - too_early, -9999)
    worst = jnp.max(jnp.where(agrees, abs(z), 0.0), axis=0)
    biggest = size == jnp.max(size)
    least = jnp.min(jnp.where(biggest, worst, jnp.inf))
    # the seed: nearness to the prior decides while the largest residuals differ by at most 1
    close = biggest & (worst <= least + 1)
    nearest = jnp.min(jnp.where(close, distance, jnp.inf))
    tied = close & (distance <= nearest)
    return jnp.argmin(jnp.where(tied, worst, jnp.inf))


def refine(
    ping: Problem, position: Any, emission: Any, delta: Any, early: Any, rounds: int
) -> tuple:
    """Least squares on the arrivals that agree, which are classified anew after each round.

    Returns
    -------
    position (d,), emission (), inlier (M,) bool, truncated cost ()
    """
    d = len(position)
    precision = 1 / ping.sigma**2

    def once(_: Any, place: tuple) -> tuple:
        position, emission = place
        z = (ping.range - emission - distances(ping.place, position)) / ping.sigma
        inlier = (abs(z) <= delta) & ping.heard
        enough = jnp.sum(inlier) > d
        found = fit(ping, position, jnp.where(inlier & enough, precision, 0.0), steps=12)
        position = jnp.where(enough, found.position, position)
        return position, jnp.where(enough, found.emission, emission)

    position, emission = jax.lax.fori_loop(0, rounds, once, (position, emission))
    z = (ping.range - emission - distances(ping.place, position)) / ping.sigma
    inlier = (abs(z) <= delta) & ping.heard
    return position, emission, inlier, truncated_cost(z, ping.heard, delta, early)


def _consensus(
    ping: Problem,
    prior: Any,
    delta: Any,
    early: Any,
    reach: Any,
    apart: Any,
    region: Any,
    *,
    d: int,
    most: int,
    rounds: int,
) -> tuple[dict, dict]:
    position, emission, _ = hypotheses(ping, d, most)
    z = _weighted(ping, position, emission)
    usable = allowed(ping, position, reach, region)
    known = jnp.isfinite(prior[0])
    to_prior = jnp.sqrt(sum((position[i] - prior[i]) ** 2 for i in range(2)))
    to_prior = jnp.where(known & usable, to_prior, 0.0)
    # of one minimal set the rival is the other root, however near
    apart = jnp.where(jnp.sum(ping.heard) == d + 1, SAME, apart)

    def away(place: Any) -> Any:
        return ~(sum((position[i] - place[i]) ** 2 for i in range(d)) <= apart**2)

    def place(free: Any, _: Any) -> tuple:
        """The best hypothesis that is another place than those taken, refined."""
        best = rank(z, ping.heard, to_prior, free, delta, early)
        start = position[:, best]
        found = refine(ping, start, emission[best], delta, early, rounds)
        return free & away(start) & away(found[0]), (*found, jnp.any(free))

    _, (places, emissions, used, cost, some) = jax.lax.scan(place, usable, None, length=_PLACES)
    # how many arrivals agree before least squares says less than how well they do after it
    outside = ~allowed(ping, places.T, reach, region)
    score = jnp.where(some, cost + 1e6 * outside, jnp.inf)
    one = jnp.argmin(score)
    near = sum((places[:, i] - places[one, i]) ** 2 for i in range(d)) <= apart**2
    rest = jnp.where(near, jnp.inf, score)
    two = jnp.argmin(rest)
    pick = jnp.stack([one, two])
    some = jnp.stack([some[one], jnp.isfinite(rest[two])])
    places, emissions, used, cost = (a[pick] for a in (places, emissions, used, cost))
    return {"position": places, "emission": emissions, "cost": cost, "any": some}, {
        "used": jnp.moveaxis(used, 0, 1)
    }


def consensus(
    problem: Problem,
    d: int,
    *,
    delta: float = 3.0,
    early: float = EARLY,
    reach: float = np.inf,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    most: int = 56,
    apart: float = 10.0,
    evidence: float = 6.0,
    rounds: int = 2,
) -> Found:
    """Robust positions by consensus.

    Parameters
    ----------
    problem : Problem
        P pings of at least d + 1 arrivals.
    d : int
        2 or 3.
    delta : float
        An arrival whose residual is beyond `delta` standard deviations is an outlier.
    early : float
        How many times rarer an outlier is that comes too early than one too late: as in the track
        models a tenth of arrivals beside one in 10,000 (1: as frequent, as with clocks that jump).
    reach : float
        Largest distance (m) from the nearest receiver that heard the ping.
    region : array (V, 2), optional
        Polygon, m, that the tag cannot have left.
    prior : array (P, 2), optional
        Where the tag is thought to have been, m; NaN where unknown. Decides between hypotheses
        with equally many agreeing arrivals.
    most : int
        Largest number of minimal sets a ping.
    apart : float
        Two places nearer than this (m) are one.
    evidence : float
        Twice the log of the likelihood ratio up to which two places fit equally well (6: 20 : 1).
    rounds : int
        Rounds of least squares and classification.
    """
    n = len(problem.heard)
    prior = np.full((n, 2), np.nan) if prior is None else np.asarray(prior, float)
    polygon = np.zeros((0, 2)) if region is None else np.asarray(region, float)
    value, each = in_batches(
        _consensus,
        problem,
        (prior,),
        (delta, early, reach, apart, polygon),
        static={"d": d, "most": most, "rounds": rounds},
    )
    return choose(
        problem,
        value,
        each["used"],
        d,
        reach=reach,
        region=region,
        prior=prior,
        apart=apart,
        evidence=evidence,
    )
