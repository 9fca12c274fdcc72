"""Between and beyond the states of a Gauss-Markov path: the exact conditional, and draws from it.

Given the states around it and the parameters, a state at any time is normal, and axes are
independent. With F, q the transition from the state before to the time asked for, and A, Q from
there to the state after,

    S = A q A' + Q,   K = q A' S^-1,   mean = (I - K A) F before + K after,
    variance = (I - K A) q (I - K A)' + K Q K'.

After the last state K is 0. Before the first one the path runs backward: a path in its stationary
state looks the same in reverse, with velocities turned round.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Between", "PathDraws", "between", "draw", "parts"]

_AT_ONCE = 500_000  # draws x times that are worked on together


class PathDraws(NamedTuple):
    """Draws of the path of one tag.

    Attributes
    ----------
    law : type
        Its distribution: `maloc.movement.CTCRW`, `Brownian` or `OU`.
    scale : dict of (D,) arrays
        What the law's ``step`` takes.
    clock : (D, T) array
        Times of the states (s), strictly ascending.
    state : (D, T, order, A) array
        Positions (m), and velocities (m/s) where the law has them.
    home : (D, A) array, optional
        What positions are pulled to (m), where the law knows it.
    water : Water, optional
        Positions are what it makes of the path's: off the land.
    depth : DepthDraws, optional
        The depth, where the track has one.
    """

    law: Any
    scale: dict[str, np.ndarray]
    clock: np.ndarray
    state: np.ndarray
    home: np.ndarray | None = None
    water: Any = None
    depth: Any = None

    def take(self, which) -> PathDraws:
        """Some of the draws."""
        scale = {k: v[which] for k, v in self.scale.items()}
        home = None if self.home is None else self.home[which]
        depth = None if self.depth is None else self.depth.take(which)
        state = self.state[which]
        return PathDraws(self.law, scale, self.clock[which], state, home, self.water, depth)


class Between(NamedTuple):
    """How states at (D, n) times hang on those around them.

    Attributes
    ----------
    after : (D, n) array of int
        State after; 0 before the first, T at the last and after it.
    from_before, from_after : (D, n, order, order) arrays
        State about home = from_before state[after - 1] + from_after state[after] + noise.
    variance : (D, n, order, order) array
        Of the noise, on each axis.
    """

    after: np.ndarray
    from_before: np.ndarray
    from_after: np.ndarray
    variance: np.ndarray


def between(path: PathDraws, times: np.ndarray) -> tuple[Between, np.ndarray]:
    """Conditional law of states at any times, given all states of each draw.

    Parameters
    ----------
    path : PathDraws
        D draws of T states.
    times : (D, n) array
        s.

    Returns
    -------
    Between, and the conditional means (D, n, order, A), m and m/s.
    """
    states = _about_home(path)
    length = states.shape[1]
    row = np.arange(len(states))[:, None]
    after = _after(path.clock, times)
    backward, ahead = after == 0, after < length
    nearest = path.clock[row, np.maximum(after - 1, 0)]
    target = path.clock[row, np.minimum(after, length - 1)]
    by_last, by_next, variance = _conditional(
        path, np.abs(times - nearest), target - times, ahead & ~backward, backward
    )
    none = np.zeros_like(by_last)
    back = backward[..., None, None]
    found = Between(
        after, np.where(back, none, by_last), np.where(back, by_last, by_next), variance
    )
    mean = found.from_before @ states[row, np.maximum(after - 1, 0)]
    mean += found.from_after @ states[row, np.minimum(after, length - 1)]
    return found, _from_home(path, mean)


def draw(rng: np.random.Generator, path: PathDraws, times: np.ndarray) -> np.ndarray:
    """Draw states at ascending times jointly, given all states of each draw.

    Parameters
    ----------
    rng : numpy.random.Generator
    path : PathDraws
        D draws of T states.
    times : (D, n) array
        s, ascending in each draw.

    Returns
    -------
    (D, n, order, A) array
        m and m/s.
    """
    out = np.concatenate([_draw(rng, path.take(part), times[part]) for part in parts(*times.shape)])
    if path.water is not None:
        out[:, :, 0] = path.water.off_land(out[:, :, 0])
    return out


def parts(draws: int, times: int) -> Iterator[slice]:
    """Slices of draws that are few enough to be worked on together."""
    size = max(1, _AT_ONCE // max(times, 1))
    for start in range(0, draws, size):
        yield slice(start, min(start + size, draws))


def _draw(rng, path: PathDraws, times: np.ndarray) -> np.ndarray:
    """One time after another, each given the one before it and the state after."""
    states = _about_home(path)
    length, n = states.shape[1], times.shape[1]
    row, column = np.arange(len(states))[:, None], np.arange(n)[None]
    after = _after(path.clock, times)
    backward = after == 0
    count = backward.sum(axis=1, keepdims=True)
    fresh = np.ones_like(after, bool)  # a time with no other between it and a state
    fresh[:, 1:] = after[:, 1:] != after[:, :-1]
    first = np.maximum.accumulate(np.where(fresh, column, 0), axis=1)
    rank = np.where(backward, count - 1 - column, column - first)
    last = np.where(backward, np.minimum(column + 1, n - 1), np.maximum(column - 1, 0))
    origin = np.maximum(after - 1, 0)
    since = np.where(rank == 0, path.clock[row, origin], times[row, last])
    target = np.minimum(after, length - 1)
    inside = ~backward & (after < length)
    by_last, by_next, variance = _conditional(
        path, np.abs(times - since), path.clock[row, target] - times, inside, backward
    )
    noise = _root(variance) @ rng.standard_normal((*after.shape, *states.shape[2:]))
    out = by_next @ states[row, target] + noise
    order = np.argsort(rank, axis=None, kind="stable")
    for now in np.split(order, np.cumsum(np.bincount(rank.ravel()))[:-1]):
        d, i = np.unravel_index(now, rank.shape)
        some = rank[d[0], i[0]] > 0
        known = out[d, last[d, i]] if some else states[d, origin[d, i]]
        out[d, i] += by_last[d, i] @ known
    return _from_home(path, out)


def _after(clock: np.ndarray, times: np.ndarray) -> np.ndarray:
    """State after each time (D, n): 0, ..., T."""
    found = [np.searchsorted(c, t, side="right") for c, t in zip(clock, times, strict=True)]
    return np.array(found).reshape(times.shape)


def _about_home(path: PathDraws) -> np.ndarray:
    return path.state if path.home is None else path.state - path.home[:, None, None]


def _from_home(path: PathDraws, state: np.ndarray) -> np.ndarray:
    return state if path.home is None else state + path.home[:, None, None]


def _conditional(path: PathDraws, since, ahead, inside, backward):
    """Weights of the state before and of the state after, and variance, (D, n, order, order).

    ``since`` seconds after the one, ``ahead`` before the other, which counts where ``inside``;
    where ``backward`` time runs the other way.
    """
    scale = {k: v[:, None] for k, v in path.scale.items()}
    f, q = path.law.step(since, **scale)
    turn = np.asarray(path.law.turn)
    turn = np.where(backward[..., None, None], np.outer(turn, turn), 1.0)
    f, q = f * turn, q * turn
    a, more = path.law.step(np.where(inside, ahead, 1.0), **scale)
    reach = a @ q
    gain = np.swapaxes(reach, -1, -2) @ _inverse(reach @ np.swapaxes(a, -1, -2) + more)
    gain = np.where(inside[..., None, None], gain, 0.0)
    rest = np.eye(len(path.law.turn)) - gain @ a
    variance = rest @ q @ np.swapaxes(rest, -1, -2) + gain @ more @ np.swapaxes(gain, -1, -2)
    return rest @ f, gain, variance


def _inverse(s: np.ndarray) -> np.ndarray:
    """Inverse of positive definite matrices of order 1 or 2."""
    if s.shape[-1] == 1:
        return 1.0 / s
    det = s[..., 0, 0] * s[..., 1, 1] - s[..., 0, 1] * s[..., 1, 0]
    out = -s / det[..., None, None]
    out[..., 0, 0], out[..., 1, 1] = s[..., 1, 1] / det, s[..., 0, 0] / det
    return out


def _root(v: np.ndarray) -> np.ndarray:
    """Lower triangular root of matrices of order 1 or 2, singular ones too."""
    out = np.zeros_like(v)
    out[..., 0, 0] = np.sqrt(np.maximum(v[..., 0, 0], 0.0))
    if v.shape[-1] == 2:
        lead = np.where(out[..., 0, 0] > 0, out[..., 0, 0], 1.0)
        out[..., 1, 0] = v[..., 1, 0] / lead
        out[..., 1, 1] = np.sqrt(np.maximum(v[..., 1, 1] - out[..., 1, 0] ** 2, 0.0))
    return out
