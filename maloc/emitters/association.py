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
    from maloc.emitters.tracking import Tracks

__all__ = ["Association", "Sensing", "associate", "fuse", "pack"]


@dataclass(frozen=True, eq=False)
class Sensing:
    """Receivers, and what is known of what they hear.

    Parameters
    ----------
    receivers : array (R, 2)
        Metres.
    speed : float
        Of propagation, m/s.
    sigma : float
        Standard deviation of a measurement, s.
    p_detect : float
        Probability that a receiver (a pair) measures an emission.
    n_false : float
        False measurements to be expected of a receiver (a pair) in one scan.
    reference : int or None
        None: arrival times. A number: differences of arrival times from this receiver's.
    low, high : pair of float
        Corners of the box in which emitters may be, m; without them the receivers' box widened by
        its own larger side.
    expected : float
        Emissions to be expected in a scan.
    gate : float
        Standard deviations that a measurement may be off what the others of its set predict.
    most : int
        Hypotheses of one size kept, the likeliest; what is beyond is counted.

    Raises
    ------
    InputError
        If there are too few receivers, or a number makes no sense.
    """

    receivers: np.ndarray
    speed: float
    sigma: float
    p_detect: float = 0.95
    n_false: float = 1.0
    reference: int | None = None
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    expected: float = 1.0
    gate: float = 4.0
    most: int = 20_000

    def __post_init__(self) -> None:
        xy = np.array(self.receivers, float)
        if xy.ndim != 2 or xy.shape[1:] != (2,) or not np.isfinite(xy).all():
            raise InputError(f"receivers must be (R, 2) numbers, got shape {xy.shape}")
        if len(xy) < 3:
            raise InputError(f"{len(xy)} receivers: positions need at least 3")
        if self.reference is not None and not 0 <= self.reference < len(xy):
            raise InputError(f"reference {self.reference} is none of {len(xy)} receivers")
        for name in ("speed", "sigma", "expected", "gate", "most"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} {getattr(self, name)} is not positive")
        if not 0 < self.p_detect <= 1 or self.n_false < 0:
            raise InputError("p_detect must be a chance above 0, n_false not negative")
        wide = float(np.ptp(xy, axis=0).max())
        low = xy.min(axis=0) - wide if self.low is None else np.array(self.low, float)
        high = xy.max(axis=0) + wide if self.high is None else np.array(self.high, float)
        if not (high > low).all():
            raise InputError("the box of emitters has no area")
        xy.setflags(write=False)
        for name, value in (("receivers", xy), ("low", tuple(low)), ("high", tuple(high))):
            object.__setattr__(self, name, value)

    @property
    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """First and last measurement possible at each receiver (R,), s.

        Of arrival times from the earliest emission on, all emissions of a scan being at about one
        time; of differences plus or minus the time between the two receivers.
        """
        if self.reference is not None:
            apart = np.linalg.norm(self.receivers - self.receivers[self.reference], axis=1)
            return -apart / self.speed, apart / self.speed
        corner = np.maximum(self.high - self.receivers, self.receivers - self.low)
        return np.zeros(len(corner)), np.linalg.norm(corner, axis=1) / self.speed

    @property
    def false_density(self) -> np.ndarray:
        """False measurements a metre of range at each receiver (R,).

        At least a thousandth of one over the window, so that a set-up without any still works.
        """
        first, last = self.window
        length = np.maximum((last - first) * self.speed, 1e-9)
        return max(self.n_false, 1e-3) / length

    @property
    def area(self) -> float:
        """Of the box in which emitters may be, m^2."""
        return float(np.prod(np.asarray(self.high) - np.asarray(self.low)))

    @property
    def emission_density(self) -> float:
        """Emissions to be expected a m^2, and a metre of emission's range where that is unknown."""
        volume = self.area
        if self.reference is None:
            volume *= float((self.window[1]).max()) * self.speed
        return self.expected / volume


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
