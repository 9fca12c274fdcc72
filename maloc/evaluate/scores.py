"""Scores of one fit in the canal study: each ping's error, and what a whole track is judged by."""

from __future__ import annotations

import numpy as np

__all__ = ["centre_of", "deciles", "ping_scores", "track_scores"]


def centre_of(receivers: np.ndarray) -> np.ndarray:
    """Receiver (2,) nearest to the middle of the array (R, 2): S8 in the thesis's."""
    away = np.linalg.norm(receivers - receivers.mean(axis=0), axis=1)
    return receivers[int(away.argmin())]


def ping_scores(
    truth: np.ndarray,
    position: np.ndarray,
    sd: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    centre: np.ndarray,
) -> dict[str, np.ndarray]:
    """Scores of every ping, each (P,); NaN where there is no position.

    Parameters
    ----------
    truth, position, sd, low, high : array (P, 2)
        m; ``low`` to ``high`` is the central 95 %.
    centre : array (2,)
        m; ranges and bearings are from here.

    Returns
    -------
    dict
        ``error`` m; ``expected``: root of the summed variances, m; ``covered``: share of the two
        coordinates inside their limits; ``away``: true distance from the centre, m; ``range``:
        error of that distance, m; ``bearing``: angle at the centre between truth and position,
        degrees.

    References
    ----------
    Range and bearing: Ren et al. (2012), as the thesis uses them.
    """
    to, seen = truth - centre, position - centre
    away, reached = np.linalg.norm(to, axis=1), np.linalg.norm(seen, axis=1)
    cross = to[:, 0] * seen[:, 1] - to[:, 1] * seen[:, 0]
    turned = np.degrees(np.abs(np.arctan2(cross, (to * seen).sum(axis=1))))
    located = np.isfinite(position).all(axis=1)
    inside = ((low <= truth) & (truth <= high)).mean(axis=1)
    return {
        "error": np.linalg.norm(position - truth, axis=1),
        "expected": np.hypot(sd[:, 0], sd[:, 1]),
        "covered": np.where(located, inside, np.nan),
        "away": away,
        "range": np.abs(reached - away),
        "bearing": turned,
    }


def track_scores(
    truth: np.ndarray, position: np.ndarray, error: np.ndarray, expected: np.ndarray
) -> dict[str, float]:
    """Scores of a whole track of located pings.

    Parameters
    ----------
    truth, position : array (L, 2)
        m, in order.
    error, expected : array (L,)
        True and predicted error, m.

    Returns
    -------
    dict
        ``length``: length of the estimated track over that of the true one through the same pings;
        ``r2``: of the linear regression of true on predicted error; ``rho``: their Spearman rank
        correlation. NaN where there are too few pings.
    """
    from scipy.stats import pearsonr, spearmanr

    nan = float("nan")
    if len(truth) < 3:
        return {"length": nan, "r2": nan, "rho": nan}
    walked = [np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in (position, truth)]
    known = np.isfinite(expected)
    r2 = rho = nan
    if known.sum() > 2 and np.ptp(expected[known]) > 0:
        r2 = float(pearsonr(expected[known], error[known]).statistic) ** 2  # pyright: ignore
        rho = float(spearmanr(expected[known], error[known]).statistic)  # pyright: ignore
    return {"length": float(walked[0] / walked[1]) if walked[1] > 0 else nan, "r2": r2, "rho": rho}


def deciles(expected: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Root mean square error over predicted, in ten equal parts by predicted error, (10,)."""
    order = np.argsort(expected, kind="stable")
    parts = np.array_split(order, 10)
    return np.array([np.sqrt(np.mean(error[p] ** 2) / np.mean(expected[p] ** 2)) for p in parts])
