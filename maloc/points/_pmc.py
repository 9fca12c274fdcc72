"""Population Monte Carlo: each ping's posterior under any law of arrival errors.

References
----------
Campbell, Shry, Lundberg, Calles & Holker (2025) A population Monte Carlo model for underwater
acoustic telemetry positioning in reflective environments. Methods Ecol. Evol. 16(4): 775-785.
Elvira, Martino, Luengo & Bugallo (2017) Improving population Monte Carlo: alternative weighting
and resampling schemes. Signal Process. 131: 77-91.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import numpy as np

from maloc.errors import InputError
from maloc.points._prior import Prior, edges, hull, spread, start_in
from maloc.points._problem import Found, Problem, in_batches

__all__ = ["dm_pmc", "pmc"]

_MIN_LATENESS = 375.0  # m; receivers are blanked about .25 s after a detection
_BACKGROUND = 1e-4  # share of arrivals that may be anything, as in the track models
_STARTS = 96  # starting places in the polygon, besides those of minimal sets
_SUBSET = 128  # pings from which sigma and the share of reflected arrivals are estimated
_ROUNDS = 4
_SURE = 0.05  # a second place with this mass or more is an alternative

Law = Literal["ddetect", "gaussian", "student"]


def pmc(
    problem: Problem,
    d: int,
    *,
    error: Any = "ddetect",
    reflected: float | None = None,
    lateness: float | None = None,
    beta: float = 32.0,
    df: float = 3.0,
    n_particles: int = 500,
    iterations: int = 5,
    kernels: int = 50,
    perturbation: float = 2.0,
    start: np.ndarray | None = None,
    region: np.ndarray | None = None,
    fade: float | None = None,
    seed: int = 0,
    keep: bool = False,
    estimated: bool = False,
    mixture: bool = False,
) -> Found:
    """Posterior of every ping by population Monte Carlo.

    Parameters
    ----------
    problem : Problem
        P pings.
    d : int
        2 or 3.
    error : {"ddetect", "gaussian", "student"} or ArrivalError
        Law of residuals; one by name takes its sigma from the arrivals', an `ArrivalError` is
        taken as it is (m, around 0).
    reflected : float, optional
        Share of reflected arrivals (ddetect); estimated from up to 128 pings when not given.
    lateness : float, optional
        Largest lateness (ddetect), m; the array's diameter, 375 m at least, when not given.
    beta : float
        Shape of the reflected arrivals' law: 32 or 128 in kaltoa.
    df : float
        Degrees of freedom (student).
    n_particles, iterations : int
    kernels : int
        Number of kernels from which each population is drawn; a divisor of `n_particles`.
    perturbation : float
        Kernel's standard deviation, in the arrivals' standard deviations carried to the place by
        the geometry (kaltoa: the same in every direction).
    start : array (N0, d), optional
        Starting places, m; 96 in the convex polygon around the receivers when not given. Those
        that minimal sets of arrivals point to are added.
    region : array (V, 2), optional
        Polygon, m, that the tag cannot have left.
    fade : float, optional
        The tag is taken to be anywhere in the convex polygon around the receivers alike, less
        likely beyond: standard deviation of the fall-off, m; a quarter of the array's diameter
        when not given.
    seed : int
        Same seed, same answer, whatever other pings there are.
    keep : bool
        Return the last population: `extra` "particles" (P, N, d + 1) and "weights" (P, N).
    estimated : bool
        The arrivals' sigma is an estimate, to be improved (ddetect) with the reflected share.
    mixture : bool
        Weights by the mixture of all kernels (deterministic mixture), or each particle by its own
        kernel, which favours the larger of two modes more with every iteration.

    Returns
    -------
    Found
        Position: the posterior's mean around its mode; covariance: of the whole posterior, around
        that. `extra`: "ess" effective sample size, "log_evidence" of all arrivals (prior 1 in the
        polygon), "mean" (P, d) of the whole posterior, "lo" and
        "hi" (P, d) central 95 % of each coordinate, "radius" squared Mahalanobis distance that
        holds 95 %, "mode" (P, d), "other_share" mass away from the mode; of each arrival
        "p_reflected".
    """
    if n_particles < 10 or iterations < 1:
        raise InputError("population Monte Carlo needs 10 particles and 1 iteration or more")
    if kernels < 1 or n_particles % kernels:
        raise InputError(f"{kernels} kernels do not divide {n_particles} particles")
    corners, diameter = hull(problem)
    law = _law(error, beta, df, max(diameter, _MIN_LATENESS) if lateness is None else lateness)
    places = problem.place[problem.heard]
    vertical = (float(places[:, 2].min()), float(places[:, 2].max())) if d == 3 else (0.0, 0.0)
    prior = Prior(
        edges(corners),
        np.asarray(diameter / 4 if fade is None else float(fade)),
        np.asarray(vertical),
        np.zeros((0, 2)) if region is None else np.asarray(region, float),
    )
    if start is None:
        start = start_in(corners, _STARTS)
        if d == 3:
            deep = np.linspace(*vertical, _STARTS + 2)[1:-1]
            start = np.column_stack([start, np.random.default_rng(0).permutation(deep)])
    start = np.asarray(start, float)
    if start.ndim != 2 or start.shape[1] != d or not len(start):
        raise InputError(f"start must be (N, {d}), got shape {start.shape}")
    # row i depends on the seed and i alone
    shift = np.random.default_rng(seed).random((len(problem.heard), iterations, d + 4))
    run = partial(
        _run,
        start=start,
        prior=prior,
        base=spread(n_particles, d + 3),
        span=diameter / 10,
        width=float(perturbation),
        static={
            "d": d,
            "kernels": kernels,
            "mixture": mixture,
            "keep": False,
        },
    )
    scale = 1.0
    if error == "ddetect":
        law.w = np.asarray(0.1 if reflected is None else float(reflected))
        scale = _calibrated(problem, shift, law, run, reflected is None, estimated)
        problem = problem._replace(sigma=problem.sigma * scale)
    value, each = run(problem, shift, law, keep=keep)
    return _found(problem, value, each, keep, scale)


dm_pmc = partial(pmc, mixture=True)  # the deterministic mixture


def _run(
    problem: Problem,
    shift: np.ndarray,
    law: Any,
    *,
    start: np.ndarray,
    prior: Prior,
    base: np.ndarray,
    span: float,
    width: float,
    static: dict,
    keep: bool = False,
) -> tuple[dict, dict]:
    from maloc.points._population import population

    return in_batches(
        population,
        problem,
        (shift,),
        (law, prior, start, base, span, width),
        static=static | {"keep": keep},
        pings_last=False,
        largest=64,
    )


def _calibrated(
    problem: Problem, shift: np.ndarray, law: Any, run: Any, share: bool, sigma: bool
) -> float:
    """Set the law's share of reflected arrivals, and return a factor for sigma: rounds of EM.

    From pings with two arrivals to spare: with fewer, any arrival can be explained away.
    """
    spare = problem.heard.sum(axis=1)
    rows = np.flatnonzero(spare >= 5)
    if not len(rows) or not (share or sigma):
        return 1.0
    rows = rows[:: -(-len(rows) // _SUBSET)]
    some, scale = problem.rows(rows), 1.0
    for _ in range(_ROUNDS):
        scaled = some._replace(sigma=some.sigma * scale)
        _, each = run(scaled, shift[rows], law)
        late = each["p_reflected"][some.heard]
        if share:
            law.w = np.asarray(np.clip((late.sum() + 1) / (len(late) + 10), 0.005, 0.6))
        if sigma:
            square = (each["direct_square"] / some.sigma**2)[some.heard].sum()
            scale = float(np.clip(np.sqrt(square / max((1 - late).sum(), 1.0)), 0.2, 5.0))
    return scale


def _law(error: Any, beta: float, df: float, lateness: float) -> Any:
    """The law; a sigma of NaN stands for that of each arrival."""
    from maloc.arrival import ArrivalError, DDetect, Gaussian, Student

    if isinstance(error, ArrivalError):
        return error
    if error == "ddetect":
        return DDetect(0.0, np.nan, lateness, 0.1, float(beta), _BACKGROUND, validate_args=False)
    if error == "gaussian":
        return Gaussian(0.0, np.nan, validate_args=False)
    if error == "student":
        return Student(0.0, np.nan, float(df), validate_args=False)
    raise InputError(f"error '{error}' is no law of arrivals", mend="ddetect, gaussian or student")


def _found(problem: Problem, value: dict, each: dict, keep: bool, scale: float) -> Found:
    alive = value["alive"] & np.isfinite(value["position"]).all(axis=1)
    reflected = np.where(problem.heard, each["p_reflected"], np.nan)
    used = problem.heard & (each["p_reflected"] < 0.5) & alive[:, None]
    other = alive & (value["other_share"] >= _SURE)

    def known(name: str) -> np.ndarray:
        a = value[name]
        return np.where(alive.reshape(-1, *(1,) * (a.ndim - 1)), a, np.nan)

    extra = {
        k: known(k)
        for k in ("ess", "log_evidence", "mean", "lo", "hi", "radius", "mode", "other_share")
    }
    if keep:
        extra["particles"] = np.swapaxes(value["particles"], 1, 2)
        extra["weights"] = value["weights"]
    return Found(
        known("position"),
        known("emission"),
        used,
        other,
        np.where(other[:, None], value["other"], np.nan),
        np.where(alive, "", "no particle fits the arrivals"),
        covariance=known("covariance"),
        scale=scale,
        extra=extra,
        arrival_extra={"p_reflected": reflected},
    )
