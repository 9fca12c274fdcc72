"""The chain of today as methods of the canal study: positions, outliers out, Kalman, smoother.

A method's name is where its positions come from ("ls": least squares of all arrivals; "de":
LS-TDOA by differential evolution, the thesis's) and the last step taken; "ek-toa" has no positions.
Only pings that the filter kept are scored, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from maloc.classical.kalman import KalmanTrack, kalman
from maloc.classical.outliers import speed_filter, three_stage_filter, two_stage_filter
from maloc.data._limits import Z95
from maloc.errors import FitError, InputError
from maloc.studies.canal.located import Located, of_points

if TYPE_CHECKING:
    from maloc.data.arrivals import ArrivalTimes
    from maloc.points.result import Points
    from maloc.studies.canal.cases import Case
    from maloc.studies.canal.settings import Settings

__all__ = ["CHAIN", "FILTERS", "SPEED", "STEPS", "WIDE"]

SPEED = 2.0  # m/s: the thesis's eight body lengths a second, of a fish of 25 cm
WIDE = 10.0  # m: a position's error, guessed as by who has a measure of it in no unit

# the thesis's two-point variants, and McConnell et al.'s four points
FILTERS: dict[str, Callable] = {
    "speed": partial(speed_filter, neighbours=1),
    "speed4": partial(speed_filter, neighbours=2),
    "two": partial(two_stage_filter, neighbours=1),
    "three": partial(three_stage_filter, neighbours=1),
}
# after the three-stage filter: movement, kind of state, a position's error where it is guessed
KALMAN: dict[str, tuple[str, str, float | None]] = {
    "kf": ("ctcrw", "filtered", None),
    "rts": ("ctcrw", "smoothed", None),
    "kf-wide": ("ctcrw", "filtered", WIDE),
    "rts-wide": ("ctcrw", "smoothed", WIDE),
    "kf-rw": ("rw", "filtered", None),
    "rts-rw": ("rw", "smoothed", None),
    "kf-crw": ("crw", "filtered", None),
    "rts-crw": ("crw", "smoothed", None),
}
STEPS = (*FILTERS, *KALMAN)
_BASES = {"ls": "least-squares", "de": "differential-evolution"}


@lru_cache(maxsize=2)
def _points(toa: ArrivalTimes, base: str, seed: int) -> Points:
    from maloc.points import locate

    options = {"seed": seed} if base == "de" else {}
    return locate(toa, _BASES[base], **options)  # pyright: ignore[reportArgumentType]


def _alone(base: str, case: Case, settings: Settings) -> Located:
    return of_points(_points(case.toa, base, settings.seed))


def _filtered(base: str, step: str, case: Case, settings: Settings) -> Located:
    points = _points(case.toa, base, settings.seed)
    keep = FILTERS[step](points.emission, points.position, SPEED).keep
    whole = of_points(points)
    names = ("position", "sd", "low", "high")
    kept = {name: np.where(keep[:, None], getattr(whole, name), np.nan) for name in names}
    return whole._replace(**kept)


@lru_cache(maxsize=2)
def _track(
    toa: ArrivalTimes, base: str, seed: int, movement: str, wide: float | None
) -> tuple[KalmanTrack, np.ndarray]:
    """Kalman track of what the three-stage filter keeps, and the pings of its used states."""
    points = _points(toa, base, seed)
    keep = FILTERS["three"](points.emission, points.position, SPEED).keep
    if wide is not None:
        points = points.replace(covariance=np.tile(wide**2 * np.eye(2), (len(points), 1, 1)))
    try:
        track = kalman(points, movement, keep=keep)
    except InputError as error:  # too few positions are left
        raise FitError(str(error)) from None
    rows = np.flatnonzero(keep)
    return track, rows[np.searchsorted(points.emission[rows], track.time[track.used])]


def _smoothed(base: str, step: str, case: Case, settings: Settings) -> Located:
    movement, kind, wide = KALMAN[step]
    track, rows = _track(case.toa, base, settings.seed, movement, wide)
    states = getattr(track, kind)
    return _of_states(states.mean[track.used], states.covariance[track.used], rows, len(case.toa))


def _ek_toa(case: Case, settings: Settings) -> Located:
    """EK-TOA given its true parameters: to estimate them costs a hundred times as much."""
    from maloc.classical.ektoa import ek_toa
    from maloc.studies.canal.known import true_values

    known = {k: float(v) for k, v in true_values(case.toa, case.truth, case.emission).items()}
    movement = {name: known[name] for name in ("sigma_vel", "t05")}
    track = ek_toa(case.toa, parameters=movement, sigma=known["sigma"])
    rows = np.flatnonzero(case.toa.n_heard > 0)
    first = np.nanmin(case.toa.toa[rows], axis=1)
    order = np.argsort(first, kind="stable")
    rows = rows[order[np.searchsorted(first[order], track.time)]]
    return _of_states(*track.smoothed, rows, len(case.toa))


def _of_states(mean: np.ndarray, covariance: np.ndarray, rows: np.ndarray, n: int) -> Located:
    position, sd = np.full((2, n, 2), np.nan)
    position[rows] = mean[:, :2]
    sd[rows] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, :2])
    return Located(position, sd, position - Z95 * sd, position + Z95 * sd)


CHAIN: dict[str, Callable[[Case, Settings], Located]] = {
    **{base: partial(_alone, base) for base in _BASES},
    **{f"{base}-{step}": partial(_filtered, base, step) for base in _BASES for step in FILTERS},
    **{f"{base}-{step}": partial(_smoothed, base, step) for base in _BASES for step in KALMAN},
    "ek-toa": _ek_toa,
}
