"""The one entry to point positions: arrival times in, `Points` out."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import signature
from typing import Any, Literal

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.points._problem import Found, Problem, problem_of, ranges_of, residuals, spread_columns
from maloc.points._sigma import diameter, estimate_sigma
from maloc.points.altitude import Depth, Terrain, depths
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
    sigma: float | np.ndarray | None = None,
    depth: Depth = "auto",
    reach: float | None = None,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    **options: Any,
) -> Points:
    """Locate every ping from its own arrivals.

    Parameters
    ----------
    toa : ArrivalTimes
        P pings, R columns, on one common clock (for clocks that never were brought together:
        `maloc.points.locate_by_beacons`).
    method : str
        "consensus": hypotheses from minimal sets, ranked by how many arrivals agree, least squares
        on those; "cluster": the same, the hypothesis found by clustering; "closed-form";
        "least-squares" of all arrivals; "differential-evolution"; "pmc" and "dm-pmc": population
        Monte Carlo.
    sigma : float or array (P, R), optional
        Standard deviation of an arrival's error, m; estimated from the pings when not given.
    depth : "auto", "flat", "sensor", "3d", float, array (P,) or Terrain
        Where the tag was in the vertical, m down: as sensed where sensed ("auto") and otherwise
        at the receivers' depth ("flat"); always as sensed; to be found; at a known depth; on the
        terrain (two solves: at a fixed depth, then at that of the ground where the first was).
    reach : float, optional
        Largest distance (m) from the nearest receiver that heard a ping; twice the array's
        diameter when not given.
    region : array (V, 2), optional
        Polygon, m, that the tag cannot have left.
    prior : array (P, 2), optional
        Where the tag is thought to have been, m, NaN where unknown: chooses between places that
        fit equally well. `maloc.points.resolve` makes it of the other pings.
    **options
        Of the method.

    Returns
    -------
    Points

    Raises
    ------
    InputError
        If the method is unknown, an option is wrong, or no ping was heard by enough receivers.

    References
    ----------
    Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife
    Tracking. Sensors 23: 9460.
    """
    run = _method(method)
    below, d = depths(toa, depth)
    if not (toa.n_heard > d).any():
        raise InputError(f"no ping was heard by {d + 1} receivers: no position can be found")
    if sigma is None:
        sigma = estimate_sigma(toa, below, d)
    if reach is None:
        reach = 2 * diameter(toa)
    prior = None if prior is None else checked_prior(prior, len(toa))
    limits = {"reach": reach, "region": region, "prior": prior}
    keywords = _accepted(run, method, limits, options)
    first = _solve(toa, run, method, sigma, below, d, keywords)
    if not isinstance(depth, Terrain):
        return first
    ground = depth.depth_at(first.position, toa.receivers.crs)
    own = np.asarray(toa.receivers.depth)[None]
    below = np.where(np.isfinite(ground)[:, None], own - ground[:, None], below)
    return _solve(toa, run, method, sigma, below, d, keywords)


def _method(name: str) -> Callable:
    if name not in METHODS:
        raise InputError(f"no method '{name}' of point positions", mend=f"one of {list(METHODS)}")
    module, function = METHODS[name]
    return getattr(import_module(module), function)


def _accepted(run: Callable, method: str, limits: dict, options: dict) -> dict[str, Any]:
    """Keywords for a method: its own options, and the limits that it knows."""
    known = signature(run).parameters
    for name, value in (options | {k: v for k, v in limits.items() if k != "reach"}).items():
        if name not in known and value is not None:
            raise InputError(f"method '{method}' has no option '{name}'")
    keywords = options | {k: v for k, v in limits.items() if k in known}
    if "prior" in keywords and keywords["prior"] is None:
        del keywords["prior"]
    return keywords


def checked_prior(prior: Any, n: int) -> np.ndarray:
    """Prior positions (P, 2), checked."""
    out = np.asarray(prior, float)
    if out.shape != (n, 2):
        raise InputError(f"prior must be ({n}, 2), got shape {out.shape}")
    return out


def _solve(
    toa: ArrivalTimes,
    run: Callable,
    method: str,
    sigma: float | np.ndarray,
    below: np.ndarray,
    d: int,
    keywords: dict[str, Any],
) -> Points:
    each = np.broadcast_to(np.asarray(sigma, float), toa.toa.shape)
    if not (each[toa.heard] > 0).all():
        raise InputError("sigma must be positive")
    problem, column = problem_of(ranges_of(toa), toa.receivers.xy, below, each)
    rows = np.flatnonzero(toa.n_heard > d)
    mine = dict(keywords)
    if mine.get("prior") is not None:
        mine["prior"] = mine["prior"][rows]
    found = run(problem.rows(rows), d, **mine)
    points = _points(toa, method, found, problem, column, rows, d)
    return points.replace(sigma=float(sigma)) if np.ndim(sigma) == 0 else points


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

    other = None
    if found.other is not None:
        some = np.flatnonzero(np.isfinite(found.alternative).all(axis=1))
        part = found.other.rows(some)
        other = _points(toa, method, part, problem, column, rows[some], d)
        other = other.replace(why=np.where(other.located, "", "no second place"))
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
        other=other,
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
    used = found.used.sum(axis=1)
    total = np.where(found.used, residuals(problem, found) ** 2, 0.0).sum(axis=1)
    return np.where(used > 0, np.sqrt(total / np.maximum(used, 1)), np.nan)
