"""Kalman filter and Rauch-Tung-Striebel smoother of positions with their covariances.

The algebra is that of statsmodels' state-space library; the movement is maloc's.

References
----------
Sarkka (2013) Bayesian Filtering and Smoothing, chapters 4, 8 and 12 (energy function).
Johnson et al. (2008) Ecology 89: 1208-1215 (CTCRW).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.classical._steps import LAWS, Law, steps
from maloc.errors import FitError, InputError, MalocWarning, needs

if TYPE_CHECKING:
    import polars as pl

    from maloc.points.result import Points

__all__ = ["MOVEMENTS", "KalmanTrack", "States", "kalman"]

MOVEMENTS = tuple(LAWS)

_NOWHERE = 1e4  # m; a position of a larger sd says nothing, and its digits would cost the others'


class States(NamedTuple):
    """Means (T, n) and covariances (T, n, n) of states: d positions (m), then velocities (m/s)."""

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class KalmanTrack:
    """A track by Kalman filter and smoother.

    Attributes
    ----------
    time : (T,) array
        s from the data set's origin, ascending.
    prior, filtered, smoothed : States
        Given the positions before each time (a priori), up to it (a posteriori), and all of them.
    used : (T,) array of bool
        Whether there was a position at that time that could be used.
    movement : str
        One of `MOVEMENTS`.
    parameters : dict of str to float
        ``sigma_step`` (m/s^.5); ``sigma_acc`` (m/s^1.5); ``sigma_vel`` (m/s) and ``t05`` (s).
    energy : float
        Minus log marginal likelihood of the positions after the first.
    d : int
        Axes.
    """

    time: np.ndarray
    prior: States
    filtered: States
    smoothed: States
    used: np.ndarray
    movement: str
    parameters: dict[str, float]
    energy: float
    d: int

    def predict(self, times: Any) -> States:
        """Smoothed states at any times from the first used position on.

        Parameters
        ----------
        times : (n,) array
            s, in any order.

        Returns
        -------
        States
            (n, ...), in the order of `times`.

        Raises
        ------
        InputError
            If a time is before the first position that was used.
        """
        asked = np.atleast_1d(np.asarray(times, float))
        if not np.all(np.isfinite(asked)) or asked.min() < self.time[0]:
            raise InputError(
                f"the first position is at {self.time[0]:g} s, nothing is known before it",
                mend="ask for later times",
            )
        law, values = (
            LAWS[self.movement],
            tuple(self.parameters[n] for n in LAWS[self.movement].names),
        )
        before = np.searchsorted(self.time, asked, side="right") - 1
        a, q = steps(law, asked - self.time[before], self.d, values)
        mean, covariance = _ahead(a, q, *(x[before] for x in self.filtered))
        inner = np.flatnonzero(before < len(self.time) - 1)
        after = before[inner] + 1
        a, q = steps(law, self.time[after] - asked[inner], self.d, values)
        found = smoothed_by(
            a, q, mean[inner], covariance[inner], *(x[after] for x in self.smoothed)
        )
        mean[inner], covariance[inner] = found
        return States(mean, covariance)

    def to_frame(self, states: str = "smoothed") -> pl.DataFrame:
        """Return one row a time: time, x, y (and depth), their sds and xy covariance, used."""
        import polars as pl

        mean, covariance = getattr(self, states)
        names = ["x", "y", "depth"][: self.d]
        columns: dict[str, Any] = {"time": self.time}
        columns |= {n: mean[:, i] for i, n in enumerate(names)}
        columns |= {f"sd_{n}": np.sqrt(covariance[:, i, i]) for i, n in enumerate(names)}
        return pl.DataFrame(columns | {"cov_xy": covariance[:, 0, 1], "used": self.used})


def kalman(
    points: Points,
    movement: str = "ctcrw",
    *,
    parameters: dict[str, float] | None = None,
    keep: np.ndarray | None = None,
) -> KalmanTrack:
    """Filter and smooth the positions of single pings.

    Parameters
    ----------
    points : Points
        Of one tag, from `maloc.points.locate`, with emission times and covariances.
    movement : {"rw", "crw", "ctcrw"}
        Brownian motion; velocity in Brownian motion; continuous-time correlated random walk.
    parameters : dict, optional
        Of the movement, see `KalmanTrack.parameters`. Not given: those of least energy, that is of
        the greatest marginal likelihood.
    keep : (P,) array of bool, optional
        Positions to use; the others' times are filled in. For example a filter's ``keep``.

    Returns
    -------
    KalmanTrack
        A state for every ping with an emission time, from the first that can be used on.

    Raises
    ------
    InputError
        If `movement` or a parameter is unknown, or fewer than 3 positions can be used.
    FitError
        If no parameters of finite energy are found.

    Warns
    -----
    MalocWarning
        If positions have no emission time, or one time's: of those at one time the first counts.

    Notes
    -----
    The first state is the first position with its covariance (a flat prior), at a velocity of sd
    ``sigma_vel``, or 1 m/s for "crw". Positions whose covariance is not finite, or their error
    beyond 10 km, say nothing and are not used (``used``).
    """
    if movement not in LAWS:
        raise InputError(f"movement '{movement}' is none of {', '.join(LAWS)}")
    law = LAWS[movement]
    if parameters is not None and set(parameters) != set(law.names):
        raise InputError(f"the parameters of '{movement}' are {' and '.join(law.names)}")
    usable = np.asarray(np.isfinite(points.position).all(axis=1))
    variance = np.trace(points.covariance, axis1=1, axis2=2)
    usable &= np.isfinite(points.covariance).all(axis=(1, 2)) & (variance <= _NOWHERE**2)
    if keep is not None:
        usable &= np.asarray(keep, bool)
    # of two pings at one time, one that can be used
    order = np.lexsort([~usable, points.emission])
    order = order[np.isfinite(points.emission[order])]
    order = order[np.unique(points.emission[order], return_index=True)[1]]
    if lost := int(usable.sum() - usable[order].sum()):
        text = f"{lost} positions have no emission time, or another's, and take no part"
        warnings.warn(text, MalocWarning, stacklevel=2)
    if usable[order].sum() < 3:
        raise InputError(f"{usable[order].sum()} positions can be used, a track needs 3")
    order = order[np.argmax(usable[order]) :]
    time, xy, covariance = (a[order] for a in (points.emission, points.position, points.covariance))
    used = usable[order]
    xy = np.where(used[:, None], xy, np.nan)
    covariance = np.where(used[:, None, None], covariance, np.eye(xy.shape[1]))
    values = (
        _least_energy(time, xy, covariance, law)
        if parameters is None
        else tuple(float(parameters[n]) for n in law.names)
    )
    found = _smoothed(_bound(time, xy, covariance, law, values))
    prior, filtered, smoothed = (
        States(
            np.asarray(getattr(found, f"{kind}_state").T[: len(time)]),
            np.asarray(np.moveaxis(getattr(found, f"{kind}_state_cov"), 2, 0)[: len(time)]),
        )
        for kind in ("predicted", "filtered", "smoothed")
    )
    return KalmanTrack(
        time, prior, filtered, smoothed, used, movement,
        dict(zip(law.names, values, strict=True)), -float(found.llf), xy.shape[1],
    )  # fmt: skip


def _ahead(a: np.ndarray, q: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> tuple:
    """States (..., n) taken through a step."""
    return (a @ mean[..., None])[..., 0], a @ covariance @ np.swapaxes(a, -1, -2) + q


def smoothed_by(
    a: np.ndarray,
    q: np.ndarray,
    mean: np.ndarray,
    covariance: np.ndarray,
    later: np.ndarray,
    later_covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """States given what is known after them, too: one step back of Rauch, Tung and Striebel's.

    Parameters
    ----------
    a, q : (..., n, n) arrays
        The step to the later state.
    mean, covariance : (..., n) and (..., n, n) arrays
        Of the state, filtered.
    later, later_covariance : (..., n) and (..., n, n) arrays
        Of the later state, smoothed.
    """
    expected, spread = _ahead(a, q, mean, covariance)
    gain = np.swapaxes(np.linalg.solve(spread, a @ covariance), -1, -2)
    more = (gain @ (later - expected)[..., None])[..., 0]
    return mean + more, covariance + gain @ (later_covariance - spread) @ np.swapaxes(gain, -1, -2)


def _bound(time: np.ndarray, xy: np.ndarray, covariance: np.ndarray, law: Law, values: tuple):
    """The library's smoother with these data: the first position is the start, not a datum."""
    try:
        from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother
    except ImportError as problem:
        raise needs("the Kalman filter", "statsmodels", "classical", problem) from None

    d = xy.shape[1]
    a, q = steps(law, np.diff(time, append=time[-1] + 1.0), d, values)
    size = a.shape[1]
    smoother = KalmanSmoother(k_endog=d, k_states=size)
    smoother.bind(np.concatenate([np.full((1, d), np.nan), xy[1:]]))
    smoother["design"] = np.eye(d, size)
    smoother["transition"] = np.moveaxis(a, 0, 2)
    smoother["state_cov"] = np.moveaxis(q, 0, 2)
    smoother["selection"] = np.eye(size)
    smoother["obs_cov"] = np.moveaxis(covariance, 0, 2)
    start = np.zeros((size, size))
    start[:d, :d] = covariance[0]
    if (variance := law.first(*values)) is not None:
        start[d:, d:] = variance * np.eye(size - d)
    smoother.initialize_known(np.concatenate([xy[0], np.zeros(size - d)]), start)
    return smoother


