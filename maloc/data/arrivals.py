"""Times of arrival of one tag's pings at every receiver: what the models see."""

from __future__ import annotations

from dataclasses import dataclass, field
from dataclasses import replace as _replace
from math import isfinite, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc._package import moved
from maloc.data import _arrays
from maloc.data._time import duration, iso
from maloc.data.receivers import Receivers
from maloc.data.report import ReadReport
from maloc.data.sound_profile import SoundProfile
from maloc.data.water_column import WaterColumn
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "DEFAULT_SOUND_SPEED",
    "DEFAULT_SOUND_SPEED_SD",
    "NO_SPEED",
    "ArrivalTimes",
    "Schedule",
    "SetAside",
]

DEFAULT_SOUND_SPEED, DEFAULT_SOUND_SPEED_SD = 1500.0, 30.0  # m/s: fresh and cold to salt and warm
NO_SPEED = (
    "no sound speed given: 1500 m/s assumed, give or take 30 (a 1 % error moves positions by "
    "metres)"
)


@dataclass(frozen=True)
class Schedule:
    """What is known of a tag's burst interval (s between emissions).

    Parameters
    ----------
    kind : {"unknown", "random", "stable", "poisson"}
        "random": uniform between `lo` and `hi`; "stable": mean `lo` and standard deviation `hi`;
        "poisson": cues at random times (calls, blows), mean interval `lo`.
    lo, hi : float
        Seconds; NaN when unknown.

    Raises
    ------
    InputError
        If the kind is none of these or the numbers cannot be an interval.
    """

    kind: str = "unknown"
    lo: float = nan
    hi: float = nan

    def __post_init__(self) -> None:
        if self.kind not in ("unknown", "random", "stable", "poisson"):
            raise InputError(f"schedule '{self.kind}' is not unknown, random, stable or poisson")
        if self.kind == "unknown":
            return
        lo, hi = float(self.lo), 0.0 if self.kind == "poisson" else float(self.hi)
        if not (isfinite(lo) and isfinite(hi) and lo > 0 and hi >= 0):
            raise InputError(f"burst interval {lo:g}, {hi:g} s is not a pair of positive numbers")
        if self.kind == "random" and hi < lo:
            raise InputError(f"burst interval's MAX {hi:g} s is below its MIN {lo:g} s")

    def __str__(self) -> str:
        stable = f"{self.lo:g} s with sd {self.hi:g} s"
        poisson = f"{self.lo:g} s on average, at random times"
        known = {"random": f"{self.lo:g} to {self.hi:g} s", "stable": stable, "poisson": poisson}
        return known.get(self.kind, self.kind)

    @property
    def shortest(self) -> float:
        """Shortest interval between emissions that is possible, s; NaN when unknown or any."""
        return self.lo if self.kind == "random" else self.lo - 6 * self.hi

    @property
    def mean(self) -> float:
        """Mean interval, s; NaN when unknown."""
        return (self.lo + self.hi) / 2 if self.kind == "random" else self.lo


@dataclass(frozen=True, repr=False, eq=False)
class SetAside:
    """Detections that are in no ping, and why.

    Parameters
    ----------
    receiver : array (S,) of str
        Receiver that heard it.
    time : array (S,) of float64
        Seconds from the data set's origin.
    detection : array (S,) of int64
        Row of the detections table.
    why : array (S,) of str
        The reason.
    """

    receiver: np.ndarray = field(default_factory=lambda: np.empty(0, "U1"))
    time: np.ndarray = field(default_factory=lambda: np.empty(0))
    detection: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    why: np.ndarray = field(default_factory=lambda: np.empty(0, "U1"))

    def __post_init__(self) -> None:
        receiver = _arrays.text(self.receiver, "receiver")
        n = len(receiver)
        object.__setattr__(self, "receiver", receiver)
        object.__setattr__(self, "time", _arrays.floats(self.time, "time", (n,), finite=True))
        object.__setattr__(self, "detection", _arrays.integers(self.detection, "detection", (n,)))
        object.__setattr__(self, "why", _arrays.text(self.why, "why", n))

    def __len__(self) -> int:
        return len(self.receiver)

    def __repr__(self) -> str:
        return f"SetAside: {len(self)} detections"


