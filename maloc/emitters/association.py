"""Which arrivals, one or none a receiver, are one emission: static association across receivers.

A hypothesis is a set of arrivals at three or more receivers. It has a position and an emission
time (closed form of three, least squares of more), must pass a gate, and is weighed against the
arrivals being false by the ratio of the likelihoods, with the place and time unknown:

    log L = log(density of emissions) + sum_heard log(P_D / false density) + sum_missed log(1 - P_D)
            + log integral of prod N(arrival; predicted, sigma) over place and emission time,

the integral by Laplace's formula. The best set of hypotheses that share no arrival (an S-D
assignment) is found exactly, as a set packing. Time differences from one receiver are arrivals
whose first, at the reference, is exact and in every hypothesis.

References
----------
Pattipati, Deb, Bar-Shalom & Washburn (1992) A new relaxation algorithm and passive sensor data
association. IEEE Trans. Automat. Contr. 37: 198-213.
Sathyan, Sinha & Kirubarajan (2006) Passive geolocation and tracking of an unknown number of
emitters. IEEE Trans. Aerosp. Electron. Syst. 42: 740-750.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.emitters._hypotheses import Hypotheses, enumerate_hypotheses
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.emitters.sensing import Sensing
    from maloc.emitters.tracking import Tracks

__all__ = ["Association", "associate", "fuse", "pack"]


@dataclass(frozen=True, eq=False)
class Association:
    """The emissions found in one scan.

    Attributes
    ----------
    member : array (E, R) of int
        Row of the measurement at each receiver, -1 = not heard.
    position : array (E, 2)
        Metres.
    covariance : array (E, 2, 2)
        m^2.
    emission : array (E,)
        s, as the measurements' scale; NaN where these are differences.
    log_ratio : array (E,)
        Log likelihood ratio of each against its measurements being false.
    n_hypotheses, n_cut : int
        Hypotheses weighed, and how many more were beyond `Sensing.most`.
    """

    member: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    emission: np.ndarray
    log_ratio: np.ndarray
    n_hypotheses: int = 0
    n_cut: int = 0

    def __len__(self) -> int:
        return len(self.position)


def associate(
    value: Any, column: Any, sensing: Sensing, tracks: Tracks | None = None
) -> Association:
    """Find the likeliest set of emissions behind the measurements of one scan.

    An emission comes from anywhere in the box, or from a track, each of which yields one at most:
    its density is then that of the track's predicted place.

    Parameters
    ----------
    value : array (N,)
        Arrival times, or time differences from the reference, s.
    column : array (N,) of int
        Receiver of each.
    sensing : Sensing
        The receivers.
    tracks : Tracks, optional
        Confirmed tracks predicted to this scan (`maloc.emitters.Tracker.predict`); without them
        the association is static, each scan by itself.

    Returns
    -------
    Association

    Raises
    ------
    InputError
        If lengths differ, a value is no number, or a column is no receiver's (or the reference's).
    """
    value, column = _checked(value, column, sensing)
    found, cut = enumerate_hypotheses(value, column, sensing)
    row, ratio = np.arange(len(found.log_ratio)), found.log_ratio
    source = np.full(len(row), -1)  # a track, -1 = a new emitter
    if tracks is not None:
        near, of, gain = _from_tracks(found, sensing, tracks)
        row, source = np.append(row, near), np.append(source, len(value) + of)
        ratio = np.append(ratio, found.log_ratio[near] + gain)
    good = ratio > 0
    row, ratio = row[good], ratio[good]
    member = np.concatenate([found.member[row], source[good, None]], axis=1)
    chosen = pack(member, ratio, len(value) + (0 if tracks is None else len(tracks.number)))
    mine = found.rows(row[chosen])._replace(log_ratio=ratio[chosen])
    return _association(mine, sensing, len(found.log_ratio), cut)


def _from_tracks(found: Hypotheses, sensing: Sensing, tracks: Tracks) -> tuple:
    """Hypotheses in the gate of tracks: which, of which track, and what that adds to the ratio."""
    offset = found.position[:, None] - tracks.position
    spread = found.covariance[:, None, :2, :2] + tracks.covariance[:, :2, :2]
    det = np.linalg.det(spread)
    square = (offset[..., None, :] @ np.linalg.inv(spread) @ offset[..., None])[..., 0, 0]
    density = -0.5 * square - np.log(2 * np.pi * np.sqrt(det))
    gain = density + np.log(sensing.area / sensing.expected)
    which, of = np.nonzero((square <= sensing.gate**2) & (gain > 0))
    return which, of, gain[which, of]


def fuse(value: Any, column: Any, identity: Any, sensing: Sensing) -> Association:
    """Locate emitters whose identity the receivers know: the easy case.

    Parameters
    ----------
    value, column, sensing
        As of `associate`.
    identity : array (N,) of int
        Who was heard; below 0 = set aside.

    Returns
    -------
    Association
        One emission an identity that three receivers heard, in order of identity. Of two places
        that fit equally well (three receivers are not always enough) the one nearer the middle
        of the receivers.
    """
    value, column = _checked(value, column, sensing)
    identity = np.asarray(identity)
    middle = sensing.receivers.mean(axis=0)
    parts = []
    for who in np.unique(identity[identity >= 0]):
        rows = np.flatnonzero(identity == who)
        found, _ = enumerate_hypotheses(value[rows], column[rows], sensing)
        if not len(found.log_ratio):
            continue
        size = (found.member >= 0).sum(axis=1)
        away = np.linalg.norm(found.position - middle, axis=1)
        best = np.lexsort((away, -np.round(found.log_ratio, 6), -size))[:1]
        mine = found.rows(best)
        member = np.where(mine.member >= 0, rows[mine.member], -1)
        parts.append(mine._replace(member=member))
    if not parts:
        return _association(Hypotheses.none(len(sensing.receivers)), sensing, 0, 0)
    joined = Hypotheses(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    return _association(joined, sensing, len(parts), 0)


def pack(member: np.ndarray, worth: np.ndarray, n: int) -> np.ndarray:
    """Choose the hypotheses of greatest total worth of which no two share a measurement.

    Parameters
    ----------
    member : array (H, R) of int
        Measurements of each hypothesis, -1 = none.
    worth : array (H,)
        Positive.
    n : int
        Number of measurements (of whatever else cannot be shared, too).

    Returns
    -------
    array of int
        Rows chosen, ascending: exactly the best set, by mixed-integer programming.
    """
    if len(worth) < 2:
        return np.arange(len(worth))
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array

    which, _ = np.nonzero(member >= 0)
    rows = member[member >= 0]
    shares = csr_array((np.ones(len(rows)), (rows, which)), shape=(n, len(worth)))
    solved = milp(
        -worth,
        constraints=LinearConstraint(shares, -np.inf, 1.0),
        bounds=Bounds(0, 1),
        integrality=np.ones(len(worth)),
    )
    return np.flatnonzero(solved.x > 0.5)


def _checked(value: Any, column: Any, sensing: Sensing) -> tuple[np.ndarray, np.ndarray]:
    value, column = np.asarray(value, float), np.asarray(column, int)
    if value.ndim != 1 or value.shape != column.shape:
        raise InputError(f"values {value.shape} and columns {column.shape} must be (N,) both")
    if not np.isfinite(value).all():
        raise InputError(f"{int((~np.isfinite(value)).sum())} measurements are no numbers")
    if len(column) and not (0 <= column.min() and column.max() < len(sensing.receivers)):
        raise InputError(f"columns must be 0 to {len(sensing.receivers) - 1}")
    if sensing.reference is not None and (column == sensing.reference).any():
        raise InputError("a difference cannot be between the reference receiver and itself")
    return value, column


def _association(found: Hypotheses, sensing: Sensing, n: int, cut: int) -> Association:
    emission = found.emission / sensing.speed
    if sensing.reference is not None:
        emission = np.full(len(emission), np.nan)
    return Association(
        found.member, found.position, found.covariance[:, :2, :2], emission, found.log_ratio, n, cut
    )
