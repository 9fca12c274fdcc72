"""A path from single pings: places that three arrivals fit exactly, joined by likely steps.

Annealed from wide errors a track can settle where all arrivals fit badly, though most of them fit
one place well and the rest are late. Here each ping brings the places that some three of its
arrivals agree on, scored by all of them at one scale of the direct error, and the path through
them of the highest score is found by dynamic programming: a start for that scale.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

__all__ = ["Places", "joined", "ping_paths", "places"]

_SETS = 35  # of the first arrivals
_KEPT = 24  # places a ping, best first
_NOWHERE = 1e6  # m
_ROUNDS = 3
_FAR = 30.0  # m; a round moves a place no further
_LATE = 0.2
_WILD = 1e-3
_FAST = 0.5  # m/s


@partial(jax.jit, static_argnames="most")
def _places(ranges, heard, place, most: int):
    """Places and emissions (T, H, 3), and residuals (T, H, M) m there, of T pings."""
    from maloc.points._closed import minimal
    from maloc.points._hypotheses import sets

    chosen = sets(ranges.shape[1], 3, most)
    arrival = jnp.moveaxis(ranges[:, chosen], 2, 0)
    roots = minimal(arrival, jnp.transpose(place[:, chosen], (2, 3, 0, 1)), 2)
    xy = jnp.where(jnp.all(heard[:, chosen], axis=2)[None, None], roots.position, jnp.nan)
    xy = jnp.moveaxis(jnp.concatenate([xy[0], xy[1]], axis=2), 0, 2)
    emission = jnp.concatenate([roots.emission[0], roots.emission[1]], axis=1)
    off = xy[:, :, None] - place[:, None, :, :2]
    away = jnp.sqrt(jnp.sum(off**2, axis=3) + place[:, None, :, 2] ** 2)
    residual = ranges[:, None] - emission[:, :, None] - away
    return jnp.concatenate([xy, emission[:, :, None]], axis=2), residual


class Places(NamedTuple):
    """Places of n pings that were heard by three receivers or more.

    rows (n,): states; state (n, H, 3) m: x, y and emission, NaN where there is none; residual
    (n, H, M) m of the M arrivals in order; range, heard (n, M); place (n, M, 3) of who heard them.
    """

    rows: np.ndarray
    state: np.ndarray
    residual: np.ndarray
    range: np.ndarray
    heard: np.ndarray
    place: np.ndarray

    def best(self, sigma: float, phi: float) -> tuple[np.ndarray, np.ndarray]:
        """The K best, each moved to the least squares of what is direct there, at sigma (m).

        Returns
        -------
        state (n, K, 3), score (n, K)
        """
        score = _scores(self.residual, self.heard, sigma, phi)
        score = np.where(np.isfinite(self.state[..., 0]), score, -1e9)
        kept = np.argsort(-score, axis=1)[:, :_KEPT]
        state = np.take_along_axis(self.state, kept[..., None], axis=1)
        state = np.nan_to_num(state, nan=_NOWHERE, posinf=_NOWHERE, neginf=-_NOWHERE)
        first, score = state, np.take_along_axis(score, kept, axis=1)
        for _ in range(_ROUNDS):
            state = state + self._step(state, sigma, phi)
        moved = _scores(self._seen(state)[0], self.heard, sigma, phi)
        better = moved > score
        return np.where(better[..., None], state, first), np.where(better, moved, score)

    def _seen(self, state: np.ndarray):
        """Residuals (n, K, M) at states, and the steps to each receiver (n, K, M, 2)."""
        off = state[:, :, None, :2] - self.place[:, None, :, :2]
        away = np.sqrt(np.sum(off**2, axis=3) + self.place[:, None, :, 2] ** 2 + 1e-6)
        residual = self.range[:, None] - state[:, :, None, 2] - away
        return residual, off / away[..., None]

    def _step(self, state: np.ndarray, sigma: float, phi: float) -> np.ndarray:
        """One weighted least squares step (n, K, 3), weights the probabilities of being direct."""
        residual, slope = self._seen(state)
        direct, rest = _log_parts(residual, sigma, phi)
        weight = np.where(self.heard[:, None], 1 / (1 + np.exp(np.minimum(rest - direct, 50))), 0.0)
        slope = np.concatenate([slope, np.ones((*residual.shape, 1))], axis=3)
        normal = np.einsum("nkm,nkmi,nkmj->nkij", weight, slope, slope) + 1e-3 * np.eye(3)
        right = np.einsum("nkm,nkmi->nki", weight * residual, slope)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        return np.clip(step, -_FAR, _FAR)


def places(data: ToaData | JointData) -> Places | None:
    """Places that arrivals of single pings fit; None where fewer than two pings have three."""
    heard = np.asarray(data.heard)
    rows = np.flatnonzero(heard.sum(axis=1) >= 3)
    if len(rows) < 2:
        return None
    ranges = np.where(heard, np.asarray(data.range), np.inf)
    order = np.argsort(ranges, axis=1, kind="stable")
    place = np.zeros((*heard.shape, 3))
    place[..., :2] = np.asarray(data.receiver_xy)[order]
    if data.depth is not None:
        below = np.asarray(data.depth.receiver) - np.asarray(data.depth.initial)[:, None]
        place[..., 2] = np.take_along_axis(np.broadcast_to(below, heard.shape), order, axis=1)
    kept = np.take_along_axis(heard, order, axis=1)
    ranges = np.where(kept, np.take_along_axis(ranges, order, axis=1), 0.0)
    state, residual = (np.asarray(a)[rows] for a in _places(ranges, kept, place, _SETS))
    residual = np.nan_to_num(residual, nan=_NOWHERE, posinf=_NOWHERE, neginf=-_NOWHERE)
    return Places(rows, state, residual, ranges[rows], kept[rows], place[rows])


def ping_paths(data: ToaData | JointData, sigmas: tuple[float, ...]):
    """Paths through places of single pings, one for each scale (m) of the direct error.

    Parameters
    ----------
    data : ToaData or JointData
        T states.
    sigmas : tuple of float
        m.

    Returns
    -------
    list of (xy, emission)
        xy (T, 2) m, straight in time between pings of three arrivals or more; emission (T,) m, NaN
        where a ping has fewer. Empty where fewer than two pings have three.
    """
    found = places(data)
    if found is None:
        return []
    return [
        joined(data, found.rows, *found.best(sigma, float(data.phi)), sigma) for sigma in sigmas
    ]


def joined(data, rows, state, score, sigma: float, speed: float = _FAST, df: float = 2.0):
    """The likeliest path through places (n, K, 3) of the states `rows` (n,), of each tag alone."""
    tag = np.asarray(data.tag) if isinstance(data, JointData) else np.zeros(len(data.time), int)
    time = np.asarray(data.time)
    whole, when = np.tile(np.asarray(data.centre), (len(time), 1)), np.full(len(time), np.nan)
    for one in np.unique(tag[rows]):
        of, mine = np.flatnonzero(tag[rows] == one), tag == one
        at = time[rows[of]]
        pick = _likeliest(state[of, :, :2], score[of], at, sigma, speed, df)
        path = state[of, pick]
        whole[mine] = np.stack([np.interp(time[mine], at, path[:, i]) for i in (0, 1)], axis=1)
        when[rows[of]] = path[:, 2]
    return whole, when


def _log_parts(residual: np.ndarray, sigma: float, phi: float) -> tuple[np.ndarray, np.ndarray]:
    """Log densities of residuals (m) as direct arrivals, and as late by up to phi or wild ones."""
    direct = np.log1p(-_LATE) - np.log(sigma) - 0.5 * np.log(2 * np.pi)
    direct = direct - 0.5 * (residual / sigma) ** 2
    late = (residual > 0) & (residual < phi)
    return direct, np.where(late, np.log((_LATE + _WILD) / phi), np.log(_WILD / phi))


def _scores(residual: np.ndarray, heard: np.ndarray, sigma: float, phi: float) -> np.ndarray:
    """Log likelihoods (n, H) of residuals (n, H, M) m."""
    each = np.logaddexp(*_log_parts(residual, sigma, phi))
    return np.where(heard[:, None], each, 0.0).sum(axis=2)


def _likeliest(
    xy: np.ndarray, score: np.ndarray, time: np.ndarray, sigma: float, speed: float, df: float
) -> np.ndarray:
    """Which of the places (T, K, 2) the likeliest path takes: Viterbi, steps of Student t."""
    best, back = score[0], []
    for t in range(1, len(xy)):
        far = np.sum((xy[t][None] - xy[t - 1][:, None]) ** 2, axis=2)
        size = (speed * (time[t] - time[t - 1])) ** 2 + 4 * sigma**2
        total = best[:, None] - (df / 2 + 1) * np.log1p(far / (df * size))
        back.append(total.argmax(axis=0))
        best = total.max(axis=0) + score[t]
    path = [int(best.argmax())]
    for step in back[::-1]:
        path.append(int(step[path[-1]]))
    return np.array(path[::-1])
