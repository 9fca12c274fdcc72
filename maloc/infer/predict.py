"""The posterior of a fitted track at any times, and whole tracks drawn from it.

Between the states of a fit, and beyond its ends, nothing but the movement model says where the
animal was; given the states that is a normal law, the bridge (`maloc.infer._bridge`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.errors import InputError
from maloc.infer._bridge import PathDraws, between, draw, parts
from maloc.infer._depths import draw_depths, expected_depths
from maloc.infer._paths import (
    path_draws,
    path_of,
    path_site,
    read_law,
    states_of,
)

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["Prediction", "TrackDraws", "predict", "sample_tracks"]

_DRAWS = 400  # of a sampled posterior, that a prediction is averaged over


class Prediction(NamedTuple):
    """Posterior at n times.

    Attributes
    ----------
    times : (n,) array
        s.
    mean : (n, d) array
        Positions (m), x and y first, and where the movement has them velocities (m/s), in the
        same order.
    covariance : (n, d, d) array
    within : (n,) array of bool
        Between the first and the last state; elsewhere the movement model alone says.
    depth, depth_sd : (n,) arrays, optional
        Of a track with depth, m.
    """

    times: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    within: np.ndarray
    depth: np.ndarray | None = None
    depth_sd: np.ndarray | None = None

    @property
    def position(self) -> np.ndarray:
        """Mean positions (n, 2), m."""
        return self.mean[:, :2]

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the positions (n, 2), m."""
        return np.sqrt(np.einsum("tii->ti", self.covariance[:, :2, :2]))


@dataclass(frozen=True, eq=False, repr=False)
class TrackDraws:
    """Whole tracks of one tag at n times, drawn jointly: each row is one the animal may have taken.

    Attributes
    ----------
    times : (n,) array
        s, ascending.
    position : (D, n, 2) array
        m.
    velocity : (D, n, 2) array, optional
        m/s; None for movement without one.
    depth : (D, n) array, optional
        m, positive down; None for flat tracks.
    tag : str
    origin : int, optional
        Time 0 as ns since 1970 UTC.
    crs : str, optional
        Frame of the positions.
    """

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray | None = None
    depth: np.ndarray | None = None
    tag: str = ""
    origin: int | None = None
    crs: str | None = None

    def __post_init__(self) -> None:
        times, position = np.asarray(self.times, float), np.asarray(self.position, float)
        if times.ndim != 1 or position.ndim != 3 or position.shape[1:] != (len(times), 2):
            raise InputError(f"positions {position.shape} do not go with {len(times)} times")
        if (np.diff(times) <= 0).any():
            raise InputError("times of a track must ascend")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "position", position)

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        span = self.times[-1] - self.times[0] if len(self.times) else 0.0
        return f"TrackDraws: {len(self)} tracks of {len(self.times)} times over {span:.0f} s"


def predict(fit: Fitted, times, tag: int = 0) -> Prediction:
    """Posterior of a tag's state at any times, in any order, also before and after the data.

    Parameters
    ----------
    fit : Fit
        Of a model with one path of `maloc.movement`.
    times : (n,) array
        s, on the fit's clock: from the origin of its data, as the site ``emission_time``.
    tag : int
        Which tag, where the fit has several.

    Returns
    -------
    Prediction
        Of a Laplace fit: the states' normal law carried through the bridge, the parameters'
        uncertainty to first order; at a state it is what ``fit.moments()`` says. Of any other fit:
        the mixture of the bridges of 400 draws or fewer; so with water, too.

    Raises
    ------
    FitError
        If the fit has no path that moves in continuous time.
    InputError
        If a time is not a number, or there is no such tag.

    Notes
    -----
    Emission times stand where they are most probable (Laplace), or differ from draw to draw. Before
    the first state the path runs backward as it runs forward after the last.
    """
    times = _checked(times)
    flat = getattr(fit.args[0], "depth", None) is None if fit.args else True
    if fit.method == "laplace" and fit.water is None:
        found = _laplace(fit, times, tag)  # pyright: ignore[reportArgumentType]
        if flat:
            return found
        path = path_draws(fit, tag, _DRAWS, seed=0)
        return with_depth(found, path)
    path = path_draws(fit, tag)
    keep = np.linspace(0, len(path.clock) - 1, min(len(path.clock), _DRAWS)).astype(int)
    return mixture(path.take(np.unique(keep)), times)


