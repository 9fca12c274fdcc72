"""Range tests: the detection curve from tags at known places.

Sync tags, or tags moored at chosen distances, say at what distance a receiver hears a ping without
any animal in the model. A range test's estimates are a start, and a check, for the movement models.

References
----------
Kessel et al. (2014) A review of detection range testing in aquatic passive acoustic telemetry
studies. Reviews in Fish Biology and Fisheries 24: 199-218.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from maloc.errors import FitError, InputError

__all__ = ["Bins", "RangeTest", "range_test"]

_MIDDLE = 0.5


@dataclass(frozen=True)
class Bins:
    """Observed shares of pings heard, by distance.

    Attributes
    ----------
    distance : (B,) m
        Mean distance of the pairs of ping and receiver in each bin.
    pings : (B,)
        Pairs in it.
    share, low, high : (B,)
        Share heard, and its Wilson 95 % interval.
    """

    distance: np.ndarray
    pings: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, repr=False, eq=False)
class RangeTest:
    """A fitted detection curve.

    Attributes
    ----------
    kind : str
        Detection function, see `maloc.detection.log_probabilities`.
    mode, covariance : (k,), (k, k)
        Posterior mode and Laplace covariance on the unconstrained scale: logit of probabilities,
        log of scale and shape.
    draws : dict of (D, ...) arrays
        Posterior draws of p0, scale (m) and, where they are in the model, shape, coefficient (C,)
        and p_lost.
    conditional : bool
        Only pings that somebody heard were known.
    unheard : float
        Share of pings that nobody hears, as the curve has it, p_lost included.
    distance, heard, listening : (P, R) arrays
        The data.
    """

    kind: str
    mode: np.ndarray
    covariance: np.ndarray
    draws: dict[str, np.ndarray]
    conditional: bool
    unheard: float
    distance: np.ndarray = field(repr=False)
    heard: np.ndarray = field(repr=False)
    listening: np.ndarray = field(repr=False)

    def __repr__(self) -> str:
        shown = ", ".join(
            f"{name} {np.round(middle, 3)} [{np.round(low, 3)}, {np.round(high, 3)}]"
            for name, (middle, low, high) in self.estimates().items()
        )
        return f"RangeTest({self.kind}, {len(self.heard)} pings: {shown})"

    def estimates(self, level: float = 0.95) -> dict[str, tuple[Any, Any, Any]]:
        """Posterior median and interval of each parameter, by name."""
        return {name: _interval(draws, level) for name, draws in self.draws.items()}

    def curve(self, distance, level: float = 0.95) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Probability of hearing a ping at distances (G,), m, at average covariates.

        Whole-ping loss is not in it.

        Returns
        -------
        p, low, high : (G,) arrays
            Posterior median and the pointwise band.
        """
        distance = np.asarray(distance, float).reshape(1, -1)
        return _interval(self._p(distance), level)

    def reach(self, p: float, level: float = 0.95) -> tuple[float, float, float]:
        """Distance (m) at which a ping is heard with probability ``p``, and its interval.

        0 where the curve starts below ``p``.

        Raises
        ------
        InputError
            If ``p`` is not between 0 and 1.
        """
        if not 0 < p < 1:
            raise InputError(f"a distance is heard with a probability between 0 and 1, not {p:g}")
        low, high = np.zeros((len(self.draws["p0"]), 1)), self.draws["scale"][:, None].copy()
        high[self._p(low) <= p] = 0
        while np.any(beyond := self._p(high) > p):
            high[beyond] *= 2
        for _ in range(50):
            middle = (low + high) / 2
            near = self._p(middle) > p
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        middle, lowest, highest = _interval(high[:, 0], level)
        return float(middle), float(lowest), float(highest)

    def bins(self, edges=None) -> Bins:
        """Observed shares by distance, in bins with ``edges`` (m), or in 20 of equal size.

        Where only pings that somebody heard are known, each receiver is asked about those that
        another one heard: the share is then not biased by its own hearing.
        """
        known = np.array(self.listening)
        if self.conditional:
            known &= (self.heard.sum(axis=1, keepdims=True) - self.heard) > 0
        distance, heard = self.distance[known], self.heard[known]
        if edges is None:
            edges = np.unique(np.quantile(distance, np.linspace(0, 1, 21)))
        edges = np.asarray(edges, float)
        which = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, len(edges) - 2)
        inside = (distance >= edges[0]) & (distance <= edges[-1])
        which, distance, heard = which[inside], distance[inside], heard[inside]
        n = np.bincount(which, minlength=len(edges) - 1)
        some = n > 0
        total = np.bincount(which, distance, len(n))[some]
        count, n = np.bincount(which, heard, len(n))[some], n[some]
        return Bins(total / n, n, count / n, *_wilson(count, n))

    def _p(self, distance):
        """Curve of every draw, (D, G), at distances (1, G) or (D, G)."""
        from maloc.detection.hearing import log_probabilities

        column = {name: value[:, None] for name, value in self.draws.items() if value.ndim == 1}
        shape = column.get("shape")
        distance = np.broadcast_to(distance, (len(column["p0"]), distance.shape[1]))
        log_p, _ = log_probabilities(self.kind, distance, column["p0"], column["scale"], shape)
        return np.exp(np.asarray(log_p))


def _interval(draws, level):
    tail = (1 - level) / 2
    middle, low, high = np.quantile(draws, [_MIDDLE, tail, 1 - tail], axis=0)
    return middle, low, high


