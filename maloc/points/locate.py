"""The one entry to point positions: arrival times in, `Points` out."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.points._problem import Found, Problem, problem_of, spread_columns
from maloc.points.result import Points

__all__ = ["METHODS", "locate"]

# name -> module and function: found(problem, d, **options) -> Found
METHODS = {
    "consensus": ("maloc.points._robust", "consensus"),
    "cluster": ("maloc.points._cluster", "cluster"),
    "closed-form": ("maloc.points._closed", "closed_form"),
    "least-squares": ("maloc.points._lm", "least_squares"),
    "differential-evolution": ("maloc.points._differential_evolution", "differential_evolution"),
    "pmc": ("maloc.points._pmc", "pmc"),
    "dm-pmc": ("maloc.points._pmc", "dm_pmc"),
}
Method = Literal[
    "consensus",
    "cluster",
    "closed-form",
    "least-squares",
    "differential-evolution",
    "pmc",
    "dm-pmc",
]


def locate(
    toa: ArrivalTimes,
    method: Method = "consensus",
    *,
    sigma: float | np.ndarray = 1.5,
    **options: Any,
) -> Points:
    """Locate every ping from its own arrivals.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings, R columns.
    method : str
        "consensus": hypotheses from triplets, ranked by how many arrivals agree, least squares
        on those; "cluster": the same, by clustering the hypotheses; "closed-form"; "least-squares"
        of all arrivals; "differential-evolution"; "pmc" and "dm-pmc": population Monte Carlo.
    sigma : float or array (P, R)
        Standard deviation of an arrival's error, m.
    **options
        Of the method.

    Returns
    -------
    Points

    Raises
    ------
    InputError
        If the method is unknown or an option is wrong.
    """
    if method not in METHODS:
        raise InputError(f"no method '{method}' of point positions", mend=f"one of {list(METHODS)}")
    module, name = METHODS[method]
    run = getattr(import_module(module), name)
    d = 2
    problem, column = problem_of(toa, np.zeros(toa.toa.shape), sigma)
    count = toa.n_heard
    rows = np.flatnonzero(count > d)
    if not len(rows):
        raise InputError(f"no ping was heard by {d + 1} receivers: no position can be found")
    found = run(problem.rows(rows), d, **options)
    return _points(toa, method, found, problem, column, rows, d)


def _points(
    toa: ArrivalTimes,
    method: str,
    found: Found,
    problem: Problem,
    column: np.ndarray,
    rows: np.ndarray,
    d: int,
) -> Points:
    """Bring what a method found for some pings to all pings and columns."""
    from maloc.points.covariance import covariance

    n, r = toa.toa.shape
    mine = problem.rows(rows)
    cov = found.covariance
    if cov is None:
        cov = covariance(found.position, mine.place, found.used, mine.sigma)
    agreed = found.used if found.agreed is None else found.agreed
    first = np.where(toa.heard, toa.toa, np.inf).min(axis=1)
    first = np.where(np.isfinite(first), first, np.nan)
    why = np.array([_too_few(k, d) for k in toa.n_heard.tolist()], dtype="U64")
    why[rows] = found.why

    def whole(part: np.ndarray) -> np.ndarray:
        out = np.zeros((n, *part.shape[1:]), part.dtype)
        if part.dtype.kind == "f":
            out[:] = np.nan
        out[rows] = part
        return out

    return Points(
        position=whole(found.position),
        covariance=whole(cov),
        emission=first + whole(found.emission) / toa.sound_speed,
        inlier=whole(spread_columns(agreed, column[rows], r, False)),
        n_used=whole(found.used.sum(axis=1)),
        ambiguous=whole(found.ambiguous),
        alternative=whole(found.alternative),
        residual_rms=whole(_rms(mine, found)),
        method=method,
        why=why,
        ping=toa.ping,
        time=first,
        tag=toa.tag,
        origin=toa.origin,
        extra={k: whole(v) for k, v in found.extra.items()}
        | {
            k: whole(spread_columns(v, column[rows], r, np.nan))
            for k, v in found.arrival_extra.items()
        },
    )


def _too_few(count: int, d: int) -> str:
    return "" if count > d else f"heard by {count} receivers, {d + 1} are needed"


def _rms(problem: Problem, found: Found) -> np.ndarray:
    """Root mean square of the residuals of the arrivals used, m."""
    d = found.position.shape[1]
    offset = found.position[:, None] - problem.place[..., :d]
    square = (offset**2).sum(-1) + (0.0 if d == 3 else problem.place[..., 2] ** 2)
    residual = problem.range - found.emission[:, None] - np.sqrt(square)
    used = found.used.sum(axis=1)
    total = np.where(found.used, residual**2, 0.0).sum(axis=1)
    return np.where(used > 0, np.sqrt(total / np.maximum(used, 1)), np.nan)
