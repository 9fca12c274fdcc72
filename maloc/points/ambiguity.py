"""Which of two places: what the pings before and after say, and only they.

Positions stay those of single pings; a neighbouring ping only chooses between the two places that
a ping leaves open (Arnon et al. 2023, sections 2.5 to 2.7).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maloc.points._kalman import Prior, Rules
from maloc.points.result import Points

__all__ = ["Rules", "resolve"]


def resolve(
    points: Points,
    rules: Rules | None = None,
    *,
    hints: Points | None = None,
    backward: bool = True,
) -> Points:
    """Settle ambiguous positions of one tag by its unambiguous ones.

    Parameters
    ----------
    points : Points
        P pings of one tag, in time order, from `maloc.points.locate`.
    rules : Rules, optional
        The seed's thresholds, with its defaults.
    hints : Points, optional
        Earlier localizations of the tag: the latest from four or more receivers within 12 h before
        the first ping start the prior.
    backward : bool
        As when all data are there: once the tag's place is certain, the ambiguous pings before are
        settled backward in time. False: as in real time.

    Returns
    -------
    Points
        Where the other place was chosen the two are exchanged; `ambiguous` is false where a prior
        that was itself unambiguous chose. What stays ambiguous is left as it was.

    References
    ----------
    Arnon et al. (2023) Robust Time-of-Arrival Location Estimation Algorithms for Wildlife
    Tracking. Sensors 23: 9460.
    """
    rules = rules or Rules()
    prior = Prior(rules)
    time = np.where(np.isfinite(points.emission), points.emission, points.time).tolist()
    some = np.flatnonzero(points.located).tolist()
    if hints is not None and some:
        _start(prior, hints, points, time[some[0]])
    swap, settled = np.zeros(len(points), bool), np.zeros(len(points), bool)
    queue: list[int] = []
    doubtful = points.ambiguous | (
        (points.n_used <= rules.unsure) & np.isfinite(points.alternative).all(axis=1)
    )
    for i in some:
        if doubtful[i]:
            if not _choose(prior, points, i, time[i], swap, settled):
                queue = [*queue, i][-rules.queue :]
            continue
        position, covariance = _of(points, i, False)
        if prior.observe(time[i], position, covariance, int(points.n_used[i])) and backward:
            back = replace(prior, seen=[])
            for j in reversed(queue):
                _choose(back, points, j, time[j], swap, settled)
            queue = []
    return _exchanged(points, swap, settled)


def _of(points: Points, i: int, other: bool) -> tuple[np.ndarray, np.ndarray]:
    """Position (2,) and covariance (2, 2) of a ping's first or second place."""
    source = points.other if other and points.other is not None else points
    position = points.alternative[i, :2] if other else points.position[i, :2]
    covariance = source.covariance[i, :2, :2]
    if not np.isfinite(covariance).all():
        covariance = np.diag([1e8, 1e8])
    return position, covariance


def _choose(
    prior: Prior, points: Points, i: int, time: float, swap: np.ndarray, settled: np.ndarray
) -> bool:
    """Choose between a ping's places by an unambiguous prior, and advance it; else False."""
    mean, spread, open_ = prior.at(time)
    if open_:
        return False
    places = [_of(points, i, k) for k in (False, True)]
    cost = []
    for position, covariance in places:
        step = position - mean
        if prior.rules.density:
            total = spread + covariance
            cost.append(step @ np.linalg.solve(total, step) + np.linalg.slogdet(total)[1])
        else:
            cost.append(float(np.linalg.norm(step)))
    pick = bool(np.nan_to_num(cost[1], nan=np.inf) < cost[0])
    position, covariance = places[pick]
    receivers = int(points.n_used[i])
    if not prior.consistent(time, position, receivers):
        return False
    swap[i], settled[i] = pick, True
    prior.observe(time, position, covariance, receivers)
    return True


def _start(prior: Prior, hints: Points, points: Points, first: float) -> None:
    """Start a prior from earlier localizations."""
    rules = prior.rules
    shift = ((hints.origin or 0) - (points.origin or 0)) / 1e9
    time = np.where(np.isfinite(hints.emission), hints.emission, hints.time) + shift
    good = hints.located & ~hints.ambiguous & (hints.n_used >= rules.recent_receivers)
    with np.errstate(invalid="ignore"):
        good &= (time < first) & (time >= first - rules.hint_window)
    for i in np.flatnonzero(good)[-rules.hints :]:
        prior.observe(float(time[i]), *_of(hints, int(i), False), int(hints.n_used[i]))
    if not prior.ambiguous:
        prior.patience = rules.hint_window  # until the first localization of its own


def _exchanged(points: Points, swap: np.ndarray, settled: np.ndarray) -> Points:
    """Exchange the two places of some pings."""
    ambiguous = points.ambiguous & ~settled
    if points.other is None:
        position = np.where(swap[:, None], points.alternative, points.position)
        alternative = np.where(swap[:, None], points.position, points.alternative)
        return points.replace(position=position, alternative=alternative, ambiguous=ambiguous)

    def mixed(a: Points, b: Points) -> dict[str, np.ndarray]:
        names = ("position", "covariance", "emission", "n_used", "residual_rms", "why")
        out = {}
        for name in names:
            x, y = getattr(a, name), getattr(b, name)
            out[name] = np.where(swap.reshape(-1, *[1] * (x.ndim - 1)), y, x)
        return out

    other = points.other.replace(**mixed(points.other, points))
    return points.replace(
        **mixed(points, points.other),
        alternative=other.position,
        other=other,
        ambiguous=ambiguous,
    )