def _wilson(count, n, z=1.959964):
    """Wilson's 95 % interval of a share."""
    centre = (count + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * np.sqrt(count * (n - count) / n + z**2 / 4)
    return np.maximum(centre - half, 0), np.minimum(centre + half, 1)


def range_test(
    heard,
    positions,
    receiver_xy=None,
    *,
    listening=None,
    kind: str = "halfnormal",
    covariates=None,
    loss: bool = False,
    conditional: bool = False,
    method: str = "laplace",
    draws: int = 2000,
    seed: int = 0,
) -> RangeTest:
    """Fit a detection curve to pings sent from known places.

    Parameters
    ----------
    heard : (P, R) bool array or EncounterHistory
        Which receivers heard each ping.
    positions : (P, 2) array or, with a history, (N, 2)
        Where each ping was sent, or where each of the history's tags lies (m).
    receiver_xy : (R, 2) array, optional
        Receivers' positions (m); a history has them.
    listening : (P, R) bool array, optional
        Which receivers were on; a history has them; all by default.
    kind : {"halfnormal", "logistic", "hazard"}
        Detection function.
    covariates : (P, R, C) array, optional
        Standardised covariates of the linear predictor.
    loss : bool
        Pings may be lost to every receiver at once.
    conditional : bool
        Only pings that somebody heard are known (their schedule is not): each ping's probability is
        divided by that of being heard at all, and pings that nobody heard are left out.
    method : {"laplace", "nuts"}
        Draws from the normal distribution at the mode, or by NUTS.
    draws : int
        Posterior draws.
    seed : int
        Seed of the draws.

    Returns
    -------
    RangeTest

    Raises
    ------
    InputError
        If shapes do not fit, nothing was heard, or ``loss`` is asked for with ``conditional``
        (every known ping was heard, so that nothing is known of lost ones).
    FitError
        If the mode is not a proper maximum.

    Notes
    -----
    Priors are normal on the unconstrained scale and weak: logit p0 ~ N(0, 2), log scale ~
    N(log median distance at which a ping was heard, 1.5), log shape ~ N(log 3, .5), coefficients ~
    N(0, 2), logit p_lost ~ N(-2, 1.5).
    """
    history: Any = heard
    if hasattr(history, "receivers"):
        receiver_xy = history.receivers.xy if receiver_xy is None else receiver_xy
        listening = history.listening if listening is None else listening
        of_tags = np.asarray(positions, float)
        if len(of_tags) == len(history.tags):
            positions = of_tags[history.tag]
        heard = history.heard
    near, on, y, x = data = _checked(heard, positions, receiver_xy, listening, covariates)
    if loss and conditional:
        raise InputError(
            "lost pings cannot be told where only heard pings are known",
            mend="leave out loss, or give every ping sent, heard or not",
        )
    if method not in ("laplace", "nuts"):
        raise InputError(f"method {method!r} is none of laplace, nuts")
    from maloc.detection import rangetest_fit as fit

    if conditional:
        some = y.any(axis=1)
        near, on, y, x = data = near[some], on[some], y[some], x[some]
    if not y.any():
        raise InputError("no ping of the range test was heard")
    distance = np.hypot(near[..., 0], near[..., 1])
    names = fit.names(kind, x.shape[2], loss)
    middle, spread = fit.prior(names, math.log(max(np.median(distance[y]), 1e-3)))
    problem = fit.Problem(kind, tuple(names), conditional)
    mode, covariance = fit.mode(problem, middle, spread, data)
    if not np.all(np.isfinite(covariance)):
        raise FitError("the range test's curve has no proper maximum: too few pings heard, or all")
    if method == "laplace":
        flat = np.random.default_rng(seed).multivariate_normal(mode, covariance, draws)
    else:
        flat = fit.nuts(problem, mode, covariance, middle, spread, data, draws, seed)
    unheard = fit.unheard(problem, mode, data)
    natural = fit.natural(names, flat)
    return RangeTest(kind, mode, covariance, natural, conditional, unheard, distance, y, on)


def _checked(heard, positions, receiver_xy, listening, covariates):
    """Receivers' offsets from each ping, listening, heard, covariates: shapes fit."""
    heard = np.asarray(heard, bool)
    if heard.ndim != 2:
        raise InputError(f"heard must be pings x receivers, not of shape {heard.shape}")
    if receiver_xy is None:
        raise InputError("a range test needs the receivers' positions", mend="give receiver_xy")
    positions, receiver_xy = np.asarray(positions, float), np.asarray(receiver_xy, float)
    n, r = heard.shape
    on = np.ones((n, r), bool) if listening is None else np.asarray(listening, bool)
    x = np.zeros((n, r, 0)) if covariates is None else np.asarray(covariates, float)
    for name, got, want in (
        ("positions", positions.shape, (n, 2)),
        ("receiver_xy", receiver_xy.shape, (r, 2)),
        ("listening", on.shape, (n, r)),
        ("covariates", x.shape, (n, r, *x.shape[2:3])),
    ):
        if got != want:
            raise InputError(f"{name} has shape {got}, not {want}, for {n} pings, {r} receivers")
    near = receiver_xy[None] - positions[:, None]
    if not (np.all(np.isfinite(near)) and np.all(np.isfinite(x))):
        raise InputError("positions and covariates of a range test must be finite numbers")
    if np.any(heard & ~on):
        raise InputError("a receiver that did not listen heard a ping of the range test")
    return near, on, heard, x
