"""A long chain's derivatives from windows of one shape, which is all that is ever compiled.

Neighbouring windows share one state. With V the negative log joint of a stretch as a chain of its
own, V(a..c) = V(a..b) + V(b..c) - V(b): what the two windows both say of the state they share,
priors of the parameters included, is what that state says alone. Value, gradient and band follow
by adding up, exactly; the cost is linear in the length, where one long array falls out of the
processor's cache.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from maloc._jax import jax
from maloc.infer._model import ChainModel
from maloc.infer.mode import find_mode
from maloc.model_data.toa import ToaData

__all__ = ["SIZE", "Windows", "cut", "padded", "settled"]

SIZE = 512  # states a window


def cut(args: tuple, start: int, stop: int) -> tuple:
    """States start to stop (exclusive) of a model's arguments, the first of which is the data.

    Of the data's arrays those with an element a state, or a step, are cut; all others are shared.
    """
    data, *others = args
    length = len(data.valid)

    def part(leaf):
        n = np.shape(leaf)[0] if np.ndim(leaf) else 0
        if n == length:
            return leaf[start:stop]
        return leaf[start : stop - 1] if n == length - 1 else leaf

    return (jax.tree.map(part, data), *others)


def padded(data: ToaData, length: int) -> ToaData:
    """The valid states of `data` (NumPy arrays), continued by states that nobody heard."""
    data = jax.tree.map(np.asarray, data)
    n, more = int(data.valid.sum()), length - int(data.valid.sum())
    (data,) = cut((data,), 0, n)

    def longer(leaf):
        rows = np.shape(leaf)[0] if np.ndim(leaf) else 0
        if rows not in (n, n - 1):
            return leaf
        width = [(0, more), *[(0, 0)] * (np.ndim(leaf) - 1)]
        return np.pad(leaf, width) if leaf.dtype == bool else np.pad(leaf, width, mode="edge")

    out = jax.tree.map(longer, data)
    step = float(np.median(data.dt))
    time = np.append(data.time, data.time[-1] + step * np.arange(1, more + 1))
    dt = np.append(data.dt, np.full(more, step))
    known = np.append(data.n_intervals, np.zeros(more))
    return dataclasses.replace(out, time=time, dt=dt, n_intervals=known)


class Windows:
    """What `find_mode` and the marginal ask of a `ChainModel`, for a long chain.

    Parameters
    ----------
    cm : ChainModel
        Of a model without sites that are local (see `ChainModel`).
    args : tuple
        Arguments; the chain's length is one more than a multiple of ``size`` - 1.
    size : int
        States a window.
    """

    has_local = False

    def __init__(self, cm: ChainModel, args: tuple, size: int = SIZE) -> None:
        self.cm, self.d, self.k = cm, cm.d, cm.k
        self.inner, self.outer = cm.inner, cm.outer
        length = len(args[0].valid)
        starts = range(0, length - 1, size - 1)
        spans = [(s, s + size, 1.0) for s in starts] + [(s, s + 1, -1.0) for s in starts[1:]]
        self._parts = [(slice(a, b), sign, cut(args, a, b)) for a, b, sign in spans]

    def terms(self, x, u, args: Any, temper: float, robust: bool):
        """Value, gradient (T, d) and Gauss-Newton band (2 d, T d); ``args`` are the windows'."""
        return self._sum(self.cm.terms, x, u, temper, robust)

    def exact(self, x, u, args: Any, temper: float):
        """Value, gradient (T, d) and exact band (2 d, T d)."""
        return self._sum(self.cm.exact, x, u, temper)

    def cross(self, x, u, args: Any) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the gradients by the outer parameters, (n, T, d) and (n, k)."""
        n = len(self.outer)
        path, own = np.zeros((n, *x.shape)), np.zeros((n, self.k))
        for place, sign, part in self._parts:
            found = self.cm.cross(x[place], u, part)
            path[:, place] += sign * found[0]
            own += sign * found[1]
        return path, own

    def gradients(self, x, u, args: Any, temper: float):
        """Gradients in path (T, d) and parameters (k,)."""
        path, own = np.zeros(x.shape), np.zeros(self.k)
        for place, sign, part in self._parts:
            found = self.cm.gradients(x[place], u, part, temper)
            path[place] += sign * np.asarray(found[0])
            own += sign * np.asarray(found[1])
        return path, own

    def border(self, x, u, args: Any):
        """As `maloc.infer._border.border`."""
        m = len(self.inner)
        mixed, block = np.zeros((m, *x.shape)), np.zeros((m, m))
        for place, sign, part in self._parts:
            found = self.cm.border(x[place], u, part)
            mixed[:, place] += sign * np.asarray(found[0])
            block += sign * np.asarray(found[1])
        return mixed, block

    def _sum(self, function, x, u, *how):
        value, gradient = 0.0, np.zeros(x.shape)
        band = np.zeros((2 * self.d, x.size))
        for place, sign, own in self._parts:
            found = function(x[place], u, own, *how)
            value += sign * float(found[0])
            gradient[place] += sign * np.asarray(found[1])
            columns = slice(place.start * self.d, place.stop * self.d)
            band[:, columns] += sign * np.asarray(found[2])
        return value, gradient, band


class _Held:
    """A window as a chain of its own, its first or last state held where it is."""

    has_local = False

    def __init__(self, cm: ChainModel, first: bool, last: bool) -> None:
        self.cm, self.d, self.first, self.last = cm, cm.d, first, last

    def terms(self, *args):
        return self._hold(*self.cm.terms(*args))

    def exact(self, *args):
        return self._hold(*self.cm.exact(*args))

    def _hold(self, value, gradient, band):
        gradient, band, d = np.array(gradient), np.array(band), self.d
        if self.first:
            gradient[0] = 0.0
            band[:, :d] = 0.0
            band[0, :d] = 1.0
        if self.last:
            gradient[-1] = 0.0
            band[:, -d:] = 0.0
            band[0, -d:] = 1.0
            for column in range(d):  # what ties the state before to it
                band[d - column :, column - 2 * d] = 0.0
        return value, gradient, band


def settled(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray, size: int) -> np.ndarray:
    """Path (T, d) nearer to the mode: window by window, then by windows over their seams.

    A place that takes many steps, or whose curvature is indefinite on the way, holds up its own
    window and not the whole chain.
    """
    x, length = np.array(x), len(x)
    for shift in (0, size // 2):
        for start in range(shift, length - size + 1, size - 1):
            place = slice(start, start + size)
            held: Any = _Held(cm, start > 0, start + size < length)
            x[place] = find_mode(held, cut(args, start, start + size), x[place], u, tol=1e-5).x
    return x