@dataclass(frozen=True, repr=False, eq=False)
class ArrivalTimes:
    """A matrix of arrival times, one row a ping and one column a deployment.

    Parameters
    ----------
    toa : array (P, R) of float64
        Seconds from `origin` on one common clock; NaN = not heard. Rows in time order; a row
        that nobody heard is a ping all the same.
    receivers : Receivers
        R deployments; element j describes column j.
    sound_speed : float or array (P,)
        m/s, at each ping.
    tag : str
        Full tag id.
    origin : int, optional
        ns since 1970 UTC of second 0; None: the input had no date.
    ping : array (P,) of int64, optional
        Ids as in the input; 1..P when it had none.
    schedule : Schedule
        What is known of the burst interval.
    depth : array (P,) of float64, optional
        Tag's depth, m, positive down; NaN = unknown.
    column : WaterColumn, optional
        The track is to have depth: how deep the water is, and how well the tag knows its depth.
        Without it tracks are flat, and depths are only carried along.
    detection : array (P, R) of int64, optional
        Row of the detections table that each entry came from, -1 = none.
    clock_sd : array (P, R) of float64, optional
        Standard error of the receivers' clocks then, s (`maloc.sync.ClockSync.clock_sd`); None =
        not known, clocks taken as exact.
    sound_speed_sd : float, optional
        Standard deviation of an error of the sound speed that all pings share, m/s; None = not
        known; models then take the speed as exact unless they are told to estimate it.
    set_aside : SetAside
        Detections that are in no ping.
    report : ReadReport
        What was read, and the notes made on the way.
    profile : SoundProfile, optional
        Sound speed by depth, which tracks with depth go by (`maloc.medium.with_sound_speed`).

    Raises
    ------
    InputError
        If shapes do not agree, a time is infinite, a sound speed is not positive, a clock's
        standard error is negative or no number, or the rows are not in time order.
    """

    toa: np.ndarray
    receivers: Receivers
    sound_speed: np.ndarray
    tag: str = ""
    origin: int | None = None
    ping: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    schedule: Schedule = field(default_factory=Schedule)
    depth: np.ndarray | None = None
    column: WaterColumn | None = None
    detection: np.ndarray | None = None
    clock_sd: np.ndarray | None = None
    sound_speed_sd: float | None = None
    set_aside: SetAside = field(default_factory=SetAside)
    report: ReadReport = field(default_factory=ReadReport)
    profile: SoundProfile | None = None

    def __post_init__(self) -> None:
        toa = np.asarray(self.toa, dtype=np.float64)
        if toa.ndim != 2 or toa.shape[1] != len(self.receivers):
            raise InputError(f"toa must be (P, {len(self.receivers)}), got shape {toa.shape}")
        n = len(toa)
        speed = np.broadcast_to(np.asarray(self.sound_speed, dtype=np.float64), (n,))
        ping = np.arange(1, n + 1) if self.ping is None else self.ping
        checked = {
            "toa": _arrays.floats(toa, "toa", toa.shape),
            "sound_speed": _arrays.floats(speed, "sound_speed", (n,), finite=True, positive=True),
            "ping": _arrays.integers(ping, "ping", (n,)),
            "origin": None if self.origin is None else int(self.origin),
        }
        if self.sound_speed_sd is not None:
            sd = float(self.sound_speed_sd)
            if not (sd > 0 and np.isfinite(sd)):
                raise InputError(f"sound speed's sd {sd:g} m/s is not positive")
            checked["sound_speed_sd"] = sd
        if self.depth is not None:
            checked["depth"] = _arrays.floats(self.depth, "depth", (n,))
        if self.detection is not None:
            checked["detection"] = _arrays.integers(self.detection, "detection", toa.shape)
        if self.clock_sd is not None:
            sds = _arrays.floats(self.clock_sd, "clock_sd", toa.shape, finite=True)
            if (sds < 0).any():
                raise InputError(f"clock_sd {sds.min():g} s is negative")
            checked["clock_sd"] = sds
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        first = self._first_heard()
        first = first[np.isfinite(first)]
        if (np.diff(first) < 0).any():
            i = int(np.flatnonzero(np.diff(first) < 0)[0])
            raise InputError(
                f"pings are not in time order: {first[i + 1]:.6g} s after {first[i]:.6g} s"
            )

    def __len__(self) -> int:
        return len(self.toa)

    @property
    def n_pings(self) -> int:
        """Number of pings P."""
        return self.toa.shape[0]

    @property
    def n_receivers(self) -> int:
        """Number of columns R (deployments)."""
        return self.toa.shape[1]

    @property
    def heard(self) -> np.ndarray:
        """Whether each receiver heard each ping, (P, R) bool."""
        return np.isfinite(self.toa)

    @property
    def n_heard(self) -> np.ndarray:
        """Number of receivers that heard each ping, (P,)."""
        return self.heard.sum(1)

    def _first_heard(self) -> np.ndarray:
        return np.where(self.heard, self.toa, np.inf).min(axis=1, initial=np.inf)

    @property
    def first(self) -> np.ndarray:
        """Earliest arrival of each ping, (P,) s.

        A ping that nobody heard gets a time by linear interpolation in the row number; before the
        first and after the last heard one, by the mean step. All NaN when nothing was heard.
        """
        first = self._first_heard()
        row, known = np.arange(len(first)), np.isfinite(first)
        if not known.any():
            return np.full(len(first), np.nan)
        k, t = row[known], first[known]
        step = (t[-1] - t[0]) / (k[-1] - k[0]) if len(k) > 1 else 0.0
        out = np.interp(row, k, t)
        out[row < k[0]] = t[0] - step * (k[0] - row[row < k[0]])
        out[row > k[-1]] = t[-1] + step * (row[row > k[-1]] - k[-1])
        return out

    def replace(self, **changes: Any) -> ArrivalTimes:
        """Return a copy with some fields changed, checked again."""
        return _replace(self, **changes)

    def to_model_data(self, pad: bool = True) -> Any:
        """Go with the next release: `maloc.model_data.to_model_data` does this."""
        name = "ArrivalTimes.to_model_data"
        return moved.call(name, "maloc.model_data", "to_model_data", self, pad)

    @classmethod
    def from_frame(
        cls,
        data: Any,
        receivers: Receivers,
        *,
        origin: int | None = None,
        ignore_columns: tuple[str, ...] = (),
        sound_speed: float | None = None,
        schedule: Schedule | None = None,
    ) -> ArrivalTimes:
        """Go with the next release: `maloc.read_toa` takes a wide dataframe too."""
        return moved.call(
            "ArrivalTimes.from_frame",
            "maloc.readers",
            "read_toa",
            data,
            receivers,
            origin=origin,
            ignore_columns=ignore_columns,
            sound_speed=sound_speed,
            schedule=schedule,
        )

    def to_frame(self) -> pl.DataFrame:
        """Return the wide table as a polars DataFrame, columns named by `receivers.labels`."""
        import polars as pl

        head: dict[str, Any] = {"ping": self.ping}
        if self.tag:
            head["tag"] = [self.tag] * len(self)
        head["sound_speed"] = self.sound_speed
        if self.depth is not None:
            head["depth"] = pl.Series(self.depth).fill_nan(None)
        columns = {
            label: pl.Series(self.toa[:, j]).fill_nan(None)
            for j, label in enumerate(self.receivers.labels)
        }
        return pl.DataFrame(head | columns)

    def __repr__(self) -> str:
        name = f" of {self.tag}" if self.tag else ""
        heard = self.n_heard
        span = self._first_heard()[heard > 0]
        when = "" if self.origin is None else f" from {iso(self.origin)} UTC"
        length = duration(float(np.ptp(span))) if len(span) else "nothing heard"
        mean = heard.mean() if len(heard) else 0.0
        aside = f", {len(self.set_aside)} detections set aside" if len(self.set_aside) else ""
        return (
            f"ArrivalTimes{name}: {self.n_pings} pings ({int((heard == 0).sum())} unheard) x "
            f"{self.n_receivers} receivers, {mean:.1f} heard a ping, {length}{when}{aside}"
            f"{self.report.flag}"
        )
