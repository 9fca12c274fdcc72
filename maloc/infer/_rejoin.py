"""Stretches of a track laid where single pings say, where that is likelier.

Several pings in a row can hold one another on the wrong side of a line of receivers, or among late
arrivals: no ping leaves alone. The places that each ping's arrivals fit are scored by the fitted
law, a path is laid through them, and where it leaves the track both are asked.
"""

from __future__ import annotations

import numpy as np

from maloc.infer._model import ChainModel
from maloc.infer._ping_path import joined, places
from maloc.infer._stretches import _straight
from maloc.infer.initial import _column, _position_columns, put_positions
from maloc.infer.mode import Mode, find_mode
from maloc.model_data.toa import ToaData

__all__ = ["rejoined"]

_AWAY = 4.0  # sigma
_APART = 3  # states; stretches nearer than this are one
_MOST = 12
_BETTER = 3.0  # log units that a ping alone would gain elsewhere
_WIDER = (1, 3)
_STEPS = (2.0, 50.0)  # degrees of freedom: steps that may leap, and such as may hardly


def rejoined(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Path (T, d) with stretches moved to where single pings place them.

    What is kept has a higher joint density; `x` itself is returned where nothing has.
    """
    data, emission = args[0] if args else None, _column(cm, "emission")
    values = {k: np.asarray(v) for k, v in cm.values(x, u).items()}
    if not isinstance(data, ToaData) or emission is None or "sigma" not in values:
        return x
    found = places(data)
    if found is None:
        return x
    sigma, columns = float(values["sigma"]), _position_columns(cm)
    state, _ = found.best(sigma, float(data.phi))
    here = x[found.rows][:, None, [*columns, emission]]
    state = np.concatenate([here, state], axis=1)
    score = [_likelihood(cm, args, x, u, found.rows, one) for one in np.moveaxis(state, 1, 0)]
    score, speed = np.stack(score, axis=1), _usual_speed(data, x[:, columns])
    track = _Track(cm, args, x, u)
    for df in _STEPS:
        way, when = joined(data, found.rows, state, score, sigma, speed, df)
        other = x.copy()
        put_positions(cm, other, way)
        other[:, emission] = np.where(np.isfinite(when), when, x[:, emission])
        away = np.linalg.norm(other[:, columns] - track.kept[:, columns], axis=1)
        moved = np.flatnonzero((away > _AWAY * sigma) & np.asarray(data.valid))
        parts = _parts(moved)
        for part in ([moved] if len(parts) > 1 else []) + parts:
            trial = track.path.copy()
            trial[part] = other[part]
            track.ask(trial)
    better = found.rows[score[:, 1:].max(axis=1) - score[:, 0] > _BETTER]
    for part in _parts(better):
        for wider in _WIDER:
            stretch = int(part[0]), int(part[-1])
            track.ask(_straight(cm, data, track.path, stretch, wider, sigma))
    return track.kept


class _Track:
    """The best path so far, and the one to keep: the given one until a better is found."""

    def __init__(self, cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> None:
        self.cm, self.args, self.u, self.kept = cm, args, u, x
        self.mode: Mode | None = None

    @property
    def path(self) -> np.ndarray:
        """Mode that trials start from."""
        if self.mode is None:
            self.mode = find_mode(self.cm, self.args, self.kept, self.u, max_steps=15, tol=1e-3)
        return self.mode.x

    def ask(self, trial: np.ndarray) -> None:
        """Keep the mode reached from a trial path (T, d) where it is likelier."""
        value = (self.path, self.mode.value)[1]  # pyright: ignore[reportOptionalMemberAccess]
        how = {"method": "robust", "max_steps": 6, "tol": 1e-2}
        trial = find_mode(self.cm, self.args, trial, self.u, **how).x
        new = find_mode(self.cm, self.args, trial, self.u, max_steps=15, tol=1e-3)
        if new.value < value - 0.1:
            self.mode, self.kept = new, new.x


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    """Runs of states, small holes filled, the longest first."""
    if not len(rows):
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > _APART) + 1)
    parts = [np.arange(p[0], p[-1] + 1) for p in parts]
    return sorted(parts, key=len, reverse=True)[:_MOST]


def _likelihood(cm: ChainModel, args: tuple, x, u, rows, state) -> np.ndarray:
    """Log likelihoods (n,) of the arrivals of the states `rows` at places and emissions (n, 3)."""
    trial, emission = x.copy(), _column(cm, "emission")
    assert emission is not None
    trial[np.ix_(rows, [*_position_columns(cm), emission])] = state
    part = next(p for p in cm.pointwise(trial, u, args).values() if "p_direct" in p)
    heard = np.asarray(part.get("mask", args[0].heard))
    return np.where(heard, np.asarray(part["log_likelihood"]), 0.0).sum(axis=1)[rows]


def _usual_speed(data: ToaData, xy: np.ndarray) -> float:
    """Speed by axis (m/s) of the median step between states."""
    n = int(np.asarray(data.valid).sum())
    steps = np.linalg.norm(np.diff(xy[:n], axis=0), axis=1) / np.asarray(data.dt)[: n - 1]
    return float(np.median(steps) / 1.18) if n > 1 else 0.5
