"""Encounter histories: which receivers heard each ping, and which listened and did not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as _replace
from typing import Any

import numpy as np

from maloc._package import moved
from maloc.data import _arrays
from maloc.data._encounter_arrivals import history_of
from maloc.data._time import OPEN_END, OPEN_START, duration, iso
from maloc.data.arrivals import ArrivalTimes, Schedule, SetAside
from maloc.data.receivers import Receivers
from maloc.data.report import ReadReport
from maloc.errors import InputError

__all__ = ["Covariate", "EncounterHistory"]

Covariate = np.ndarray | Callable[[np.ndarray], np.ndarray]

_BUFFER = 4.0  # receiver spacings around the array where animals may be
_EDGE = 0.25  # of a spacing: width of the state space's smooth edge
_LONE = 500.0  # m; "spacing" of a single receiver: about its range
GAP_KINDS = ("random", "poisson", "stable")  # schedules whose missed pings can be summed out


@dataclass(frozen=True, repr=False, eq=False)
class EncounterHistory:
    """Pings of N tags at R deployments, heard or not: what the detection models see.

    Parameters
    ----------
    time : array (P,) of float64
        Seconds from `origin`, ascending within a tag.
    tag : array (P,) of int
        Index into `tags`; rows of one tag are together, tag 0 first.
    heard : array (P, R) of bool
        Who heard it. A row that nobody heard is a ping all the same.
    receivers : Receivers
        R deployments; element j describes column j.
    tags : tuple of str
        N full tag ids; each has at least one row.
    schedule : Schedule
        What is known of the burst interval (of all tags).
    known : bool
        Every ping that a tag sent from its first to its last row is a row.
    start, end : array (N,) of float64, optional
        When each tag was on and under study, seconds from `origin`; NaN: not known. Silence before
        the first and after the last heard ping counts only where it is known that the tag was on.
    first_at_start : bool
        The first ping falls between `start` and half the longest interval later (a tag switched on
        then); else `start` lies anywhere in an interval.
    low, high : array (2,), optional
        Corners of the state space, m; the array's box and four receiver spacings around it.
    edge : float, optional
        Width of the state space's smooth edge, m; a quarter of the receiver spacing.
    covariates : mapping of str to array (R,), (P,), (P, R) or callable, optional
        Covariates of detection, by receiver, by time, or both. A callable takes times (T,) in
        seconds from `origin` and returns (T,) or (T, R): it is asked at the nodes inside gaps too,
        where arrays are interpolated in time. See `maloc.data.covariates`.
    lead : float
        How much of the silence before the first and after the last heard ping counts, in mean
        burst intervals. Longer leads say little more, and cost states.
    slack : float
        How far the time from one ping to the next may be off (clocks, travel times, rounding), s:
        the limits of a random schedule are widened by it.
    origin : int, optional
        ns since 1970 UTC of second 0; None: the input had no date.
    detection : array (P, R) of int64, optional
        Row of the detections table that each entry came from, -1 = none.
    reach : float, optional
        Receivers further than this from `near` are left out (see `prune`), m.
    near : array (P, 2), optional
        Rough position at each ping, m.
    set_aside : SetAside
        Detections that are in no ping.
    report : ReadReport
        What was read, and the notes made on the way.

    Raises
    ------
    InputError
        If shapes do not agree, rows are not in order, a tag has no row, or a ping lies outside its
        tag's time span.
    """

    time: np.ndarray
    tag: np.ndarray
    heard: np.ndarray
    receivers: Receivers
    tags: tuple[str, ...] = ("",)
    schedule: Schedule = field(default_factory=Schedule)
    known: bool = False
    start: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    end: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    first_at_start: bool = False
    low: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    high: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    edge: float = None  # pyright: ignore[reportAssignmentType]
    covariates: Mapping[str, Covariate] = field(default_factory=dict)
    lead: float = 8.0
    slack: float = 0.0
    origin: int | None = None
    detection: np.ndarray | None = None
    reach: float | None = None
    near: np.ndarray | None = None
    set_aside: SetAside = field(default_factory=SetAside)
    report: ReadReport = field(default_factory=ReadReport)

    def __post_init__(self) -> None:
        heard = np.array(self.heard, dtype=bool)
        if heard.ndim != 2 or heard.shape[1] != len(self.receivers):
            raise InputError(f"heard must be (P, {len(self.receivers)}), got shape {heard.shape}")
        if not heard.size:
            raise InputError("an encounter history needs a ping and a receiver")
        heard.setflags(write=False)
        p, n = len(heard), len(self.tags)
        box = _box(self.receivers, self.spacing)
        open_ = np.full(n, np.nan)

        def given(value: Any, default: Any) -> Any:
            return default if value is None else value

        checked: dict[str, Any] = {
            "heard": heard,
            "tags": tuple(map(str, self.tags)),
            "time": _arrays.floats(self.time, "time", (p,), finite=True),
            "tag": _arrays.integers(self.tag, "tag", (p,)),
            "start": _arrays.floats(given(self.start, open_), "start", (n,)),
            "end": _arrays.floats(given(self.end, open_), "end", (n,)),
            "low": _arrays.floats(given(self.low, box[0]), "low", (2,), finite=True),
            "high": _arrays.floats(given(self.high, box[1]), "high", (2,), finite=True),
            "edge": float(given(self.edge, _EDGE * self.spacing)),
            "origin": None if self.origin is None else int(self.origin),
            "covariates": dict(self.covariates),
        }
        if self.detection is not None:
            checked["detection"] = _arrays.integers(self.detection, "detection", heard.shape)
        if self.near is not None:
            checked["near"] = _arrays.floats(self.near, "near", (p, 2), finite=True)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_order()
        self._check_numbers()

    def _check_order(self) -> None:
        steps = np.diff(self.tag)
        if (
            len(np.unique(self.tag)) != len(self.tags)
            or self.tag.min()
            or self.tag.max() >= len(self.tags)
        ):
            raise InputError(f"tag must number {len(self.tags)} tags from 0, each with a ping")
        if (steps < 0).any():
            raise InputError("rows are not grouped by tag, tag 0 first")
        back = (np.diff(self.time) < 0) & (steps == 0)
        if back.any():
            i = int(np.flatnonzero(back)[0])
            raise InputError(
                f"pings of tag {self.tags[self.tag[i]]} are not in time order: "
                f"{self.time[i + 1]:.6g} s after {self.time[i]:.6g} s"
            )
        first, last = self.time[self.first_rows], self.time[self.last_rows]
        for i in np.flatnonzero((first < self.start) | (last > self.end)):
            raise InputError(f"tag {self.tags[i]}: a ping lies outside the tag's start and end")

    def _check_numbers(self) -> None:
        if not (self.high > self.low).all():
            raise InputError(f"the state space's high {self.high} is not above its low {self.low}")
        if not (np.isfinite(self.edge) and self.edge > 0):
            raise InputError(f"the edge {self.edge:g} m is not a positive width")
        if not (np.isfinite(self.lead) and self.lead >= 0):
            raise InputError(f"a lead of {self.lead:g} intervals is not a number from 0")
        if not (np.isfinite(self.slack) and self.slack >= 0):
            raise InputError(f"a slack of {self.slack:g} s is not a number from 0")
        if (self.reach is None) != (self.near is None):
            raise InputError("reach and near go together (see prune)")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def first_rows(self) -> np.ndarray:
        """First row of each tag, (N,)."""
        return np.searchsorted(self.tag, np.arange(len(self.tags)))

    @property
    def last_rows(self) -> np.ndarray:
        """Last row of each tag, (N,)."""
        return np.searchsorted(self.tag, np.arange(len(self.tags)), side="right") - 1

    @property
    def n_heard(self) -> np.ndarray:
        """Number of receivers that heard each ping, (P,)."""
        return self.heard.sum(1)

    @property
    def listening(self) -> np.ndarray:
        """Which deployments listened at each ping, (P, R) bool; one that heard it did."""
        return self.listening_at(self.time) | self.heard

    def listening_at(self, time: np.ndarray) -> np.ndarray:
        """Which deployments listened at each time (T,) in seconds from `origin`, (T, R) bool."""
        r, origin = self.receivers, 0 if self.origin is None else self.origin
        ns = origin + np.round(np.asarray(time) * 1e9).astype(np.int64)[:, None]
        since = (r.start == OPEN_START) | (ns >= r.start)
        return since & ((r.end == OPEN_END) | (ns < r.end))

    @property
    def spacing(self) -> float:
        """Median distance from a place of a receiver to the next one, m."""
        xy = np.unique(self.receivers.xy, axis=0)
        if len(xy) < 2:
            return _LONE
        apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
        np.fill_diagonal(apart, np.inf)
        return float(np.median(apart.min(axis=1)))

    @property
    def summed(self) -> bool:
        """Whether the number of missed pings in the gaps is unknown and can be summed out."""
        return not self.known and self.schedule.kind in GAP_KINDS

    @classmethod
    def from_arrivals(
        cls, toas: ArrivalTimes | Sequence[ArrivalTimes], known: bool | None = None, **fields: Any
    ) -> EncounterHistory:
        """Build from arrival times of one tag or several, by who heard each ping.

        Parameters
        ----------
        toas : ArrivalTimes or sequence of them
            All with the same receivers; a ping's time is that of its first arrival. Rows that
            nobody heard are pings, at times interpolated between the heard ones.
        known : bool, optional
            Every ping sent is a row; by default where there is a row that nobody heard.
        **fields
            Other fields, such as schedule (theirs by default), start and end.

        Raises
        ------
        InputError
            If no ping was heard, receivers differ, or schedules do.
        """
        given = [toas] if isinstance(toas, ArrivalTimes) else list(toas)
        return cls(**history_of(given, known, fields))

    def replace(self, **changes: Any) -> EncounterHistory:
        """Return a copy with some fields changed, checked again."""
        return _replace(self, **changes)

    def detected(self) -> EncounterHistory:
        """Return the history without the pings that nobody heard, nor tags never heard.

        Raises
        ------
        InputError
            If no ping was heard.
        """
        return self._rows(self.n_heard > 0).replace(known=False)

    def without_schedule(self) -> EncounterHistory:
        """Return the heard pings alone, nothing being known of the schedule."""
        nothing = np.full(len(self.detected().tags), np.nan)
        return self.detected().replace(schedule=Schedule(), start=nothing, end=nothing)

    def _rows(self, keep: np.ndarray) -> EncounterHistory:
        """The rows where `keep` (P,) is true; tags without any are left out."""
        if not keep.any():
            raise InputError("no ping was heard")
        tags = np.unique(self.tag[keep])

        def part(value: np.ndarray | None) -> np.ndarray | None:
            return None if value is None else value[keep]

        r, p = len(self.receivers), len(self)
        return self.replace(
            time=self.time[keep],
            tag=np.searchsorted(tags, self.tag[keep]),
            heard=self.heard[keep],
            tags=tuple(self.tags[i] for i in tags),
            start=self.start[tags],
            end=self.end[tags],
            detection=part(self.detection),
            near=part(self.near),
            covariates={
                k: v if callable(v) or np.shape(v) in ((r,), (1, r)) and p != r else v[keep]
                for k, v in self.covariates.items()
            },
        )

    def middles(self) -> np.ndarray:
        """Return the middle of the receivers that heard each ping, (P, 2) m; linear in between."""
        out = np.empty((len(self), 2))
        out[:] = self.receivers.xy.mean(axis=0)
        n = self.n_heard
        middle = self.heard @ self.receivers.xy / np.maximum(n, 1)[:, None]
        for i, j in zip(self.first_rows, self.last_rows + 1, strict=True):
            rows = i + np.flatnonzero(n[i:j])
            if len(rows):
                for axis in (0, 1):
                    at = np.interp(self.time[i:j], self.time[rows], middle[rows, axis])
                    out[i:j, axis] = at
        return np.clip(out, self.low, self.high)

    def prune(self, positions: np.ndarray | None = None, *, reach: float) -> EncounterHistory:
        """Return a history that considers at each state only receivers within reach.

        Receivers that heard a ping are always considered at it. Between pings positions are
        taken as linear in time.

        Parameters
        ----------
        positions : array (P, 2), optional
            Rough position at each ping, m; the middle of the receivers that heard it by default.
        reach : float
            m. Choose it so that `maloc.model_data.prune_bound` is small, .01 say.

        Raises
        ------
        InputError
            If the reach is not positive, or positions have another shape.
        """
        if not (np.isfinite(reach) and reach > 0):
            raise InputError(f"a reach of {reach:g} m is not positive")
        near = self.middles() if positions is None else positions
        return self.replace(near=near, reach=float(reach))

    def prune_bound(self, *args: Any, **options: Any) -> float:
        """Go with the next release: `maloc.model_data.prune_bound` does this."""
        name = "EncounterHistory.prune_bound"
        return moved.call(name, "maloc.model_data", "prune_bound", self, *args, **options)

    def to_model_data(self, pad: bool = True) -> Any:
        """Go with the next release: `maloc.model_data.to_model_data` does this."""
        name = "EncounterHistory.to_model_data"
        return moved.call(name, "maloc.model_data", "to_model_data", self, pad)

    def __repr__(self) -> str:
        n = len(self.tags)
        span = duration(float(np.ptp(self.time)))
        when = "" if self.origin is None else f" from {iso(self.origin)} UTC"
        aside = f", {len(self.set_aside)} detections set aside" if len(self.set_aside) else ""
        return (
            f"EncounterHistory: {len(self)} pings ({int((self.n_heard == 0).sum())} unheard) of "
            f"{n} tag{'s' * (n != 1)} x {len(self.receivers)} receivers, "
            f"{self.n_heard.mean():.1f} heard a ping, interval {self.schedule}, "
            f"{span}{when}{aside}{self.report.flag}"
        )


def _box(receivers: Receivers, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    xy = receivers.xy
    return xy.min(axis=0) - _BUFFER * spacing, xy.max(axis=0) + _BUFFER * spacing