def _smoothed(smoother: Any) -> Any:
    """The library's results, without the smoothed disturbances that nobody asks for."""
    from statsmodels.tsa.statespace.kalman_smoother import SMOOTHER_STATE, SMOOTHER_STATE_COV

    return smoother.smooth(smoother_output=SMOOTHER_STATE | SMOOTHER_STATE_COV)


def _least_energy(time: np.ndarray, xy: np.ndarray, covariance: np.ndarray, law: Law) -> tuple:
    """Parameters of the greatest marginal likelihood, on a log scale within the law's range."""
    from scipy.optimize import minimize

    def energy(log_values: np.ndarray) -> float:
        smoother = _bound(time, xy, covariance, law, tuple(np.exp(log_values)))
        value = -float(smoother.loglike())
        return value if np.isfinite(value) else 1e300

    bounds = [tuple(np.log(r)) for r in law.range]
    best = min(
        (
            minimize(
                energy, np.log(law.guess) + off, method="Nelder-Mead", bounds=bounds,
                options={"xatol": 1e-5, "fatol": 1e-7, "maxiter": 500},
            )
            for off in (-1.5, 0.0)
        ),
        key=lambda found: found.fun,
    )  # fmt: skip
    if best.fun >= 1e300:
        raise FitError("no parameters give the positions a finite likelihood")
    return tuple(float(v) for v in np.exp(best.x))
