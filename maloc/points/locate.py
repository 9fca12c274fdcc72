"""The one entry to point positions: arrival times in, `Points` out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.errors import InputError
from maloc.points._methods import accepted, assemble, checked_prior, method_of
from maloc.points._problem import problem_of, ranges_of
from maloc.points._sigma import diameter, estimate_sigma
from maloc.points.altitude import Depth, Terrain, depths
from maloc.points.result import Points

__all__ = ["locate"]

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
    run = method_of(method)
    below, d = depths(toa, depth)
    if not (toa.n_heard > d).any():
        raise InputError(f"no ping was heard by {d + 1} receivers: no position can be found")
    estimated = sigma is None
    if sigma is None:
        sigma = estimate_sigma(toa, below, d)
    if reach is None:
        reach = 2 * diameter(toa)
    prior = None if prior is None else checked_prior(prior, len(toa))
    limits = {"reach": reach, "region": region, "prior": prior, "estimated": estimated}
    keywords = accepted(run, method, limits, options)
    first = _solve(toa, run, method, sigma, below, d, keywords)
    if not isinstance(depth, Terrain):
        return first
    ground = depth.depth_at(first.position, toa.receivers.crs)
    own = np.asarray(toa.receivers.depth)[None]
    below = np.where(np.isfinite(ground)[:, None], own - ground[:, None], below)
    return _solve(toa, run, method, sigma, below, d, keywords)


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
    points = assemble(toa, method, found, problem, column, rows, d)
    return points.replace(sigma=found.scale * float(sigma)) if np.ndim(sigma) == 0 else points
