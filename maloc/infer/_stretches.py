"""Stretches of a track that only a leap could explain, laid straight where that is likelier.

Several pings in a row whose late arrivals agree by chance can hold one another at a wrong place:
asked one by one none would leave. The leaps there and back give them away.
"""

from __future__ import annotations

import numpy as np

from maloc.infer._model import ChainModel
from maloc.infer.initial import _column, _position_columns
from maloc.infer.mode import find_mode
from maloc.infer.starts import _put_emission
from maloc.model_data.joint import JointData
from maloc.model_data.toa import ToaData

__all__ = ["leaps", "straighten"]

_LEAP = 4.0  # sds of a step: one in 3000 goes so far
_APART = 6  # states; leaps nearer to each other than this belong to one stretch
_WIDER = (1, 3, 6)  # states before and after a stretch's leaps that the line is tied to


def straighten(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Path (T, d) with every stretch between leaps tried as a straight line in time.

    What is kept has a higher joint density; `x` itself is returned where nothing has.
    """
    data = args[0] if args else None
    if not isinstance(data, ToaData | JointData) or _column(cm, "emission") is None:
        return x
    values = cm.values(x, u)
    stretches = leaps(data, x[:, _position_columns(cm)], values)
    if not stretches:
        return x
    best = find_mode(cm, args, x, u, max_steps=15, tol=1e-3)
    kept = x
    for stretch in stretches:
        for wider in _WIDER:
            trial = _straight(cm, data, best.x, stretch, wider, float(values["sigma"]))
            trial = find_mode(cm, args, trial, u, method="robust", max_steps=6, tol=1e-2).x
            found = find_mode(cm, args, trial, u, max_steps=15, tol=1e-3)
            if found.value < best.value - 0.1:
                best = found
                kept = found.x
                break
    return kept


def leaps(data: ToaData | JointData, xy: np.ndarray, values: dict) -> list[tuple[int, int]]:
    """First and last state (inclusive) of each stretch that begins and ends in a leap.

    Parameters
    ----------
    data : ToaData or JointData
    xy : array (T, 2)
        m.
    values : dict
        Parameters, of which those of the movement tell how far a step may go.
    """
    dt, tag = np.asarray(data.dt), _tags(data)
    if "sigma_vel" in values:
        usual = float(np.max(values["sigma_vel"])) * dt
    elif "sigma_step" in values:
        usual = float(np.max(values["sigma_step"])) * np.sqrt(dt)
    elif "home_sd" in values:
        share = -np.expm1(2 * np.log(0.05) * dt / float(np.max(values["home_t05"])))
        usual = float(np.max(values["home_sd"])) * np.sqrt(share)
    else:
        return []
    far = np.linalg.norm(np.diff(xy, axis=0), axis=1) > _LEAP * usual
    rows = np.flatnonzero(far & (tag[1:] == tag[:-1]) & (tag[1:] >= 0))
    if not len(rows):
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > _APART) + 1)
    return [(int(p[0]), int(p[-1]) + 1) for p in parts]


def _tags(data: ToaData | JointData) -> np.ndarray:
    """Whose each state is; padding is nobody's."""
    tag = np.asarray(data.tag) if isinstance(data, JointData) else 0
    return np.where(np.asarray(data.valid), tag, -1)


def _straight(
    cm: ChainModel, data, x: np.ndarray, stretch: tuple[int, int], wider: int, sigma: float
) -> np.ndarray:
    """Path with a stretch on the line between the states beside it, emission times to suit."""
    tag, (first, last) = _tags(data), stretch
    own = np.flatnonzero(tag == tag[first])
    a, b = first - wider, last + wider
    ends = [e for e in (a, b) if own[0] <= e <= own[-1]]
    if not ends:
        return x
    rows = np.arange(max(a + 1, own[0]), min(b, own[-1] + 1))
    time, columns = np.asarray(data.time), _position_columns(cm)
    out = x.copy()
    for column in columns:
        out[rows, column] = np.interp(time[rows], time[ends], x[ends, column])
    suited = out.copy()
    _put_emission(cm, data, suited, out[:, columns], 1.5 * sigma + 0.5)
    emission = _column(cm, "emission")
    out[rows, emission] = suited[rows, emission]
    return out
