"""Starts of the joint model: from arrival times alone, and from a grid; the likelihood decides.

Silence and a stiff schedule make hills of their own, so neither is switched on before there is a
track: the parts of the model that are left out at first are the arguments that switch them off.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from maloc.infer._beat import smooth_beat
from maloc.infer._grid import grid_paths
from maloc.infer._model import ChainModel, chain_model
from maloc.infer._slant import depth_at, slant_ranges
from maloc.infer.initial import initial_values, put_positions, repair
from maloc.infer.marginal import MarginalFit, maximise_marginal
from maloc.infer.mode import anneal, find_mode
from maloc.model_data.joint import JointData

__all__ = ["beat_start", "joint_starts"]

_STIFF = ("stable", "sequence")
_SURE = (1, 4, 5)  # receivers that a ping needs to tell of the beat: few err together
_TIGHTER = (300.0, 100.0, 30.0, 10.0)  # ms: a stiff schedule is tightened in these steps


def joint_starts(
    cm: ChainModel, args: tuple, path, positions=None, draws: int = 1
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Paths (S, d) and parameters (k,) to start a fit of the joint model from.

    Yields
    ------
    The fit of arrival times alone; then paths on a grid, by arrival times and silence.
    """
    data: JointData = args[0]
    tied = cm.options.get("schedule", True)
    stiff = tied and data.schedule in _STIFF
    bare = {"detection": None, "schedule": tied and not stiff}
    alone = chain_model(cm.model, cm.options | bare, args, path)
    fit = maximise_marginal(alone, args, *initial_values(alone, args, positions))
    fit = fit._replace(x=repair(alone, args, fit.x, fit.u))
    x, u = _carry(alone, fit, cm, args)
    u = _detection(cm, args, x, u)
    yield _tightened(cm, args, x, u)
    rng = np.random.default_rng(0)
    if not stiff:
        if _sparse(data):
            yield from _on_grid(cm, args, x, u, None, draws, rng)
        return
    for sure in _SURE:
        yield from _on_grid(cm, args, x, u, _beat(alone, fit, data, sure), 0, rng)
    if "p0" in cm.values(x, u):  # and from silence, as long as no beat is heard
        quiet = chain_model(cm.model, cm.options | {"schedule": False}, args, path)
        x, u = _carry(alone, fit, quiet, args)
        fit = maximise_marginal(quiet, args, x, _detection(quiet, args, x, u))
        x, u = _carry(quiet, fit, cm, args)
        yield _tightened(cm, args, x, u)
        for sure in _SURE:
            yield from _on_grid(cm, args, x, u, _beat(quiet, fit, data, sure), 0, rng)


def beat_start(alone: ChainModel, fit: MarginalFit, cm: ChainModel, args: tuple):
    """Path and parameters (x, u) from a fit without the beat, which then closes in on it."""
    return _tightened(cm, args, *_carry(alone, fit, cm, args))


def _on_grid(cm: ChainModel, args: tuple, x, u, beat, draws: int, rng):
    """Starts from paths on a grid, with parameters and all else as they are in (x, u)."""
    data: JointData = args[0]
    values = cm.values(x, u)
    how = _curves(values) if "p0" in values else (None, None)
    speed = float(values["sigma_vel"]) if "sigma_vel" in values else 0.3
    sigma = float(values["sigma"])
    for way in grid_paths(data, *how, sigma, speed, draws, rng, beat):
        start = x.copy()
        put_positions(cm, start, way)
        if beat is None:
            _put_emission(cm, data, start, way, sigma)
        else:
            start[:, _column(cm)] = beat[0]
        start = anneal(cm, args, start, _loose(cm, u, _TIGHTER[-1]), (12.0, 6.0, 3.0))
        yield _tightened(cm, args, start, u, _TIGHTER[-1:])


def _sparse(data: JointData) -> bool:
    """Whether many pings leave a choice of places: more than a tenth heard by fewer than three."""
    heard = np.asarray(data.heard).sum(axis=1)[np.asarray(data.ping)]
    return bool((heard < 3).mean() > 0.1)


def _column(cm: ChainModel) -> int:
    return next(s.columns.start for s in cm.chain if s.name == "emission")


