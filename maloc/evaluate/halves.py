"""Two halves of the receivers, each tracked by itself: the honest check where no truth exists.

Both tracks are of one animal, so that at every ping their difference is drawn, if the stated
standard deviations are right, from a normal law whose variance is the sum of the two. Errors that
stay the same (a receiver's place, its clock, a reflection for good) do not average away as a fit
may believe, and show here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data import ArrivalTimes, Receivers
from maloc.data._limits import Z95
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "Halves",
    "compare_halves",
    "every_other",
    "half_of",
    "halves",
    "named_half",
    "random_half",
]

_FEWEST = 3  # receivers that tell a position


@dataclass(frozen=True)
class Halves:
    """Two tracks of one tag, by halves of the receivers.

    Attributes
    ----------
    receivers : pair of tuple of str
        The two halves.
    rows : polars.DataFrame
        One row a ping that enough receivers of both halves heard: ``ping`` (id in the input),
        ``n_a``, ``n_b`` (receivers that heard it), ``x_a``, ``y_a``, ``x_b``, ``y_b``, their
        ``sd_x_a`` and so on, the differences ``dx``, ``dy`` (m) and the same over their stated
        standard deviations, ``z_x``, ``z_y``.
    scores : dict of str to float
        ``n`` rows; ``chi2_x``, ``chi2_y``: mean of squared difference over summed variances, 1 if
        the standard deviations are right; ``within_x``, ``within_y``: share within 1.96 standard
        deviations; ``median`` and ``worst`` distance, and ``sd``, its expected root mean square, m.
    """

    receivers: tuple[tuple[str, ...], tuple[str, ...]]
    rows: pl.DataFrame
    scores: dict[str, float]

    def __str__(self) -> str:
        return "\n".join(f"{name:10}{value:10.3f}" for name, value in self.scores.items())


def every_other(receivers: Receivers) -> np.ndarray:
    """Say which deployments (D,) are of the first, third, ... receiver of the table."""
    return named_half(receivers, receivers.names[::2])


def random_half(rng: np.random.Generator, receivers: Receivers) -> np.ndarray:
    """Say which deployments (D,) are of half of the receivers, drawn at random."""
    names = np.array(receivers.names)
    return named_half(receivers, rng.permutation(names)[: (len(names) + 1) // 2].tolist())


def named_half(receivers: Receivers, names: Sequence[str]) -> np.ndarray:
    """Say which deployments (D,) are of these receivers.

    Raises
    ------
    InputError
        If one of them is not in the table.
    """
    known = receivers.canonical(np.asarray(list(names), dtype=str))
    for name in known:
        if name not in receivers.names:
            raise InputError(f"receiver {name} is not in the table, so it is in no half")
    return np.isin(receivers.receiver, known)


def half_of(toa: ArrivalTimes, columns: np.ndarray) -> ArrivalTimes:
    """Return what some deployments (R,) bool heard of the same pings: rows stay, columns go."""
    columns = np.asarray(columns, bool)

    def cut(table: np.ndarray | None) -> np.ndarray | None:
        return None if table is None else table[:, columns]

    return toa.replace(
        toa=toa.toa[:, columns],
        receivers=toa.receivers.subset(columns),
        detection=cut(toa.detection),
        clock_sd=cut(toa.clock_sd),
    )


def halves(
    toa: ArrivalTimes,
    fit: Callable[[ArrivalTimes], Any],
    first: np.ndarray | None = None,
    *,
    least: int = 4,
) -> Halves:
    """Track a tag by each half of the receivers, and compare the two at the same pings.

    Parameters
    ----------
    toa : ArrivalTimes
        Of all receivers, on one clock.
    fit : callable
        Arrival times to a `maloc.infer.Fit` (what has ``positions()``, a row a heard ping); called
        with each half.
    first : (R,) array of bool, optional
        The deployments of the first half; every other receiver of the table where not given.
    least : int
        Pings heard by as many receivers in both halves are compared.

    Returns
    -------
    Halves

    Raises
    ------
    InputError
        If a half has too few receivers, or too few pings are heard by `least` in both.
    """
    first = every_other(toa.receivers) if first is None else np.asarray(first, bool)
    check_halves(toa, first, least)
    found = []
    for columns in (first, ~first):
        part = half_of(toa, columns)
        mean, covariance = fit(part).positions()[:2]
        known = part.n_heard > 0
        place = np.full((len(toa), 2), np.nan)
        sd = np.full((len(toa), 2), np.nan)
        place[known], sd[known] = mean, np.sqrt(np.einsum("tii->ti", covariance))
        found.append((place, sd, part.n_heard))
    (a, sd_a, n_a), (b, sd_b, n_b) = found
    both = (n_a >= least) & (n_b >= least)
    track_a, track_b = (a[both], sd_a[both]), (b[both], sd_b[both])
    rows, scores = compare_halves(toa.ping[both], track_a, track_b, (n_a[both], n_b[both]))
    names = [toa.receivers.subset(np.flatnonzero(c)).names for c in (first, ~first)]
    return Halves((names[0], names[1]), rows, scores)


def check_halves(toa: ArrivalTimes, first: np.ndarray, least: int) -> None:
    """Raise InputError where two halves cannot be compared."""
    if least < _FEWEST:
        raise InputError(f"{least} receivers tell no position: pings need at least {_FEWEST}")
    heard = [toa.heard[:, c] for c in (first, np.asarray(~first))]
    names = [toa.receivers.subset(c) for c in (first, np.asarray(~first))]
    for table, half in zip(heard, names, strict=True):
        n = len(half.subset(np.flatnonzero(table.any(axis=0))).names)
        if n < least:
            tag = f"tag {toa.tag}: " if toa.tag else ""
            raise InputError(
                f"{tag}{n} receivers of one half ({', '.join(half.names) or 'none'}) heard it: "
                f"pings heard by {least} in both halves need {least} in each",
                mend="another split, or a smaller least number" if least > _FEWEST else "",
            )
    enough = (heard[0].sum(axis=1) >= least) & (heard[1].sum(axis=1) >= least)
    if not enough.any():
        tag = f" of tag {toa.tag}" if toa.tag else ""
        raise InputError(
            f"no ping{tag} was heard by {least} receivers of both halves",
            mend="another split, or a smaller least number" if least > _FEWEST else "",
        )


def compare_halves(
    ping: np.ndarray,
    one: tuple[np.ndarray, np.ndarray],
    other: tuple[np.ndarray, np.ndarray],
    heard: tuple[np.ndarray, np.ndarray],
) -> tuple[pl.DataFrame, dict[str, float]]:
    """Compare two tracks, row by row: a `Halves`' rows and scores.

    Parameters
    ----------
    ping : (n,) array of int
    one, other : pair of (n, 2) array
        Position and standard deviations by axis, m.
    heard : pair of (n,) array of int
        Receivers that heard each ping.
    """
    import polars as pl

    off = one[0] - other[0]
    sd = np.hypot(one[1], other[1])
    z = off / sd
    columns: dict[str, np.ndarray] = {"ping": ping, "n_a": heard[0], "n_b": heard[1]}
    for half, (place, own) in (("a", one), ("b", other)):
        columns |= {f"x_{half}": place[:, 0], f"y_{half}": place[:, 1]}
        columns |= {f"sd_x_{half}": own[:, 0], f"sd_y_{half}": own[:, 1]}
    columns |= {"dx": off[:, 0], "dy": off[:, 1], "z_x": z[:, 0], "z_y": z[:, 1]}
    far = np.hypot(off[:, 0], off[:, 1])
    chi2, within = (z**2).mean(axis=0), (np.abs(z) <= Z95).mean(axis=0)
    scores = {
        "n": len(ping),
        "chi2_x": float(chi2[0]),
        "chi2_y": float(chi2[1]),
        "within_x": float(within[0]),
        "within_y": float(within[1]),
        "median": float(np.median(far)),
        "worst": float(far.max()),
        "sd": float(np.sqrt((sd**2).sum(axis=1).mean())),
    }
    return pl.DataFrame(columns), scores
