"""The clustering variant: hypotheses of a clean ping crowd at the tag (Arnon et al. 2023, 2.2).

DBSCAN is written out (a ping has a few hundred hypotheses, so all distances fit), and labels
spread through the graph of near pairs by squaring it, which needs no library.

References
----------
Ester, Kriegel, Sander & Xu (1996) A density-based algorithm for discovering clusters. KDD-96.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc._jax import jax, jnp
from maloc.points._choose import choose
from maloc.points._hypotheses import allowed, hypotheses
from maloc.points._problem import Found, Problem, in_batches
from maloc.points._robust import EARLY, refine

__all__ = ["cluster", "dbscan"]


def dbscan(position: Any, usable: Any, eps: Any, least: int) -> Any:
    """Label of each point's cluster: the lowest index of its core points; -1 for noise.

    Parameters
    ----------
    position : array (H, d)
        Points, m.
    usable : array (H,) bool
        Others are noise.
    eps : float
        Two points this near (m) are neighbours.
    least : int
        A point with so many neighbours, itself among them, is a core point.

    Returns
    -------
    array (H,) int
        A point near core points of several clusters gets the lowest of their labels.
    """
    n = position.shape[0]
    place = jnp.where(usable[:, None], position, 0.0)
    square = sum((place[:, None, i] - place[None, :, i]) ** 2 for i in range(position.shape[1]))
    near = (square <= eps**2) & usable[:, None] & usable[None]
    core = jnp.sum(near, axis=1) >= least
    # labels flow to neighbours until none changes
    joined = near & core[:, None] & core[None]
    label = jnp.where(core, jnp.arange(n), n)

    def spread(carry: tuple) -> tuple:
        label, _ = carry
        new = jnp.min(jnp.where(joined, label[None], n), axis=1)
        new = jnp.minimum(label, new)
        new = jnp.where(new < n, new[jnp.minimum(new, n - 1)], n)  # and to the label's own label
        return new, jnp.any(new != label)

    label, _ = jax.lax.while_loop(lambda c: c[1], spread, (label, jnp.asarray(True)))
    border = jnp.min(jnp.where(near & core[None], label[None], n), axis=1)
    label = jnp.where(core, label, border)
    return jnp.where(label < n, label, -1)


def _central(position: Any, member: Any) -> Any:
    """Index of the member nearest the median of the members' coordinates (2 or 3, H)."""
    count = jnp.maximum(jnp.sum(member), 1)
    ordered = jnp.sort(jnp.where(member[None], position, jnp.inf), axis=1)
    middle = (ordered[:, (count - 1) // 2] + ordered[:, count // 2]) / 2
    distance = sum((position[i] - middle[i]) ** 2 for i in range(len(position)))
    return jnp.argmin(jnp.where(member, distance, jnp.inf))


def _clustered(
    ping: Problem,
    delta: Any,
    early: Any,
    reach: Any,
    eps: Any,
    region: Any,
    *,
    d: int,
    most: int,
    least: int,
    rounds: int,
) -> tuple[dict, dict]:
    position, emission, exact = hypotheses(ping, d, most)
    usable = allowed(ping, position, reach, region) & exact
    few = jnp.sum(ping.heard) <= d + 1  # two roots are no crowd
    label = dbscan(position.T, usable, eps, least)
    label = jnp.where(few & usable, jnp.arange(len(label)), label)
    # the size of each point's cluster; the two largest
    same = (label[:, None] == label[None]) & (label[None] >= 0)
    size = jnp.sum(same, axis=1) * (label >= 0)
    first = label[jnp.argmax(size)]
    rest = jnp.where(label == first, 0, size)
    second = label[jnp.argmax(rest)]

    def place(_: Any, which: Any) -> tuple:
        index = _central(position, (label == which) & (label >= 0))
        return None, refine(ping, position[:, index], emission[index], delta, early, rounds)

    _, found = jax.lax.scan(place, None, jnp.stack([first, second]))
    places, emissions, used, cost = found
    some = jnp.stack([jnp.max(size) > 0, jnp.max(rest) > 0])
    return {"position": places, "emission": emissions, "cost": cost, "any": some}, {
        "used": jnp.moveaxis(used, 0, 1)
    }


def cluster(
    problem: Problem,
    d: int,
    *,
    eps: float = 50.0,
    least: int = 3,
    delta: float = 3.0,
    early: float = EARLY,
    reach: float = np.inf,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    most: int = 120,
    apart: float = 10.0,
    evidence: float = 6.0,
    rounds: int = 2,
) -> Found:
    """Robust positions by the largest cluster of hypotheses.

    Parameters
    ----------
    problem : Problem
        P pings of at least d + 1 arrivals.
    d : int
        2 or 3.
    eps : float
        DBSCAN's distance, m.
    least : int
        Its number of neighbours of a core point.
    delta, early, reach, region, prior, most, apart, evidence, rounds
        As of `maloc.points._robust.consensus`; the second largest cluster is the rival.
    """
    polygon = np.zeros((0, 2)) if region is None else np.asarray(region, float)
    value, each = in_batches(
        _clustered,
        problem,
        (),
        (delta, early, reach, eps, polygon),
        static={"d": d, "most": most, "least": least, "rounds": rounds},
        pings_last=False,
        largest=64,
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