def sample_tracks(
    fit: Fitted, times, tag: int = 0, *, n: int = 200, seed: int = 0, name: str = "", origin=None,
    crs: str | None = None,
) -> TrackDraws:  # fmt: skip
    """Draw whole tracks of a tag at any ascending times (multiple imputation).

    Parameters
    ----------
    fit, times, tag
        As for `predict`.
    n, seed : int
        How many tracks, and the seed; of a sampled fit, evenly spaced draws and not more than
        there are.
    name, origin, crs
        The tag's name, time 0 (ns since 1970 UTC) and frame, where the draws are to know them.

    Returns
    -------
    TrackDraws

    Raises
    ------
    FitError, InputError
        As `predict`; also if times do not ascend.
    """
    times = _checked(times)
    if (np.diff(times) <= 0).any():
        raise InputError("times of a track must ascend")
    path = path_draws(fit, tag, n, seed)
    return drawn(path, times, n, seed, tag=name, origin=origin, crs=crs)


def drawn(path: PathDraws, times: np.ndarray, n: int, seed: int, **known: Any) -> TrackDraws:
    """Draw tracks at ascending times (n,) through evenly spaced draws of a path."""
    keep = np.linspace(0, len(path.clock) - 1, min(len(path.clock), n)).astype(int)
    path = path.take(np.unique(keep))
    rng = np.random.default_rng([seed, 1])
    at = np.broadcast_to(times, (len(path.clock), len(times)))
    state = draw(rng, path, at)
    velocity = state[:, :, 1] if state.shape[2] == 2 else None
    depth = None
    if path.depth is not None:
        depth = draw_depths(rng, path.depth, at, state[:, :, 0])
    return TrackDraws(times, state[:, :, 0], velocity, depth, **known)


def with_depth(found: Prediction, path: PathDraws, seed: int = 0) -> Prediction:
    """A prediction with its depths, by draws of a path that has them."""
    if path.depth is None:
        return found
    mean, sd = expected_depths(path.depth, found.times, found.position, seed)
    return found._replace(depth=mean, depth_sd=sd)


def mixture(path: PathDraws, times: np.ndarray, seed: int = 0) -> Prediction:
    """Mean and covariance at times (n,) of the mixture of the draws' bridges.

    With water, which bends them, of a draw from each.
    """
    if path.water is not None:
        return _by_draws(path, times, seed)
    order, axes = path.state.shape[2:]
    total = np.zeros((len(times), order * axes))
    square = np.zeros((len(times), order * axes, order * axes))
    noise = np.zeros((len(times), order, order))
    about = path.state[:, :, 0].mean(axis=(0, 1))  # digits: northings have seven of them
    about = np.concatenate([about, np.zeros((order - 1) * axes)])
    for part in parts(len(path.clock), len(times)):
        some = path.take(part)
        found, mean = between(some, np.broadcast_to(times, (len(some.clock), len(times))))
        flat = mean.reshape(*mean.shape[:2], -1) - about
        total += flat.sum(axis=0)
        square += np.einsum("dti,dtj->tij", flat, flat)
        noise += found.variance.sum(axis=0)
    n = len(path.clock)
    mean = total / n
    covariance = square / n - mean[:, :, None] * mean[:, None] + _on_axes(noise / n, axes)
    first, last = np.median(path.clock[:, 0]), np.median(path.clock[:, -1])
    inside = (times >= first) & (times <= last)
    return with_depth(Prediction(times, mean + about, covariance, inside), path, seed)


