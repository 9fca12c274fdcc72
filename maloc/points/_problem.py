"""Pings as padded arrays: the shape in which every method of `maloc.points` sees its data.

A method is a function of one ping (arrays over its M arrivals, masked) that is vmapped over pings.
`in_batches` runs it over pings sorted into widths, so that a ping of five arrivals costs five and
one compilation serves every data set.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from maloc.data.arrivals import ArrivalTimes

__all__ = [
    "Found",
    "Problem",
    "in_batches",
    "problem_of",
    "ranges_of",
    "residuals",
    "spread_columns",
]

_WIDTHS = (4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)


class Problem(NamedTuple):
    """The arrivals of P pings, best first (smallest sigma, then earliest), padded to M.

    Inside a vmapped method the leading axis P is gone.

    Attributes
    ----------
    range : array (P, M)
        Sound speed x (arrival - first arrival of the ping), m; 0 in padding.
    heard : array (P, M) bool
        False in padding.
    sigma : array (P, M)
        Standard deviation of each arrival's error, m; 1 in padding.
    place : array (P, M, 3)
        Receiver's x, y and depth, m. For positions in the plane the depth is below the tag, and 0
        where depths play no part.
    """

    range: Any
    heard: Any
    sigma: Any
    place: Any

    def rows(self, which: Any) -> Problem:
        """The same for some pings."""
        return Problem(*(a[which] for a in self))


class Found(NamedTuple):
    """What a method returns for P pings of a `Problem`; `maloc.points.locate` makes `Points` of it.

    Attributes
    ----------
    position : array (P, d)
        Metres; NaN where none.
    emission : array (P,)
        Emission's range, m: sound speed x (emission - first arrival), so mostly negative.
    used : array (P, M) bool
        Arrivals that the position rests on, in the problem's order.
    ambiguous : array (P,) bool
        The arrivals do not settle the place.
    alternative : array (P, d)
        Another place that fits; NaN where none.
    why : array (P,) of str
        Why there is no position; "" where there is one.
    covariance : array (P, d, d) or None
        None: by `maloc.points.covariance.covariance` from those used.
    agreed : array (P, M) bool or None
        Arrivals that agree whichever of two places is right; None: those used.
    other : Found or None
        The alternatives, where the method knows more of them than the place.
    extra : dict
        Arrays (P, ...) for `Points.extra`.
    arrival_extra : dict
        Arrays (P, M), brought to (P, R) for `Points.extra`; NaN where not heard.
    scale : float
        Factor by which the method improved the arrivals' sigma.
    """

    position: np.ndarray
    emission: np.ndarray
    used: np.ndarray
    ambiguous: np.ndarray
    alternative: np.ndarray
    why: np.ndarray
    covariance: np.ndarray | None = None
    agreed: np.ndarray | None = None
    other: Found | None = None
    extra: dict[str, np.ndarray] = {}
    arrival_extra: dict[str, np.ndarray] = {}
    scale: float = 1.0

    def rows(self, which: np.ndarray) -> Found:
        """The same for some pings."""

        def cut(part: Any) -> Any:
            if isinstance(part, dict):
                return {k: v[which] for k, v in part.items()}
            if isinstance(part, Found):
                return part.rows(which)
            return part[which] if isinstance(part, np.ndarray) else part

        return Found(*(cut(part) for part in self))


def ranges_of(toa: ArrivalTimes) -> np.ndarray:
    """Sound speed x (arrival - the ping's first arrival), (P, R) m; NaN where not heard."""
    first = np.where(toa.heard, toa.toa, np.inf).min(axis=1, keepdims=True)
    return (toa.toa - np.where(np.isfinite(first), first, np.nan)) * toa.sound_speed[:, None]


def residuals(problem: Problem, found: Found) -> np.ndarray:
    """Residuals (P, M) m at the positions found."""
    d = found.position.shape[1]
    offset = found.position[:, None] - problem.place[..., :d]
    square = (offset**2).sum(-1) + (0.0 if d == 3 else problem.place[..., 2] ** 2)
    return problem.range - found.emission[:, None] - np.sqrt(square)


def problem_of(
    ranges: np.ndarray, xy: np.ndarray, below: np.ndarray, sigma: np.ndarray
) -> tuple[Problem, np.ndarray]:
    """Return the padded arrays of all pings, and the column (P, M) each arrival came from.

    Parameters
    ----------
    ranges : array (P, R)
        Sound speed x (arrival - first arrival), m; NaN = not heard.
    xy : array (R, 2)
        Receivers, m.
    below : array (P, R)
        What goes into `Problem.place` as depth, m.
    sigma : array (P, R)
        Standard deviation of an arrival's error, m.
    """
    heard = np.isfinite(ranges)
    width = int(max(heard.sum(1).max(initial=0), 1))
    ranges = np.where(heard, ranges, np.inf)
    column = np.argsort(ranges, axis=1, kind="stable")
    if np.ptp(sigma, axis=1).any():
        ordered = np.take_along_axis(np.where(heard, sigma, np.inf), column, axis=1)
        column = np.take_along_axis(column, np.argsort(ordered, axis=1, kind="stable"), axis=1)
    column = column[:, :width]
    kept = np.take_along_axis(heard, column, axis=1)
    place = np.empty((*column.shape, 3))
    place[..., :2] = xy[column]
    place[..., 2] = np.take_along_axis(below, column, axis=1)
    return Problem(
        range=np.where(kept, np.take_along_axis(ranges, column, axis=1), 0.0),
        heard=kept,
        sigma=np.where(kept, np.take_along_axis(sigma, column, axis=1), 1.0),
        place=np.where(kept[..., None], place, 0.0),
    ), column


def spread_columns(values: np.ndarray, column: np.ndarray, n: int, fill: Any) -> np.ndarray:
    """Bring (P, M) values to their columns (P, n)."""
    out = np.full((len(values), n), fill, values.dtype)
    np.put_along_axis(out, column, values, axis=1)
    return out


@lru_cache(maxsize=64)
def _compiled(solve: Callable, static: tuple, n_per_ping: int, n_shared: int, axis: int) -> Any:
    from maloc._jax import jax

    axes = (Problem(axis, axis, axis, axis), *(axis,) * n_per_ping, *(None,) * n_shared)
    one = partial(solve, **dict(static))
    return jax.jit(jax.vmap(one, in_axes=axes, out_axes=axis))


def in_batches(
    solve: Callable,
    problem: Problem,
    per_ping: tuple = (),
    shared: tuple = (),
    *,
    static: dict[str, Any] | None = None,
    pings_last: bool = True,
    largest: int = 128,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Run a function of one ping over all of them.

    Parameters
    ----------
    solve : callable
        ``solve(ping, *per_ping, *shared, **static) -> (values, arrival_values)``: two dicts, the
        second of arrays whose first axis is the M arrivals. A module's function, in JAX, free of
        NaN traps in padding.
    problem : Problem
        P pings.
    per_ping : tuple of array (P, ...)
        Further arguments, one row a ping.
    shared : tuple
        Arguments that all pings share; traced, so that their values compile nothing.
    static : dict, optional
        Hashable keyword arguments.
    pings_last : bool
        Lay pings out along the last axis (fast where each ping's arrays are small) or the first.
    largest : int
        Pings in one call; fewer are padded to it.

    Returns
    -------
    tuple of two dicts
        Arrays (P, ...) and (P, M, ...).
    """
    axis = -1 if pings_last else 0
    key = tuple(sorted((static or {}).items()))
    run = _compiled(solve, key, len(per_ping), len(shared), axis)
    count = problem.heard.sum(axis=1)
    n, m = problem.heard.shape
    per_ping = tuple(np.asarray(a) for a in per_ping)
    values: dict[str, np.ndarray] = {}
    arrivals: dict[str, np.ndarray] = {}
    width = np.array([_width(k) for k in range(int(count.max(initial=0)) + 1)])[count]
    for w in np.unique(width):
        mine = np.flatnonzero(width == w)
        for rows in np.split(mine, range(largest, len(mine), largest)):
            parts = [_cut(a, rows, largest, int(w), axis) for a in problem]
            more = [_cut(a, rows, largest, None, axis) for a in per_ping]
            one, each = run(Problem(*parts), *more, *shared)
            for out, found, extra in ((values, one, False), (arrivals, each, True)):
                for name, value in found.items():
                    got = np.moveaxis(np.asarray(value), axis, 0)[: len(rows)]
                    if extra:
                        got = got[:, :m]
                    shape = (n, m, *got.shape[2:]) if extra else (n, *got.shape[1:])
                    into = out.setdefault(name, np.zeros(shape, got.dtype))
                    if extra:
                        into[rows, : got.shape[1]] = got
                    else:
                        into[rows] = got
    return values, arrivals


def _width(count: int) -> int:
    return next((w for w in _WIDTHS if w >= count), count)


def _cut(a: np.ndarray, rows: np.ndarray, size: int, width: int | None, axis: int) -> np.ndarray:
    """Rows of `a`, padded by the last to `size`, arrivals cut or padded to `width`."""
    out = a[np.pad(rows, (0, size - len(rows)), mode="edge")]
    if width is not None:
        out = out[:, :width]
        if out.shape[1] < width:
            fill = [(0, 0), (0, width - out.shape[1])] + [(0, 0)] * (out.ndim - 2)
            out = np.pad(out, fill)
    return np.ascontiguousarray(np.moveaxis(out, 0, axis))
