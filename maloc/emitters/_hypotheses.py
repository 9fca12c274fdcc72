"""Hypotheses of association: sets of arrivals that may be one emission, located and weighed.

Sets grow by one receiver at a time. Pairs must keep the limit of their distance; a set of three is
located in closed form (both roots), and one of more by least squares from its parent's place,
if what it adds lies in the gate around what the parent predicts.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from maloc.emitters.sensing import Sensing

__all__ = ["Hypotheses", "enumerate_hypotheses"]

_EXACT = 1e-3  # sigma of the reference's own arrival, as a share of the others'


class Hypotheses(NamedTuple):
    """H sets of arrivals.

    Attributes
    ----------
    member : array (H, R) of int
        Measurement at each receiver, -1 = none.
    position : array (H, 2)
        Metres.
    covariance : array (H, 3, 3)
        Of x, y and emission, m^2.
    emission : array (H,)
        Range of the emission, m, on the measurements' scale.
    log_ratio : array (H,)
        Log likelihood ratio against all being false.
    """

    member: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    emission: np.ndarray
    log_ratio: np.ndarray

    def rows(self, which: np.ndarray) -> Hypotheses:
        """The same for some of them."""
        return Hypotheses(*(a[which] for a in self))

    @staticmethod
    def none(r: int) -> Hypotheses:
        """No hypothesis of r receivers."""
        return Hypotheses(
            np.empty((0, r), int), np.empty((0, 2)), np.empty((0, 3, 3)), np.empty(0), np.empty(0)
        )


class _Arrivals(NamedTuple):
    """Arrivals in the order of their columns: range, sigma (N,) m, place (N, 2) m, row given."""

    range: np.ndarray
    sigma: np.ndarray
    place: np.ndarray
    column: np.ndarray
    row: np.ndarray


def enumerate_hypotheses(
    value: np.ndarray, column: np.ndarray, sensing: Sensing
) -> tuple[Hypotheses, int]:
    """All sets of three arrivals and more that pass the gates; and how many were cut off."""
    arrivals, known = _arrivals(value, column, sensing)
    together = _compatible(arrivals, sensing.gate)
    sets = np.zeros((1, 1), int) if known else np.arange(len(arrivals.range))[:, None]
    while sets.shape[1] < 3 and len(sets):
        parent, child = _children(sets, together)
        sets = np.concatenate([sets[parent], child[:, None]], axis=1)
    sets = sets.reshape(-1, 3)
    level = _triples(sets, arrivals, sensing)
    levels, cut = [], 0
    while len(level.set):
        weighed = _weigh(level, arrivals, known, sensing)
        if len(weighed.log_ratio) > sensing.most:
            best = np.argsort(-weighed.log_ratio, kind="stable")[: sensing.most]
            cut += len(weighed.log_ratio) - sensing.most
            level, weighed = _Level(*(a[best] for a in level)), weighed.rows(best)
        levels.append(weighed)
        level = _grow(level, weighed, arrivals, together, sensing)
    if not levels:
        return Hypotheses.none(len(sensing.receivers)), 0
    return Hypotheses(*(np.concatenate(part) for part in zip(*levels, strict=True))), cut


class _Level(NamedTuple):
    """Sets (H, m) of one size, with position (H, 2), emission's range (H,) and chi square (H,)."""

    set: np.ndarray
    position: np.ndarray
    emission: np.ndarray
    chi2: np.ndarray


def _arrivals(value: np.ndarray, column: np.ndarray, sensing: Sensing) -> tuple[_Arrivals, bool]:
    """Arrivals sorted by column; of differences the exact one at the reference comes first."""
    order = np.argsort(column, kind="stable")
    reach, sigma = value[order] * sensing.speed, np.full(len(value), sensing.sigma * sensing.speed)
    column, known = column[order], sensing.reference is not None
    if known:
        reach, order = np.append(0.0, reach), np.append(-1, order)
        sigma = np.append(_EXACT * sensing.sigma * sensing.speed, sigma)
        column = np.append(int(sensing.reference or 0), column)
    return _Arrivals(reach, sigma, sensing.receivers[column], column, order), known


def _compatible(arrivals: _Arrivals, gate: float) -> np.ndarray:
    """Which (N, N) two arrivals, the second later in order, can be of one emission."""
    apart = np.linalg.norm(arrivals.place[:, None] - arrivals.place, axis=2)
    slack = gate * np.hypot(arrivals.sigma[:, None], arrivals.sigma)
    near = np.abs(arrivals.range[:, None] - arrivals.range) <= apart + slack
    return np.triu(near & (arrivals.column[:, None] != arrivals.column), 1)


