"""Long tracks: parameters from blocks, paths from overlapping windows, then the whole chain.

1. Blocks spread over the track are fitted one by one; their estimates, weighted by their
   precisions, are where the parameters start.
2. The path is found window by window at these parameters. Windows overlap, and only their middles
   are kept.
3. Each window, and then each seam, goes to its mode with its ends held, and Newton's method from
   there to that of the whole chain, whose derivatives are sums over windows
   (`maloc.infer._windows`); the parameters take a Newton step or two on the marginal likelihood of
   all data. The mode is that of one piece: seams cannot show.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from maloc._jax import jax
from maloc.data._stages import Stages
from maloc.errors import FitError
from maloc.infer._model import ChainModel, chain_model
from maloc.infer._slant import put_depth
from maloc.infer._stretches import straighten
from maloc.infer._windows import SIZE, Windows, cut, padded, settled
from maloc.infer.initial import _column, _middle, _nearest, put_positions, repair
from maloc.infer.marginal import MarginalFit, _Marginal, whole
from maloc.infer.mode import anneal
from maloc.infer.result import LaplaceFit
from maloc.model_data.toa import ToaData

__all__ = ["LONG", "LongFit", "fit_long", "long_arguments", "long_effects"]

LONG = 4  # windows; tracks with more heard pings are fitted by them
_BLOCKS = 8  # windows that the parameters start from
_MARGIN = 16  # part of a window, at either end, that is the neighbours'
_CLOSER = 3.0  # from one error scale of the annealing to the next
_DRAWN = 20_000_000  # numbers in all draws of the path, 160 MB
_SURE = 2.0  # log units; a step of the parameters that promises less is the last


class LongFit(LaplaceFit):
    """A Laplace fit of a long track; fewer draws than asked where they would take memory."""

    def __init__(
        self, cm, args, options, seconds, warnings, marginal: MarginalFit, n: int, seed: int
    ) -> None:
        most = max(_DRAWN // marginal.x.size, 20)
        super().__init__(cm, args, options, seconds, warnings, marginal, min(n, most), seed)
        fewer = f", {self.n} draws in place of {n}" if self.n < n else ""
        self.notices = (f"{self.n_states} pings: a long track, fitted by windows{fewer}",)


class _Start(NamedTuple):
    """Parameters (k,) and their precision (k, k) from n of the states."""

    u: np.ndarray
    precision: np.ndarray
    states: int


def long_arguments(args: tuple, cm: ChainModel, size: int = SIZE) -> tuple | None:
    """Arguments padded to whole windows, where they are a long track's; else None."""
    data = args[0] if args else None
    if cm.has_local or not isinstance(data, ToaData):
        return None
    n = int(np.asarray(data.valid).sum())
    if n <= LONG * size:
        return None
    length = 1 + -(-(n - 1) // (size - 1)) * (size - 1)
    return (jax.device_put(padded(data, length)), *args[1:])


def fit_long(
    cm: ChainModel, args: tuple, positions, fit_one, path, stages: Stages, size: int = SIZE
) -> MarginalFit:
    """Fit a long track.

    Parameters
    ----------
    cm : ChainModel
    args : tuple
        From `long_arguments`.
    positions : (n, 2) array or None
        Positions (m) of the pings to start from.
    fit_one : callable
        Fits a block: (cm, args, path, positions) -> MarginalFit.
    path : tuple of str or None
        Names of the path sites.
    stages : Stages
        Takes seconds.
    size : int
        States a window.

    Raises
    ------
    FitError
        If no block can be fitted.
    """
    args = (jax.tree.map(np.asarray, args[0]), *args[1:])
    with stages.time("parameters"):
        start = _from_blocks(cm, args, positions, fit_one, path, size)
    with stages.time("initial"):
        x = _stitched(cm, args, start.u, positions, path, size)
    with stages.time("whole"):
        return _newton(cm, args, x, start, size)


def _from_blocks(cm: ChainModel, args: tuple, positions, fit_one, path, size: int) -> _Start:
    n = int(args[0].valid.sum())
    precision, weighted, used, problems = np.zeros((cm.k, cm.k)), np.zeros(cm.k), 0, []
    for first in np.linspace(0, n - size, _BLOCKS).astype(int):
        own = _piece(args, first, first + size)
        try:
            fit = fit_one(cm, own, path, _some(positions, first, first + size))
        except FitError as problem:
            problems.append(str(problem))
            continue
        root = np.linalg.inv(fit.covariance)
        precision, weighted, used = precision + root, weighted + root @ fit.u, used + size
    if not used:
        raise FitError(f"no block of the track can be fitted: {problems[0]}")
    return _Start(np.linalg.solve(precision, weighted), precision, used)


def _stitched(cm: ChainModel, args: tuple, u, positions, path, size: int) -> np.ndarray:
    """Path (T, d) from the middles of overlapping windows, at given parameters."""
    data = args[0]
    length, n = len(data.valid), int(data.valid.sum())
    x = np.zeros((length, cm.d))
    first, margin = 0, size // _MARGIN
    while True:
        start = min(max(first - margin, 0), length - size)
        own = _piece(args, start, start + size)
        found = _window(cm, own, u, _some(positions, start, start + size), path)
        x[first : start + size] = found[first - start :]
        x[start + size :] = found[-1]
        if start + size >= n:
            return x
        first = start + size - margin


def _window(cm: ChainModel, args: tuple, u: np.ndarray, positions, path) -> np.ndarray:
    """Path of one window at given parameters; a stable beat is added when a path is in place."""
    data = args[0]
    if data.schedule == "stable":
        loose = (dataclasses.replace(data, schedule="unknown"), *args[1:])
        without = chain_model(cm.model, cm.options, loose, path)
        values = cm.values(np.zeros((len(data.valid), cm.d)), u)
        own = without.flat_globals({s.name: values[s.name] for s in without.globals})
        x = _window(without, loose, own, positions, path)
    else:
        x = np.zeros((len(data.valid), cm.d))
        xy = np.broadcast_to(_middle(data), (len(x), 2)) if positions is None else positions
        xy = np.concatenate([xy, np.repeat(xy[-1:], len(x) - len(xy), axis=0)])
        put_positions(cm, x, xy)
        put_depth(cm, x, data)
        emission = _column(cm, "emission")
        assert emission is not None
        x[:, emission] = -_nearest(data, xy)
        reach = 0.5 * float(np.linalg.norm(np.ptp(data.receiver_xy[data.present], axis=0)))
        widest = reach if positions is None else 35.0
        scales = widest / _CLOSER ** np.arange(12)
        x = anneal(cm, args, x, u, tuple(scales[scales > 3.0]), steps=2)
    return straighten(cm, args, repair(cm, args, x, u), u)


def _newton(cm: ChainModel, args: tuple, x, start: _Start, size: int) -> MarginalFit:
    """Mode of the whole path, and parameters by Newton steps on the marginal of all data.

    The shape of the parameters' precision is the blocks'; its size is that of all data, from
    second differences.
    """
    windows: Any = Windows(cm, args, size)
    outer, n = cm.outer, int(args[0].valid.sum())
    alone = start.precision[np.ix_(outer, outer)]
    if len(cm.inner):  # what the outer parameters' precision is with the inner ones left free
        alone = np.linalg.inv(np.linalg.inv(start.precision)[np.ix_(outer, outer)])
    spread = np.sqrt(np.diag(alone))
    shape = alone / np.outer(spread, spread)
    x = settled(cm, args, x, start.u, size)
    marginal = _Marginal(windows, (), x, start.u, np.sqrt(start.states / n) / spread)
    own, gain, evaluations = start.u[outer], np.inf, 0
    while gain > _SURE and evaluations < 4:
        point = marginal(own)
        evaluations += 1
        root = np.sqrt(np.maximum(point.curvature, (0.1 * spread) ** 2))
        covariance = np.linalg.inv(shape * np.outer(root, root))
        step = -covariance @ point.gradient
        gain = -0.5 * float(step @ point.gradient)
        own, u = own + step, point.u + step @ point.moved
        ahead = point.mode.x + np.einsum("k,ktd->td", step, point.slope)
        ahead = settled(cm, args, ahead, u, size)
        marginal.best = point._replace(mode=point.mode._replace(x=ahead), u=u)
    mode, u = marginal.settle(ahead, u)
    arrow = marginal.arrow(mode.x, u)
    value = mode.value + 0.5 * arrow.log_det
    last = point._replace(mode=mode, u=u, value=value, arrow=arrow)
    return whole(marginal, last, covariance, bool(gain < _SURE and mode.converged))


def long_effects(
    plain: ChainModel, fit: MarginalFit, cm: ChainModel, args: tuple, u: np.ndarray
) -> MarginalFit:
    """Fit of a long track with receivers' errors, from the fit without them."""
    args = (jax.tree.map(np.asarray, args[0]), *args[1:])
    known = {s.name: s.place for s in plain.globals}
    precision, own = np.eye(cm.k), np.linalg.inv(fit.covariance)
    ours = np.concatenate([np.r_[s.place] for s in cm.globals if s.name in known])
    theirs = np.concatenate([np.r_[known[s.name]] for s in cm.globals if s.name in known])
    precision[np.ix_(ours, ours)] = own[np.ix_(theirs, theirs)]
    states = int(args[0].valid.sum())
    return _newton(cm, args, fit.x, _Start(u, precision, states), SIZE)


def _piece(args: tuple, start: int, stop: int) -> tuple:
    data, *others = cut(args, start, stop)
    return (jax.device_put(data), *others)


def _some(positions, start: int, stop: int):
    return None if positions is None else positions[start:stop]
