"""Which methods there are, and how what they find becomes `Points`."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import signature
from typing import Any

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.points._problem import Found, Problem, residuals, spread_columns
from maloc.points.result import Points

__all__ = ["METHODS", "accepted", "assemble", "checked_prior", "method_of"]

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


def method_of(name: str) -> Callable:
    if name not in METHODS:
        raise InputError(f"no method '{name}' of point positions", mend=f"one of {list(METHODS)}")
    module, function = METHODS[name]
    return getattr(import_module(module), function)


def accepted(run: Callable, method: str, limits: dict, options: dict) -> dict[str, Any]:
    """Keywords for a method: its own options, and the limits that it knows."""
    known = signature(run).parameters
    must = {k: limits[k] for k in limits if k not in ("reach", "estimated")}
    for name, value in (options | must).items():
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


def assemble(
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
        other = assemble(toa, method, part, problem, column, rows[some], d)
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