def _by_draws(path: PathDraws, times: np.ndarray, seed: int) -> Prediction:
    order = np.argsort(times, kind="stable")
    ascending = np.broadcast_to(times[order], (len(path.clock), len(times)))
    found = draw(np.random.default_rng([seed, 2]), path, ascending)
    flat = np.empty((*found.shape[:2], found.shape[2] * found.shape[3]))
    flat[:, order] = found.reshape(flat.shape)
    mean = flat.mean(axis=0)
    off = flat - mean
    covariance = np.einsum("dti,dtj->tij", off, off) / (len(flat) - 1)
    first, last = np.median(path.clock[:, 0]), np.median(path.clock[:, -1])
    inside = (times >= first) & (times <= last)
    return with_depth(Prediction(times, mean, covariance, inside), path, seed)


def _on_axes(block: np.ndarray, axes: int) -> np.ndarray:
    """Matrices (..., order, order) on each of the axes: (..., order axes, order axes)."""
    out = np.einsum("...ij,ab->...iajb", block, np.eye(axes))
    return out.reshape(*block.shape[:-2], block.shape[-2] * axes, block.shape[-1] * axes)


def _checked(times) -> np.ndarray:
    times = np.atleast_1d(np.asarray(times, float))
    if times.ndim != 1 or not np.isfinite(times).all():
        raise InputError("times must be finite seconds, one after another")
    return times


# -- Laplace --------------------------------------------------------------------------------------


def _laplace(fit: Fitted, times: np.ndarray, tag: int) -> Prediction:
    m, cm = fit.marginal, fit.cm
    site = path_site(cm)
    path = path_of(fit, m.x[None], m.u[None], tag)
    found, mean = between(path, times[None])
    mine = states_of(fit, read_law(fit, m.x[None], m.u[None]).get("tag"), tag)
    column = site.columns
    own = m.factor.covariances()
    beside = m.factor.neighbours(own)[mine[:-1], column, column]
    own = own[mine, column, column]
    axes = site.tail[-1]
    before, after = (_on_axes(w[0], axes) for w in (found.from_before, found.from_after))
    k, n = found.after[0], len(mine)
    at = np.maximum(k - 1, 0), np.minimum(k, n - 1)
    covariance = before @ own[at[0]] @ _t(before) + after @ own[at[1]] @ _t(after)
    inside = (k > 0) & (k < n)
    cross = after[inside] @ beside[at[0][inside]] @ _t(before[inside])
    covariance[inside] += cross + _t(cross)
    covariance += _on_axes(found.variance[0], axes)
    moved = _moved(fit, times, tag)
    covariance += np.einsum("kti,kl,ltj->tij", moved, m.covariance, moved)
    clock = path.clock[0]
    within = (times >= clock[0]) & (times <= clock[-1])
    return Prediction(times, mean[0].reshape(len(times), -1), covariance, within)


def _t(a: np.ndarray) -> np.ndarray:
    return np.swapaxes(a, -1, -2)


def _moved(fit: Fitted, times: np.ndarray, tag: int) -> np.ndarray:
    """How the mean (n, d) moves with the parameters, the states with it: (k, n, d)."""
    m, k = fit.marginal, fit.cm.k
    if not k:
        site = path_site(fit.cm)
        return np.zeros((0, len(times), site.columns.stop - site.columns.start))
    step = 1e-2 * np.sqrt(np.diag(m.covariance))
    offsets = np.concatenate([np.diag(step), -np.diag(step)])
    x = m.x + np.einsum("ok,ktd->otd", offsets, m.slope)
    path = path_of(fit, x, m.u + offsets, tag)
    means = [
        between(path.take(p), np.broadcast_to(times, (len(path.clock[p]), len(times))))[1]
        for p in parts(2 * k, len(times))
    ]
    means = np.concatenate(means).reshape(2 * k, len(times), -1)
    return (means[:k] - means[k:]) / (2 * step[:, None, None])
