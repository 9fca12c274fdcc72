"""EK-TOA: an extended Kalman filter on the arrival times themselves, and its smoother.

Emission is a state of its own at every ping, with a prior twice as wide as the largest latency, so
that each arrival counts by itself. Arrivals are taken to be direct: late ones pull the track along,
which is what the mixture of `maloc.models.toa_track` is there for.

References
----------
Campbell et al.'s kaltoa, `KaltoaTrackPositioning`; Sarkka (2013) Bayesian Filtering and Smoothing,
chapters 5 and 9 (iterated extended filter, its smoother).
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.classical._steps import LAWS, Law, steps
from maloc.classical.kalman import KalmanTrack, States, smoothed_by
from maloc.errors import FitError, InputError, MalocWarning

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes

__all__ = ["ek_toa"]

_ROUNDS = 20  # of linearisation at one ping
_NEAR = 0.5  # m; distances have no corner at a receiver


def ek_toa(
    toa: ArrivalTimes,
    movement: str = "ctcrw",
    *,
    parameters: dict[str, float] | None = None,
    sigma: float | None = None,
) -> KalmanTrack:
    """Filter and smooth a track from arrival times.

    Parameters
    ----------
    toa : ArrivalTimes
        Of one tag.
    movement : {"rw", "crw", "ctcrw"}
        See `kalman`.
    parameters : dict, optional
        Of the movement, see `KalmanTrack.parameters`. Not given: of the least energy.
    sigma : float, optional
        Standard deviation of an arrival, m. Not given: of the least energy too.

    Returns
    -------
    KalmanTrack
        A state for every heard ping, at its first arrival; ``parameters`` has ``sigma`` (m) too.

    Raises
    ------
    InputError
        If `movement` or a parameter is unknown, or fewer than 3 pings were heard by 3 receivers.
    FitError
        If no parameters of finite energy are found.

    Warns
    -----
    MalocWarning
        If pings have one first arrival time: the first of them counts.
    """
    if movement not in LAWS:
        raise InputError(f"movement '{movement}' is none of {', '.join(LAWS)}")
    law = LAWS[movement]
    if parameters is not None and set(parameters) != set(law.names):
        raise InputError(f"the parameters of '{movement}' are {' and '.join(law.names)}")
    if (toa.n_heard >= 3).sum() < 3:
        raise InputError("fewer than 3 pings were heard by 3 receivers")
    rows = np.flatnonzero(toa.n_heard > 0)
    first = np.nanmin(toa.toa[rows], axis=1)
    order = np.argsort(first, kind="stable")
    order = order[np.concatenate([[True], np.diff(first[order]) > 0])]
    if lost := len(rows) - len(order):
        text = f"{lost} pings have another's first arrival time and take no part"
        warnings.warn(text, MalocWarning, stacklevel=2)
    time, rows = first[order], rows[order]
    ranges = (toa.toa[rows] - time[:, None]) * np.asarray(toa.sound_speed)[rows, None]
    place = np.asarray(toa.receivers.xy, float)
    if parameters is None or sigma is None:
        values, sigma = _least_energy(time, ranges, place, law, parameters, sigma)
    else:
        values = tuple(float(parameters[n]) for n in law.names)
    prior, filtered, energy = _filter(time, ranges, place, law, values, sigma)
    smoothed = _smooth(time, filtered, law, values)
    known = dict(zip(law.names, values, strict=True)) | {"sigma": sigma}
    return KalmanTrack(
        time, prior, filtered, smoothed, np.isfinite(ranges).sum(axis=1) > 1, movement, known,
        energy, 2,
    )  # fmt: skip


def _filter(
    time: np.ndarray,
    ranges: np.ndarray,
    place: np.ndarray,
    law: Law,
    values: tuple,
    sigma: float,
    close: float = 1e-9,
) -> tuple[States, States, float]:
    """States before and after each ping, linearised to ``close`` metres; minus log density."""
    a, q = steps(law, np.diff(time, append=time[-1] + 1.0), 2, values)
    size, span = a.shape[1], float(np.ptp(place, axis=0).max())
    start = np.zeros((size, size))
    start[:2, :2] = max(span, 1.0) ** 2 * np.eye(2)
    if (variance := law.first(*values)) is not None:
        start[2:, 2:] = variance * np.eye(size - 2)
    # the middle of the receivers that hear most of it
    weight = np.isfinite(ranges[:5]).sum(axis=0)
    mean = np.concatenate([weight @ place / max(weight.sum(), 1), np.zeros(size - 2)])
    covariance, energy, parts = start, 0.0, ([], [], [], [])
    for k in range(len(time)):
        if k:
            mean = a[k - 1] @ mean
            covariance = a[k - 1] @ covariance @ a[k - 1].T + q[k - 1]
        parts[0].append(mean)
        parts[1].append(covariance)
        heard = np.isfinite(ranges[k])
        mean, covariance, cost = _update(
            mean, covariance, ranges[k, heard], place[heard], sigma, 2 * span, close
        )
        energy += cost
        parts[2].append(mean)
        parts[3].append(covariance)
    prior, prior_covariance, filtered, filtered_covariance = map(np.array, parts)
    return States(prior, prior_covariance), States(filtered, filtered_covariance), energy


def linearised(
    at: np.ndarray, emission: float, ranges: np.ndarray, place: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (M, size + 1) of arrivals' ranges by state and emission, and their residuals (M,)."""
    offset = at - place
    distance = np.sqrt((offset**2).sum(axis=1) + _NEAR**2)
    slope = np.zeros((len(ranges), size + 1))
    slope[:, :2], slope[:, -1] = offset / distance[:, None], 1.0
    return slope, ranges - emission - distance


