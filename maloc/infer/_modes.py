"""The likeliest of several modes of a model of arrival times.

A joint density of path and parameters has hills: most arrivals fit narrowly and the rest are late,
or all fit widely. A climb ends on the hill it starts on, whatever the path it starts from, so the
starts differ in the scale of the error, and the marginal likelihood decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.infer._model import ChainModel
from maloc.infer._ping_path import ping_paths
from maloc.infer.initial import (
    _column,
    _moments,
    _nearest,
    _position_columns,
    initial_values,
    put_positions,
    repair,
)
from maloc.infer.marginal import MarginalFit, maximise_marginal
from maloc.infer.mode import _factor, find_mode

__all__ = ["likeliest", "toa_starts"]

SIGMAS = (0.3, 1.0, 3.0, 10.0)  # m
_MOST = 3
_ALIKE = 5.0  # log units
_FAR = 3.0  # log units a ping; a start that stands farther behind is not fitted
_OTHER = 0.4  # of log sigma; starts that differ by less, and stand together, are one hill
_PART = 0.9  # of the states; where they stand within a sigma, two starts are one


class _Start(NamedTuple):
    """Negative log marginal where a start stands, path (T, d), parameters (k,), sigma (m)."""

    value: float
    x: np.ndarray
    u: np.ndarray
    sigma: float


def toa_starts(cm: ChainModel, args: tuple, positions) -> list[tuple[np.ndarray, np.ndarray]]:
    """Starts of path (T, d) and parameters (k,): annealed, and from single pings at each scale."""
    starts = [initial_values(cm, args, positions)]
    if "sigma" not in {s.name for s in cm.globals}:
        return starts
    data, emission = args[0], _column(cm, "emission")
    x, u = starts[0]
    values = {k: np.asarray(v) for k, v in cm.values(x, u).items()}
    for sigma, (xy, sent) in zip(SIGMAS, ping_paths(data, SIGMAS), strict=False):
        x = x.copy()
        put_positions(cm, x, xy)
        known = np.isfinite(sent)
        x[:, emission] = np.where(known, sent, -_nearest(data, xy))
        u = cm.flat_globals(values | {"sigma": sigma, **({"w": 0.1} if "w" in values else {})})
        x = _settled(cm, args, x, u, temper=2 * sigma)
        for _ in range(3):
            u = _moments(cm, args, x, u)
            x = _settled(cm, args, x, u)
        starts.append((x, u))
    return starts


def _settled(cm: ChainModel, args: tuple, x, u, temper: float = 0.0) -> np.ndarray:
    how = {"temper": temper, "method": "robust", "max_steps": 6, "tol": 1e-2}
    return find_mode(cm, args, x, u, **how).x


def likeliest(cm: ChainModel, args: tuple, starts: list) -> list[MarginalFit]:
    """Fits from the starts that stand on hills of their own, the likeliest first."""
    if len(starts) == 1:
        return [maximise_marginal(cm, args, *starts[0])]
    stands = [_stand(cm, args, x, u) for x, u in starts]
    annealed, pings = stands[0], int(np.asarray(args[0].valid).sum())
    stands = sorted(stands, key=lambda s: s.value)
    xy, kept = _position_columns(cm), stands[:1]
    if annealed.value < kept[0].value + _ALIKE and not _differ(annealed, kept[0], xy):
        kept = [annealed]  # the widest climb: least held by single pings
    for one in stands[1:]:
        near = one.value < stands[0].value + _FAR * pings
        if near and len(kept) < _MOST and all(_differ(one, other, xy) for other in kept):
            kept.append(one)
    fits = [maximise_marginal(cm, args, repair(cm, args, s.x, s.u), s.u) for s in kept]
    return sorted(fits, key=lambda fit: fit.value)


def _stand(cm: ChainModel, args: tuple, x, u) -> _Start:
    mode = find_mode(cm, args, x, u, max_steps=25, tol=1e-3)
    band = cm.terms(mode.x, u, args, 0.0, False)[2]
    value = mode.value + 0.5 * _factor(band, cm.d).log_det
    return _Start(value, mode.x, u, float(cm.values(mode.x, u)["sigma"]))


def _differ(one: _Start, other: _Start, xy: list[int]) -> bool:
    sigma = max(one.sigma, other.sigma)
    away = np.linalg.norm(one.x[:, xy] - other.x[:, xy], axis=1)
    scale = abs(np.log(one.sigma / other.sigma))
    return scale > _OTHER or float(np.quantile(away, _PART)) > sigma
