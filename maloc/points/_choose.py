"""Of two places that may explain a ping: the better, and whether the arrivals tell them apart."""

from __future__ import annotations

import numpy as np

from maloc.points._problem import Found, Problem

__all__ = ["SAME", "choose", "inside"]

SAME = 1e-3  # m; the roots of one minimal set are two places unless nearer than this


def inside(xy: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) lie in a polygon (V, 2): even-odd rule; True without corners."""
    if not len(region):
        return np.ones(xy.shape[:-1], bool)
    x, y = xy[..., 0, None], xy[..., 1, None]
    (ax, ay), (bx, by) = region.T, np.roll(region, -1, axis=0).T
    crosses = (ay > y) != (by > y)
    rise = np.where(by == ay, 1.0, by - ay)
    return (crosses & (x < ax + (y - ay) * (bx - ax) / rise)).sum(-1) % 2 == 1


def choose(
    problem: Problem,
    value: dict[str, np.ndarray],
    used: np.ndarray,
    d: int,
    *,
    reach: float = np.inf,
    region: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    apart: float = 10.0,
    evidence: float = 6.0,
) -> Found:
    """Choose between two places a ping, or keep both.

    Parameters
    ----------
    problem : Problem
        P pings.
    value : dict
        "position" (P, 2, d) m, "emission" (P, 2) m, "cost" (P, 2) twice the negative log
        likelihood, "any" (P, 2) whether there is such a place at all.
    used : array (P, M, 2) bool
        Arrivals that each place rests on.
    d : int
        2 or 3.
    reach : float
        Largest distance (m) from the nearest receiver that heard the ping.
    region : array (V, 2), optional
        Polygon, m, that the tag cannot have left.
    prior : array (P, 2), optional
        Where the tag is thought to have been, m; NaN where unknown. Of two places that fit the
        nearer one is preferred; the ping stays ambiguous.
    apart : float
        Two places nearer than this (m) are one, unless d + 1 arrivals are all there is.
    evidence : float
        Difference of cost up to which two places fit equally well.
    """
    position, emission, cost = value["position"], value["emission"], value["cost"]
    n = len(position)
    ok = value["any"] & np.isfinite(position).all(-1) & (used.sum(axis=1) > d)
    square = sum(
        (position[:, None, :, i] - problem.place[:, :, None, i]) ** 2 for i in range(2)
    )  # (P, M, 2)
    nearest = np.where(problem.heard[..., None], square, np.inf).min(axis=1)
    polygon = np.zeros((0, 2)) if region is None else np.asarray(region, float)
    fits = ok & (nearest <= reach**2) & inside(position[..., :2], polygon)
    score = np.where(fits, cost, np.inf)
    one = (score[:, 1] < score[:, 0]).astype(int)
    several = problem.heard.sum(axis=1) > d + 1
    gap = np.linalg.norm(position[:, 0] - position[:, 1], axis=-1)
    two_places = gap > np.where(several, apart, SAME)
    with np.errstate(invalid="ignore"):
        tie = fits.all(axis=1) & two_places & (np.abs(cost[:, 1] - cost[:, 0]) < evidence)
    if prior is not None:
        to_prior = np.linalg.norm(position[..., :2] - prior[:, None], axis=-1)
        told = tie & np.isfinite(to_prior).all(axis=1)
        one = np.where(told, to_prior.argmin(axis=1), one)
    row, two = np.arange(n), 1 - one
    some = fits[row, one]
    why = np.select(
        [some, ok.any(axis=1), value["any"].any(axis=1)],
        ["", "the arrivals point out of reach", "the arrivals disagree"],
        "no place fits the arrivals",
    )
    mine = used[row, :, one] & some[:, None]
    agreed = mine & (used[row, :, two] | ~tie[:, None])
    # d + 1 arrivals agree on some place whatever they are: where others disagree that is no proof
    unproven = some & several & (mine.sum(axis=1) == d + 1)
    agreed &= ~(several & (agreed.sum(axis=1) <= d + 1))[:, None]
    nothing = np.full((n, d), np.nan)
    second = np.where(tie[:, None], position[row, two], np.nan)
    other = Found(
        second,
        np.where(tie, emission[row, two], np.nan),
        used[row, :, two] & tie[:, None],
        tie,
        nothing,
        np.where(tie, "", "no second place"),
        agreed=agreed,
    )
    return Found(
        np.where(some[:, None], position[row, one], np.nan),
        np.where(some, emission[row, one], np.nan),
        mine,
        tie | unproven,
        second,
        why,
        agreed=agreed,
        other=other,
    )