def _arrivals(
    at: np.ndarray,
    expected: np.ndarray,
    before: np.ndarray,
    ranges: np.ndarray,
    place: np.ndarray,
    sigma: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes, covariance and surprise of the arrivals, linearised at a state and emission."""
    slope, off = linearised(at[:2], at[-1], ranges, place, len(at) - 1)
    spread = slope @ before @ slope.T + sigma**2 * np.eye(len(ranges))
    return slope, spread, off - slope @ (expected - at)


def _update(
    mean: np.ndarray,
    covariance: np.ndarray,
    ranges: np.ndarray,
    place: np.ndarray,
    sigma: float,
    wide: float,
    close: float,
) -> tuple[np.ndarray, np.ndarray, float]:
    """One ping: linearised until the place stays; state, covariance, minus log density."""
    size = len(mean)
    expected = np.concatenate([mean, [0.0]])
    before = np.zeros((size + 1, size + 1))
    before[:size, :size], before[size, size] = covariance, wide**2
    at = expected.copy()
    at[size] = np.mean(ranges - np.linalg.norm(mean[:2] - place, axis=1))
    precision = np.linalg.inv(before)

    def misfit(z: np.ndarray) -> float:
        _, off = linearised(z[:2], z[size], ranges, place, size)
        return float((z - expected) @ precision @ (z - expected) + off @ off / sigma**2)

    least = misfit(at)
    for _ in range(_ROUNDS):
        slope, spread, surprise = _arrivals(at, expected, before, ranges, place, sigma)
        step = expected + (slope @ before).T @ np.linalg.solve(spread, surprise) - at
        while (now := misfit(at + step)) > least * (1 + 1e-12) and np.abs(step[:2]).max() > 1e-6:
            step = step / 2
        at, least = at + step, now
        if np.abs(step[:2]).max() < close:
            break
    slope, spread, surprise = _arrivals(at, expected, before, ranges, place, sigma)
    gain = np.linalg.solve(spread, slope @ before).T
    left = np.eye(size + 1) - gain @ slope
    after = left @ before @ left.T + sigma**2 * gain @ gain.T
    _, log_size = np.linalg.slogdet(2 * np.pi * spread)
    cost = 0.5 * (log_size + surprise @ np.linalg.solve(spread, surprise))
    return at[:size], after[:size, :size], float(cost)


def _smooth(time: np.ndarray, filtered: States, law: Law, values: tuple) -> States:
    a, q = steps(law, np.diff(time), 2, values)
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    for k in range(len(time) - 2, -1, -1):
        mean[k], covariance[k] = smoothed_by(
            a[k], q[k], mean[k], covariance[k], mean[k + 1], covariance[k + 1]
        )
    return States(mean, covariance)


def _least_energy(
    time: np.ndarray,
    ranges: np.ndarray,
    place: np.ndarray,
    law: Law,
    parameters: dict[str, float] | None,
    sigma: float | None,
) -> tuple[tuple, float]:
    """Movement parameters and sigma, those that are not given by least energy."""
    from scipy.optimize import minimize

    guess: list[Any] = [*law.guess, 1.0]
    limits = [*law.range, (1e-3, 1e3)]
    given = [None if parameters is None else parameters[n] for n in law.names] + [sigma]
    free = [i for i, value in enumerate(given) if value is None]

    def whole(log_free: np.ndarray) -> list[float]:
        values = [float(v) if v is not None else 0.0 for v in given]
        for i, value in zip(free, np.exp(log_free), strict=True):
            values[i] = float(value)
        return values

    def energy(log_free: np.ndarray) -> float:
        values = whole(log_free)
        value = _filter(time, ranges, place, law, tuple(values[:-1]), values[-1], 1e-2)[2]
        return value if np.isfinite(value) else 1e300

    found = minimize(
        energy, np.log([guess[i] for i in free]), method="Nelder-Mead",
        bounds=[tuple(np.log(limits[i])) for i in free],
        options={"xatol": 1e-3, "fatol": 1e-3, "maxiter": 300},
    )  # fmt: skip
    if found.fun >= 1e300:
        raise FitError("no parameters give the arrivals a finite likelihood")
    values = whole(found.x)
    return tuple(values[:-1]), values[-1]