def _beat(alone: ChainModel, fit: MarginalFit, data: JointData, sure: int):
    """Emission (S,) m, and its sd, as the beat foretells it from a fit that knows no beat.

    Only pings heard by at least `sure` receivers tell of it.
    """
    column, speed = _column(alone), np.asarray(data.speed)
    heard = np.asarray(data.heard).sum(axis=1) >= sure
    sd = np.sqrt(fit.factor.covariances()[:, column, column]) / speed
    time = np.asarray(data.time) + fit.x[:, column] / speed
    smooth, spread = smooth_beat(
        np.where(heard, time, np.nan), sd, np.asarray(data.nominal), np.asarray(data.n_intervals)
    )
    known = np.isfinite(smooth)
    emission = np.where(known, (smooth - np.asarray(data.time)) * speed, fit.x[:, column])
    return emission, np.where(known, spread, 1.0) * speed


def _carry(
    source: ChainModel, fit: MarginalFit, cm: ChainModel, args: tuple
) -> tuple[np.ndarray, np.ndarray]:
    """The fit of a smaller model as values of a larger one; what it lacks: 0, and medians."""
    values = {k: np.asarray(v) for k, v in source.values(fit.x, fit.u).items()}
    u = cm.flat_globals({k: np.asarray(v) for k, v in cm.prior_medians(args).items()} | values)
    x = np.zeros((len(fit.x), cm.d))
    for site in cm.chain:
        if site.name in values:
            x[:, site.columns] = values[site.name].reshape(len(x), -1)
    return x, u


def _detection(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Height and scale of the detection function by the joint density on a path."""
    values = {k: np.asarray(v) for k, v in cm.values(x, u).items()}
    if "p0" not in values:
        return u
    best, found = np.inf, u
    for scale in float(values["scale"]) * 1.4 ** np.arange(-6, 8):
        for p0 in (0.3, 0.6, 0.85, 0.97):
            trial = cm.flat_globals(values | {"p0": p0, "scale": scale})
            value = float(cm.exact(x, trial, args, 0.0)[0])
            if value < best:
                best, found = value, trial
    return found


def _curves(values: dict):
    """Rough log probabilities of missing and of hearing at distances, by a half-normal."""
    p0, scale = float(values["p0"]), float(values["scale"])

    def hit(away):
        return np.log(p0) - 0.5 * (away / scale) ** 2

    def miss(away):
        return np.log1p(-np.minimum(np.exp(hit(away)), 1 - 1e-6))

    return miss, hit


def _put_emission(cm: ChainModel, data: JointData, x, xy, sigma: float) -> None:
    """Emission times that suit the positions best: on the side where no arrival is early."""
    column, heard = _column(cm), np.asarray(data.heard)
    values = {s.name: x[:, s.columns] for s in cm.chain}
    away = slant_ranges(data, xy, depth_at(data, xy, values))
    reach = np.where(heard, np.asarray(data.range) - away, np.nan)
    for t in np.flatnonzero(heard.any(axis=1)):
        tried = reach[t, heard[t]]
        off = tried - tried[:, None]
        score = np.where(off > -3 * sigma, np.maximum(-0.5 * (off / sigma) ** 2, -4.0), -12.0)
        x[t, column] = tried[score.sum(axis=1).argmax()]


def _loose(cm: ChainModel, u: np.ndarray, sd: float = 1e3) -> np.ndarray:
    """The parameters, a stiff schedule's drift given as `sd` ms."""
    values = {s.name: np.asarray(s.transform(u[s.place].reshape(s.shape))) for s in cm.globals}
    if "interval_drift" not in values:
        return u
    return cm.flat_globals(values | {"interval_drift": sd})


def _tightened(cm: ChainModel, args: tuple, x, u, widths: tuple[float, ...] = _TIGHTER):
    """Mode of the path, a stiff schedule closing in on it by and by."""
    loose = _loose(cm, u)
    if loose is u:
        return find_mode(cm, args, x, u, method="robust", max_steps=6, tol=1e-2).x, u
    for sd in widths:
        x = find_mode(cm, args, x, _loose(cm, u, sd), method="robust", max_steps=6, tol=1e-2).x
    values = {k: np.asarray(v) for k, v in cm.values(x, u).items()}
    known = np.asarray(args[0].interval_known)
    spread = np.diff(values["interval"])[known]
    values["interval_drift"] = np.clip(1.5 * np.median(np.abs(spread)), 0.3, 300.0)
    return x, cm.flat_globals(values)
