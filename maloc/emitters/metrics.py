"""How well a set of positions answers a set of true ones: OSPA and GOSPA.

References
----------
Schuhmacher, Vo & Vo (2008) A consistent metric for performance evaluation of multi-object filters.
IEEE Trans. Signal Process. 56: 3447-3457.
Rahmathullah, Garcia-Fernandez & Svensson (2017) Generalized optimal sub-pattern assignment metric.
20th Int. Conf. Inf. Fusion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.errors import InputError

__all__ = ["Gospa", "gospa", "ospa"]


class Gospa(NamedTuple):
    """GOSPA and what it is made of.

    Attributes
    ----------
    distance : float
        (localisation + (missed + false) c^p / 2)^(1 / p), m.
    localisation : float
        Sum of the assigned pairs' distances to the power p, m^p.
    missed, false : int
        True positions without an estimate, and estimates without a true position.
    pair : array (T,) of int
        Estimate assigned to each true position, -1 = none.
    """

    distance: float
    localisation: float
    missed: int
    false: int
    pair: np.ndarray


def gospa(truth: np.ndarray, estimate: np.ndarray, c: float, p: float = 2.0) -> Gospa:
    """Generalized optimal sub-pattern assignment metric, alpha = 2.

    Parameters
    ----------
    truth : array (T, d)
        True positions, m.
    estimate : array (E, d)
        Estimates, m.
    c : float
        Distance at which an estimate is no estimate of a true position, m.
    p : float
        Order, at least 1.

    Returns
    -------
    Gospa

    Raises
    ------
    InputError
        If shapes do not agree, c is not positive or p below 1.
    """
    cost = _distances(truth, estimate, c, p)
    t, e = cost.shape
    # an assignment costs at most c^p: as much as leaving both unassigned
    i, j = _assignment(cost)
    used = cost[i, j] < c**p
    i, j = i[used], j[used]
    pair = np.full(t, -1)
    pair[i] = j
    localisation = float(cost[i, j].sum())
    missed, false = t - len(i), e - len(i)
    distance = (localisation + (missed + false) * c**p / 2) ** (1 / p)
    return Gospa(float(distance), localisation, missed, false, pair)


def ospa(truth: np.ndarray, estimate: np.ndarray, c: float, p: float = 2.0) -> float:
    """Optimal sub-pattern assignment metric, m: a mean over the larger set, cut at c.

    Parameters and errors as of `gospa`; 0 where both sets are empty.
    """
    cost = _distances(truth, estimate, c, p)
    larger = max(cost.shape)
    if not larger:
        return 0.0
    i, j = _assignment(cost)
    total = cost[i, j].sum() + c**p * (larger - min(cost.shape))
    return float((total / larger) ** (1 / p))


def _distances(truth: np.ndarray, estimate: np.ndarray, c: float, p: float) -> np.ndarray:
    """Distances to the power p, cut at c^p, (T, E)."""
    truth, estimate = np.asarray(truth, float), np.asarray(estimate, float)
    if truth.ndim != 2 or estimate.ndim != 2 or truth.shape[1] != estimate.shape[1]:
        raise InputError(f"truth {truth.shape} and estimates {estimate.shape} must be (n, d)")
    if not (c > 0 and p >= 1):
        raise InputError(f"c = {c} must be positive, p = {p} at least 1")
    return np.minimum(np.linalg.norm(truth[:, None] - estimate, axis=2), c) ** p


def _assignment(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(cost)
