"""Initial values: a path near the right mode from nothing but the data.

Arrival-time models start with every ping in the middle of the array and are annealed: errors are
widened to the size of the array and narrowed step by step, so that the track as a whole finds its
place before single arrivals are believed. Then each ping is asked whether another emission time
(or its neighbours' position) explains it better, which frees pings left behind with all arrivals
"late". Point positions (population Monte Carlo) can be given in place of the centre.

Detection models start at the middle of the receivers that heard each ping.
"""

from __future__ import annotations

import numpy as np

from maloc._jax import jax
from maloc.arrival import DDetect
from maloc.infer._model import ChainModel
from maloc.infer._slant import depth_at, put_depth, slant_ranges
from maloc.infer.mode import anneal, find_mode
from maloc.model_data.encounters import EncounterData
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData
from maloc.movement.path import MarkovPath
from maloc.world.statespace import SoftBox

__all__ = ["initial_values", "put_positions", "repair", "stable_interval"]

_FINE = (100.0, 60.0, 35.0, 20.0, 12.0, 8.0, 6.0, 5.0, 4.0, 3.0)
_NEAR = _FINE[2:]  # from point positions, which err by less
_T3_MIDDLE = 0.7649  # median size of Student's t with 3 df


def initial_values(
    cm: ChainModel, args: tuple, positions: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Path (T, d) and unconstrained parameters (k,) to start a fit from.

    Parameters
    ----------
    cm : ChainModel
    args : tuple
        The model's arguments; arrival times (`ToaData`) or encounter histories (`EncounterData`) as
        the first are used; other models start from zero, and from the prior medians but for what a
        dict `start` of the data gives.
    positions : (T, 2) array, optional
        Point positions (m) to start from in place of the array's centre.
    """
    length = cm.length(args)
    data = args[0] if args else None
    medians = cm.prior_medians(args) | getattr(data, "start", {})
    u = cm.flat_globals(medians)
    x = np.zeros((length, cm.d))
    put_depth(cm, x, data)
    emission = _column(cm, "emission")
    if isinstance(data, JointData) and emission is None:
        data = data.encounters
    if isinstance(data, EncounterData):
        put_positions(cm, x, np.asarray(data.initial) if positions is None else positions)
        return find_mode(cm, args, x, u, method="gauss-newton", max_steps=10, tol=1e-2).x, u
    if not isinstance(data, ToaData | JointData):
        return x, u
    xy = np.broadcast_to(_middle(data), (length, 2)) if positions is None else positions
    xy = np.concatenate([xy, np.repeat(xy[-1:], length - len(xy), axis=0)])
    put_positions(cm, x, xy)
    if emission is not None:
        x[:, emission] = -_nearest(data, xy)
    receivers = np.asarray(data.receiver_xy)[np.asarray(data.heard).any(axis=0)]
    reach = 0.5 * float(np.linalg.norm(np.ptp(receivers, axis=0)))
    coarse = tuple(reach / 2.0**i for i in range(10) if reach / 2.0**i > 150)
    scales = coarse + _FINE if positions is None else _NEAR
    x = anneal(cm, args, x, u, scales)
    for _ in range(3):
        u = _moments(cm, args, x, u)
        x = find_mode(cm, args, x, u, method="robust", max_steps=4, tol=1e-2).x
    return repair(cm, args, x, u), u


def _middle(data: ToaData | JointData) -> np.ndarray:
    """Centre of the array; beside it where the receivers stand on one line.

    The density is then symmetric about that line, and a path that starts on it would stay on it.
    """
    receivers = np.asarray(data.receiver_xy)[np.asarray(data.heard).any(axis=0)]
    centre = np.asarray(data.centre)
    if len(receivers) < 2:
        return centre
    _, size, axes = np.linalg.svd(receivers - receivers.mean(0), full_matrices=False)
    on_line = size[1] <= max(1.0, 0.01 * size[0])
    return centre + axes[1] * (size[0] / 4 if on_line else 0.0)


def repair(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray, rounds: int = 3):
    """Path in which no single ping can be explained better by another emission time.

    Returns the path `x` (T, d) itself where nothing is gained; else the mode reached from the
    better explanation, as long as its joint density is higher.
    """
    if not (args and isinstance(args[0], ToaData | JointData)) or _column(cm, "emission") is None:
        return x
    value = find_mode(cm, args, x, u, max_steps=15, tol=1e-3)
    for _ in range(rounds):
        trial, moved = _reassign(cm, args[0], value.x, cm.values(x, u))
        if not moved:
            break
        trial = find_mode(cm, args, trial, u, method="robust", max_steps=4, tol=1e-2).x
        better = find_mode(cm, args, trial, u, max_steps=15, tol=1e-3)
        if better.value > value.value - 1e-3:
            break
        value = better
    return value.x


def _column(cm: ChainModel, name: str) -> int | None:
    """Column of a scalar path site."""
    for site in cm.chain:
        if site.name == name and site.tail == ():
            return site.columns.start
    return None


def _position_columns(cm: ChainModel) -> list[int]:
    """Columns of the flat path that hold the positions' axes."""
    for site in cm.chain:
        if issubclass(site.law, MarkovPath | SoftBox):
            start = site.columns.start
            return [start + a for a in range(site.tail[-1])]
    return []


def put_positions(cm: ChainModel, x: np.ndarray, xy: np.ndarray) -> None:
    """Write positions (T, 2) into the flat path (T, d), in place."""
    for axis, column in enumerate(_position_columns(cm)):
        x[:, column] = xy[:, axis]


def _nearest(data: ToaData | JointData, xy: np.ndarray) -> np.ndarray:
    """Distance (m) from each position to the receiver that heard the ping first."""
    ranges = np.where(np.asarray(data.heard), np.asarray(data.range), np.inf)
    away = slant_ranges(data, np.asarray(xy, float))
    return np.take_along_axis(away, ranges.argmin(axis=1)[:, None], axis=1)[:, 0]


def _moments(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Parameters the models of this package share, from residuals and speeds of a path."""
    data: ToaData | JointData = args[0]
    values = dict(cm.values(x, u))
    valid = np.asarray(data.valid)
    parts = [p for p in cm.pointwise(x, u, args).values() if "p_direct" in p]
    if parts and "sigma" in values:
        heard = np.asarray(parts[0].get("mask", data.heard)) & valid[:, None]
        p = np.asarray(parts[0]["p_direct"])[heard]
        residual = np.asarray(parts[0]["residual"])[heard]
        pings = heard.any(axis=1).sum()
        freedom = max(heard.sum() - 3 * pings, 0.3 * heard.sum()) / heard.sum()
        spread = np.sqrt(np.sum(p * residual**2) / max(np.sum(p) * freedom, 1e-9))
        values["sigma"] = np.clip(spread, 0.02, 20.0)
        if "w" in values:
            values["w"] = np.clip(np.mean(1 - p), 0.003, 0.5)
        if "t_scale" in values and (1 - p).sum() > 3:
            values["t_scale"] = _middle_size(residual, 1 - p) / _T3_MIDDLE
    columns = _position_columns(cm)
    steps = np.diff(x[valid][:, columns], axis=0)
    if len(steps) > 2:
        dt = np.asarray(data.dt)[: len(steps)]
        speed2 = np.median(np.sum(steps**2, axis=1) / dt**2)
        if "sigma_vel" in values:
            values["sigma_vel"] = np.clip(np.sqrt(speed2 / 1.39), 0.005, 5.0)
        if "sigma_step" in values:
            step2 = np.median(np.sum(steps**2, axis=1) / dt)
            values["sigma_step"] = np.clip(np.sqrt(step2 / 1.39), 0.02, 50.0)
        if "home_sd" in values:
            values["home_sd"] = np.maximum(np.std(x[valid][:, columns]), 1.0)
    return cm.flat_globals(values)


def _middle_size(residual: np.ndarray, weight: np.ndarray) -> float:
    """Weighted median of the residuals' sizes."""
    order = np.argsort(np.abs(residual))
    part = np.cumsum(weight[order]) / weight.sum()
    return float(np.abs(residual)[order][np.searchsorted(part, 0.5)])


@jax.jit
def _score(residual, sigma, phi, w):
    return DDetect(0.0, sigma, phi, w, background=1e-4).log_prob(residual)


def _reassign(cm: ChainModel, data: ToaData | JointData, x: np.ndarray, values: dict):
    """Better emission time (and position) for pings that have one: path, any moved or not."""
    columns, emission = _position_columns(cm), _column(cm, "emission")
    assert emission is not None
    heard, ranges = np.asarray(data.heard), np.asarray(data.range)
    valid = np.asarray(data.valid)
    sigma = 1.5 * float(values.get("sigma", 2.0)) + 0.5
    w = float(np.clip(values.get("w", 0.1), 0.01, 0.5))
    xy = x[:, columns]
    between = xy.copy()
    between[1:-1] = 0.5 * (xy[:-2] + xy[2:])
    places = np.stack([xy, between], axis=1)  # (T, 2, 2)
    distance = slant_ranges(data, places, depth_at(data, xy, values))
    reach = np.where(heard[:, None], ranges[:, None] - distance, 0.0)  # (T, 2, R)
    current = np.broadcast_to(x[:, None, None, emission], (*reach.shape[:2], 1))
    tried = np.concatenate([current, reach], axis=2)  # (T, 2, R + 1)
    residual = (ranges[:, None] - distance)[:, :, None] - tried[..., None]
    score = np.where(
        heard[:, None, None], np.asarray(_score(residual, sigma, data.phi, w)), 0.0
    ).sum(axis=-1)
    score[:, :, 1:] = np.where(heard[:, None], score[:, :, 1:], -np.inf)
    flat = score.reshape(len(x), -1)
    best = flat.argmax(axis=1)
    gain = flat[np.arange(len(x)), best] - flat[:, 0]
    moved = valid & (gain > 2.0)
    out = x.copy()
    place, choice = np.unravel_index(best[moved], score.shape[1:])
    rows = np.nonzero(moved)[0]
    for axis, column in enumerate(columns):
        out[rows, column] = places[rows, place, axis]
    out[rows, emission] = tried[rows, place, choice]
    return out, bool(moved.any())


def stable_interval(data: ToaData, emission: np.ndarray, values: dict) -> dict:
    """Values with the stable interval's mean and jitter read off a track's emissions (T,) m."""
    known = np.asarray(data.interval_known)
    if known.sum() < 3 or "interval_offset" not in values:
        return values
    n = np.asarray(data.n_intervals)[known]
    time = np.asarray(data.time) + emission / np.asarray(data.speed)
    each = np.diff(time)[known] / n
    mean, sd = (float(v) for v in data.interval)
    middle = float(np.median(each))
    spread = 1.4826 * float(np.median(np.abs(each - middle) * np.sqrt(n)))
    offset = np.clip((middle / mean - 1) / 1e-3, -3.0, 3.0)
    if spread < 0.01 * mean:  # else there is no beat to be found: it is a random interval
        spread = np.clip(spread, sd / 5, 5 * sd)
    return values | {"interval_offset": offset, "interval_sd": spread}
