"""Missed pings summed out: the thinned-renewal likelihood of the gaps between heard pings.

A tag pings at intervals of a known law; a ping sent where q is the chance that nobody hears it is
missed with probability q. The likelihood of a gap of D seconds, whatever number of pings was missed
in it and whenever, solves a renewal equation (Cox 1962, Renewal Theory, thinned):

    G(s) = f(s) + integral_0^s G(s') q(s') f(s - s') ds'.

How a gap is computed, by a fixed rule:

- Poisson cues: closed form (`maloc.schedule.renewal.poisson`).
- Laws of sd < .06 mean, and stable ones: the sum over counts, pings evenly spread given their
  number (`maloc.schedule.renewal.counts`).
- Gaps longer than max(10, .36 mean^2 / sd^2) mean intervals: the adiabatic closed form, in which
  G decays at the rate of the local q (`maloc.schedule.renewal.long`).
- All others: the equation itself on a grid of an eighth of the shortest interval, log q linear
  between the path's nodes (`maloc.schedule.renewal.grid`, `maloc.schedule.renewal.exact`).

For intervals of 1 to 2 s, log G is within .008 of simulation (12 cases, 2.2 to 12.2 s, 1e6 draws);
the adiabatic form is within .1 of the grid at 16 and 30 s. Nodes about a shortest interval apart
move log G of one gap by .07 to .12 (sd) against a path known everywhere, -.01 to .004 on average,
for the paper's walk through its array (sd .25 m per root s, detection scale .75 m).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from maloc._jax import jax, jnp
from maloc.data._padding import bucket
from maloc.schedule.intervals import IntervalLaw, interval_law
from maloc.schedule.renewal import counts, draw, exact, long, pack, poisson
from maloc.schedule.renewal.gap import Gap, gap_nodes

__all__ = [
    "Gap",
    "Gaps",
    "draw_missed",
    "gap_log_likelihood",
    "gap_nodes",
    "interval_law",
    "missed_mean",
    "missed_pmf",
    "pack_gaps",
]


@dataclass(frozen=True)
class Gaps:
    """All gaps of a data set, ready for the likelihood: a pytree, the law static.

    Attributes
    ----------
    parts : tuple
        Batches of gaps of one kind of computation and like size.
    constant : (G,)
        Log likelihood of gaps that say nothing of the path; 0 for the others and for padding.
    impossible : (G,) bool
        Gaps that no number of missed pings explains: they have the floor's likelihood.
    valid : (G,) bool
        False for padding.
    law : IntervalLaw
        Law of the burst interval, static.
    """

    parts: tuple[Any, ...]
    constant: np.ndarray
    impossible: np.ndarray
    valid: np.ndarray
    law: IntervalLaw


jax.tree_util.register_dataclass(
    Gaps, data_fields=["parts", "constant", "impossible", "valid"], meta_fields=["law"]
)


def pack_gaps(
    gaps: list[Gap], law: IntervalLaw, *, pad: bool = True, like: Gaps | None = None
) -> Gaps:
    """Arrays of the gaps of a data set, weights included.

    Parameters
    ----------
    gaps : list of Gap
    law : IntervalLaw
        Law of the burst interval.
    pad : bool
        Pad every batch to a bucket, so that one compilation serves many data sets.
    like : Gaps, optional
        Pad every batch at least to the size it has there.

    Returns
    -------
    Gaps
    """
    size = bucket(len(gaps)) if pad else len(gaps)
    if like is not None:
        size = max(size, len(like.valid))
    constant, impossible = np.zeros(size), np.zeros(size, bool)
    parts, alone, ruled_out = pack.parts_of(gaps, law, size, pad, like.parts if like else ())
    constant[: len(gaps)], impossible[: len(gaps)] = alone, ruled_out
    packed = Gaps(tuple(parts), constant, impossible, np.arange(size) < len(gaps), law)
    return jax.device_put(packed)


_MODULES = {
    exact.ExactPart: exact,
    long.LongPart: long,
    counts.CountPart: counts,
    poisson.PoissonPart: poisson,
}


@jax.jit
def gap_log_likelihood(gaps: Gaps, log_q):
    """Log likelihood of every gap, the missed pings in it summed out.

    Parameters
    ----------
    gaps : Gaps
    log_q : (S,)
        Log probability that a ping sent at each state of the chain is heard by nobody.

    Returns
    -------
    (G,) array
        Log density of the gap (inside: of the next heard ping's time; before: of the first heard
        ping's time), or log probability of the silence (after); 0 for padding. Differentiable
        twice.
    """
    total = jnp.concatenate([gaps.constant, jnp.zeros(1)])
    for part in gaps.parts:
        value = _MODULES[type(part)].log_likelihood(part, log_q)
        total = total.at[part.index].add(jnp.where(part.index < len(gaps.valid), value, 0.0))
    return total[:-1]


@jax.jit
def missed_mean(gaps: Gaps, log_q):
    """Expected number of missed pings in every gap given the path, (G,).

    The derivative of log G when every log q grows alike: each missed ping brings one factor q.
    """
    return jax.jvp(lambda v: gap_log_likelihood(gaps, v), (log_q,), (jnp.ones_like(log_q),))[1]


@partial(jax.jit, static_argnames="most")
def missed_pmf(gaps: Gaps, log_q, most: int):
    """Probabilities of 0..most missed pings in every gap given the path.

    Parameters
    ----------
    gaps : Gaps
    log_q : (S,)
        See `gap_log_likelihood`.
    most : int
        Last count; the chance of more is what is missing from 1.

    Returns
    -------
    (G, most + 1) array
        Exact; in the adiabatic form normal with the exact mean and variance. Padding: count 0.
    """
    out = jnp.zeros((len(gaps.valid) + 1, most + 1)).at[:, 0].set(1.0)
    for part in gaps.parts:
        pmf = jnp.exp(_MODULES[type(part)].log_pmf(part, log_q, most))
        out = out.at[part.index].set(pmf)
    return out[:-1]


def draw_missed(rng: np.random.Generator, gaps: Gaps, log_q) -> list[np.ndarray]:
    """One draw of the missed pings' times in every gap given the path.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    gaps : Gaps
    log_q : (S,)
        See `gap_log_likelihood`; one draw of the path's.

    Returns
    -------
    list of (n,) array
        Seconds after each gap's start, ascending; padding left out. Gaps that the law rules out
        have none. Exact but for the grid, in long gaps too; laws that hardly vary: spread evenly,
        with the interval's own scatter.
    """
    log_q = np.asarray(log_q, float)
    out = [np.empty(0)] * int(np.sum(gaps.valid))
    for part in gaps.parts:
        if np.all(np.asarray(part.index) >= len(out)):
            continue  # padding only
        rows = draw.draw_part(rng, part, gaps.law, log_q)
        for i, times in zip(np.asarray(part.index), rows, strict=True):
            if i < len(out):
                out[i] = times
    return out