def _children(sets: np.ndarray, together: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each set with each later arrival that is compatible with all of it: parents and children."""
    parent, child = np.nonzero(together[sets].all(axis=1))
    return parent, child


def _triples(sets: np.ndarray, arrivals: _Arrivals, sensing: Sensing) -> _Level:
    n = len(sets)
    if not n:
        return _Level(sets, np.empty((0, 2)), np.empty(0), np.empty(0))
    size = 1 << max(7, (n - 1).bit_length())
    padded = np.pad(sets, ((0, size - n), (0, 0)), mode="edge")
    place = np.zeros((3, 3, size))
    place[:, :2] = arrivals.place[padded].transpose(1, 2, 0)
    roots = _minimal()(arrivals.range[padded].T, place)
    position = np.moveaxis(np.asarray(roots.position), 2, 1)[:, :n].reshape(-1, 2)
    emission = np.asarray(roots.emission)[:, :n].reshape(-1)
    sets = np.concatenate([sets, sets])
    predicted = emission[:, None] + _distance(position, arrivals.place[sets])
    z = (arrivals.range[sets] - predicted) / arrivals.sigma[sets]
    chi2 = (z**2).sum(axis=1)
    # a double root is one place; noise may leave no real root, then the nearest place must fit
    twice = np.zeros(2 * n, bool)
    twice[n:] = np.linalg.norm(position[:n] - position[n:], axis=1) < 1e-6
    good = (chi2 <= sensing.gate**2) & _inside(position, sensing) & ~twice
    return _Level(sets[good], position[good], emission[good], chi2[good])


@lru_cache(maxsize=1)
def _minimal() -> Any:
    from maloc._jax import jax
    from maloc.points._closed import minimal

    return jax.jit(partial(minimal, d=2))


def _grow(
    level: _Level, weighed: Hypotheses, arrivals: _Arrivals, together: np.ndarray, sensing: Sensing
) -> _Level:
    """Sets with one arrival more, located by least squares; the best place of each set."""
    parent, child = _children(level.set, together)
    at, place = level.position[parent], arrivals.place[child]
    off = arrivals.range[child] - level.emission[parent] - _distance(at, place)
    slope = (at - place) / np.maximum(np.linalg.norm(at - place, axis=1, keepdims=True), 1e-9)
    row = np.concatenate([slope, np.ones((len(slope), 1))], axis=1)
    spread = np.einsum("ci,cij,cj->c", row, weighed.covariance[parent], row)
    near = np.abs(off) <= sensing.gate * np.sqrt(spread + arrivals.sigma[child] ** 2)
    parent, child = parent[near], child[near]
    sets = np.concatenate([level.set[parent], child[:, None]], axis=1)
    if not len(sets):
        return _Level(sets, np.empty((0, 2)), np.empty(0), np.empty(0))
    position, emission, chi2 = _least_squares(sets, level.position[parent], arrivals)
    good = (chi2 <= sensing.gate**2 + sets.shape[1] - 3) & _inside(position, sensing)
    sets, position, emission, chi2 = (a[good] for a in (sets, position, emission, chi2))
    order = np.lexsort((chi2, *sets.T))
    sets, position, emission, chi2 = (a[order] for a in (sets, position, emission, chi2))
    new = np.ones(len(sets), bool)
    new[1:] = (np.diff(sets, axis=0) != 0).any(axis=1)
    return _Level(sets[new], position[new], emission[new], chi2[new])


def _least_squares(sets: np.ndarray, start: np.ndarray, arrivals: _Arrivals) -> tuple:
    from maloc.points._problem import Problem, in_batches

    reach, h = arrivals.range[sets], len(sets)
    first = reach.min(axis=1, keepdims=True)
    place = np.concatenate([arrivals.place[sets], np.zeros((*sets.shape, 1))], axis=2)
    problem = Problem(reach - first, np.ones(sets.shape, bool), arrivals.sigma[sets], place)
    found, _ = in_batches(_refine, problem, (start,), largest=128 if h <= 512 else 2048)
    return found["position"], found["emission"] + first[:, 0], found["cost"]


def _refine(ping: Any, start: Any) -> tuple[dict, dict]:
    from maloc._jax import jnp
    from maloc.points._lm import fit

    found = fit(ping, start, jnp.where(ping.heard, 1 / ping.sigma**2, 0.0), steps=12)
    return found._asdict(), {}


def _covariance(level: _Level, arrivals: _Arrivals) -> np.ndarray:
    """Covariance (H, 3, 3) of x, y and the emission's range, m^2; huge where they are not fixed."""
    offset = level.position[:, None] - arrivals.place[level.set]
    slope = offset / np.maximum(np.linalg.norm(offset, axis=2, keepdims=True), 1e-9)
    rows = np.concatenate([slope, np.ones((*level.set.shape, 1))], axis=2)
    rows = rows / arrivals.sigma[level.set][..., None]
    information = np.einsum("hmi,hmj->hij", rows, rows)
    floor = 1e-12 * np.trace(information, axis1=1, axis2=2)
    return np.linalg.inv(information + floor[:, None, None] * np.eye(3))


def _weigh(level: _Level, arrivals: _Arrivals, known: bool, sensing: Sensing) -> Hypotheses:
    covariance = _covariance(level, arrivals)
    own = arrivals.sigma[level.set]
    fit = -0.5 * level.chi2 - np.log(own * np.sqrt(2 * np.pi)).sum(axis=1)
    # Laplace's volume, no larger than all places and times there are
    volume = 1.5 * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(covariance)[1]
    volume = np.minimum(volume, np.log(sensing.expected / sensing.emission_density))
    heard = level.set[:, int(known) :]  # the reference takes part in everything
    n_listening = len(sensing.receivers) - int(known)
    n_missed = n_listening - heard.shape[1]
    chance = heard.shape[1] * np.log(sensing.p_detect)
    chance += n_missed * np.log(max(1 - sensing.p_detect, 1e-9))
    false = np.log(sensing.false_density)[arrivals.column[heard]].sum(axis=1)
    ratio = np.log(sensing.emission_density) + fit + volume + chance - false
    member = np.full((len(heard), len(sensing.receivers)), -1)
    np.put_along_axis(member, arrivals.column[heard], arrivals.row[heard], axis=1)
    return Hypotheses(member, level.position, covariance, level.emission, ratio)


def _distance(position: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Distances from positions (H, 2) to places (H, 2) or (H, m, 2), m."""
    if place.ndim == 3:
        position = position[:, None]
    return np.linalg.norm(position - place, axis=-1)


def _inside(position: np.ndarray, sensing: Sensing) -> np.ndarray:
    return np.all((position >= sensing.low) & (position <= sensing.high), axis=1)
