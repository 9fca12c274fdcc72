"""Fixed tags: what they tell of receivers' clusters, of the time of day and of error measures.

A fixed tag (a sync or reference tag) stands at a known place, so that the error of each of its
positions is known: a VPS calls it HPEm.

References
----------
Vergeynst (2017), as the thesis on cleaning fish tracks in the Albert Canal has it (sections 3.3
and 3.8): accuracy by cluster of receivers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.classical.outliers import Screened
from maloc.data import _arrays
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.points.result import Points

__all__ = ["FixedTags", "cluster_error", "cluster_filter", "clusters", "timing_error"]


def clusters(points: Points) -> np.ndarray:
    """Name the receivers behind each position: their columns, as in "0 3 4".

    Parameters
    ----------
    points : Points
        P pings of R columns, in the same order wherever clusters are compared.

    Returns
    -------
    (P,) array of str
        "" where there is no position, "-" where a position has no inliers. A VPS's file has the
        like in its column URX.
    """
    names = [" ".join(map(str, np.flatnonzero(row))) or "-" for row in points.inlier]
    return np.where(points.located, np.array(names, dtype=str), "")


@dataclass(frozen=True)
class FixedTags:
    """Positions of tags whose place is known, all tags together.

    Parameters
    ----------
    time : array (F,)
        s.
    error : array (F,)
        Distance from the true place, m: HPEm.
    cluster : array (F,) of str
        Receivers behind each position, named as the animals' are.

    Raises
    ------
    InputError
        If shapes differ, a value is missing, or an error is negative.
    """

    time: np.ndarray
    error: np.ndarray
    cluster: np.ndarray

    def __post_init__(self) -> None:
        cluster = _arrays.text(self.cluster, "cluster")
        shape = (len(cluster),)
        error = _arrays.floats(self.error, "error", shape, finite=True)
        if (error < 0).any():
            raise InputError("an error of a fixed tag is negative")
        object.__setattr__(self, "time", _arrays.floats(self.time, "time", shape, finite=True))
        object.__setattr__(self, "error", error)
        object.__setattr__(self, "cluster", cluster)

    @classmethod
    def of(cls, points: Sequence[Points], place: Any) -> FixedTags:
        """Compare positions with where the tags stand.

        Parameters
        ----------
        points : sequence of Points
            One a tag; pings without a position are left out.
        place : array (len(points), 2)
            Where each stands, m.
        """
        place = np.asarray(place, float)
        if place.shape != (len(points), 2):
            raise InputError(f"place must be ({len(points)}, 2), got shape {place.shape}")
        rows = [p.located & np.isfinite(p.emission) for p in points]
        both = list(zip(points, place, rows, strict=True))
        return cls(
            np.concatenate([p.emission[r] for p, _, r in both]),
            np.concatenate([np.hypot(*(p.position[r, :2] - at).T) for p, at, r in both]),
            np.concatenate([clusters(p)[r] for p, _, r in both]),
        )


def cluster_filter(
    cluster: Any, fixed: FixedTags, *, goal: float = 2.5, share: float = 0.95, more_than: int = 10
) -> Screened:
    """Take out positions by receivers that place fixed tags badly together.

    Parameters
    ----------
    cluster : (P,) array of str
        Receivers behind each position (`clusters`); "" where there is none.
    fixed : FixedTags
    goal : float
        A correct position is within it, m.
    share : float
        A good cluster places at least this share of the fixed tags' pings correctly.
    more_than : int
        Clusters with no more positions of fixed tags than this are not judged: theirs are kept.

    Returns
    -------
    Screened
        Reason "bad cluster".

    Raises
    ------
    InputError
        If `share` is not within 0 to 1, or `goal` not positive.
    """
    if not (0 <= share <= 1 and goal > 0):
        raise InputError(f"share {share:g} of positions within {goal:g} m cannot be asked")
    names, which, count = np.unique(fixed.cluster, return_inverse=True, return_counts=True)
    right = np.bincount(which, fixed.error <= goal, len(names))
    bad = names[(count > more_than) & (right < share * count)]
    cluster = _arrays.text(cluster, "cluster")
    why = np.where(np.isin(cluster, bad), "bad cluster", "")
    why = np.where(cluster == "", "no position", why)
    return Screened(why == "", why)


def cluster_error(cluster: Any, fixed: FixedTags) -> np.ndarray:
    """Mean error (P,) m of the fixed tags placed by the same receivers; NaN where none was.

    Parameters
    ----------
    cluster : (P,) array of str
        Receivers behind each position (`clusters`).
    fixed : FixedTags
    """
    names, which, count = np.unique(fixed.cluster, return_inverse=True, return_counts=True)
    mean = np.bincount(which, fixed.error, len(names)) / count
    known = dict(zip(names.tolist(), mean.tolist(), strict=True))
    return np.array([known.get(c, np.nan) for c in _arrays.text(cluster, "cluster").tolist()])


def timing_error(time: Any, fixed: FixedTags, *, within: float = 300.0) -> np.ndarray:
    """Median error (P,) m of the fixed tags around each time; NaN where there was none.

    Parameters
    ----------
    time : (P,) array
        s, on the fixed tags' clock; NaN: no position.
    fixed : FixedTags
    within : float
        Seconds before and after.
    """
    order = np.argsort(fixed.time, kind="stable")
    clock, error = fixed.time[order], fixed.error[order]
    time = np.asarray(time, float)
    first = np.searchsorted(clock, time - within, side="left")
    last = np.searchsorted(clock, time + within, side="right")
    parts = zip(first.tolist(), last.tolist(), strict=True)
    return np.array([np.median(error[a:b]) if a < b else np.nan for a, b in parts])
