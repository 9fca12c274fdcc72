"""Arrival times and encounters of one or more tags together: what the joint model is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maloc._package import moved
from maloc.data import _links
from maloc.data._encounter_pings import travel_slack
from maloc.data._links import Links
from maloc.data.arrivals import ArrivalTimes, Schedule
from maloc.data.encounters import EncounterHistory
from maloc.data.sound_profile import SoundProfile
from maloc.data.water_column import WaterColumn
from maloc.errors import InputError

__all__ = ["ArrivalHistory", "arrival_history", "as_history"]

_ROUNDING = 0.005  # s; a tag keeps its sequence to this


@dataclass(frozen=True, repr=False, eq=False)
class ArrivalHistory:
    """Arrival times of N tags, and who heard each ping and who did not.

    Made by `maloc.arrival_history`.

    Attributes
    ----------
    toas : tuple of ArrivalTimes
        One a tag, with a row for every ping that is known to have been sent.
    encounters : EncounterHistory
        The same P pings, tag after tag.
    arrival : array (P, R)
        Seconds from the encounters' origin; NaN = not heard.
    sound_speed : array (P,)
        m/s.
    clock_sd : array (P, R)
        Standard deviation of each receiver's clock at each ping, s.
    links : Links
        Burst intervals from each ping to the next, 0 where not known.
    schedule : str
        "unknown", "random", "stable" or "sequence".
    interval : tuple of float
        MIN, MAX or MEAN, SD of the schedule, s.
    silence : str
        "given": every ping is a row; "summed": missed pings are summed out; "unknown".
    speed_sd : float or None
        Relative sd of the sound speed, where it is not sure.
    """

    toas: tuple[ArrivalTimes, ...]
    encounters: EncounterHistory
    arrival: np.ndarray
    sound_speed: np.ndarray
    clock_sd: np.ndarray
    links: Links
    schedule: str
    interval: tuple[float, float]
    silence: str
    speed_sd: float | None

    @property
    def column(self) -> WaterColumn | None:
        """That tracks have depth, see `ArrivalTimes`."""
        return self.toas[0].column

    @property
    def profile(self) -> SoundProfile | None:
        """Sound speed by depth, see `ArrivalTimes`."""
        return self.toas[0].profile

    @property
    def sensed_depth(self) -> np.ndarray:
        """Depths (P,) m that the tags sent; NaN = none."""
        each = [np.full(len(t), np.nan) if t.depth is None else t.depth for t in self.toas]
        return np.concatenate(each)

    def to_model_data(self, pad: bool = True) -> Any:
        """Go with the next release: `maloc.model_data.to_model_data` does this."""
        name = "ArrivalHistory.to_model_data"
        return moved.call(name, "maloc.model_data", "to_model_data", self, pad)

    def __repr__(self) -> str:
        return f"{self.encounters!r} with arrival times, silence {self.silence}".replace(
            "EncounterHistory", "ArrivalHistory", 1
        )


def arrival_history(
    toas: ArrivalTimes | Sequence[ArrivalTimes],
    *,
    known: bool | None = None,
    sequence: np.ndarray | None = None,
    **fields: Any,
) -> ArrivalHistory:
    """Bring arrival times and encounters of one tag or several together.

    Parameters
    ----------
    toas : ArrivalTimes or sequence of them
        All with the same receivers and schedule. Rows that nobody heard are pings that were sent.
    known : bool, optional
        Every ping sent is a row (but for those before the first and after the last). By default
        where there is a row that nobody heard, and for stable and known sequences of intervals,
        whose missed pings can be counted: they become rows.
    sequence : (L,) array, optional
        The tag's pseudo-random sequence of burst intervals, s, which repeats; the phase is found.
    **fields
        Other fields of `EncounterHistory`: start, end, covariates, low, high, edge.

    Returns
    -------
    ArrivalHistory

    Raises
    ------
    InputError
        If no ping was heard, receivers, schedules or profiles differ, a sequence fits nowhere, or
        a stable interval explains fewer than nine gaps in ten.
    """
    given = [toas] if isinstance(toas, ArrivalTimes) else list(toas)
    schedule = next((t.schedule for t in given if t.heard.any()), Schedule())
    if any(t.column != given[0].column for t in given):
        raise InputError("tags differ in their water column", mend="give all of them the same")
    if any(t.profile != given[0].profile for t in given):
        raise InputError("tags differ in their profile of sound speed", mend="give all the same")
    kind = "sequence" if sequence is not None else schedule.kind
    filled, links = [], []
    for toa in given:
        if not toa.heard.any():
            continue  # EncounterHistory says so
        whole, own = _whole(toa, schedule, sequence, known)
        filled.append(whole)
        links.append(own)
    counted = kind in ("stable", "sequence")
    told = True if counted else known
    encounters = EncounterHistory.from_arrivals(
        [*filled, *(t for t in given if not t.heard.any())], told, **fields
    )
    silence = "given" if encounters.known else "summed" if encounters.summed else "unknown"
    n = np.concatenate([np.append(link.n, 0.0) for link in links])[:-1]
    nominal = np.concatenate([np.append(link.nominal, 0.0) for link in links])[:-1]
    if kind == "random" and silence != "given":
        n = _random_counts(encounters, schedule)
    if kind in ("unknown", "poisson"):
        n = np.zeros(len(n))
    return ArrivalHistory(
        toas=tuple(filled),
        encounters=encounters,
        arrival=_arrivals(filled, encounters),
        sound_speed=np.concatenate([t.sound_speed for t in filled]),
        clock_sd=np.concatenate(
            [np.zeros(t.toa.shape) if t.clock_sd is None else t.clock_sd for t in filled]
        ),
        links=Links(n, nominal),
        schedule="unknown" if kind == "poisson" else kind,
        interval=_interval(schedule, nominal, n),
        silence=silence,
        speed_sd=_speed_sd(filled),
    )


def as_history(value) -> ArrivalHistory:
    """An `ArrivalHistory` as it is; one of arrival times."""
    return value if isinstance(value, ArrivalHistory) else arrival_history(value)


def _whole(toa: ArrivalTimes, schedule: Schedule, sequence, known) -> tuple[ArrivalTimes, Links]:
    """A tag's rows with those that the schedule counts, and the links between them."""
    complete = known or (known is None and bool((toa.n_heard == 0).any()))
    if sequence is None and (schedule.kind != "stable" or complete):
        return toa, _links.links_of(toa, schedule)
    bare = _heard_only(toa, np.flatnonzero(toa.n_heard > 0))
    gaps = np.diff(bare.first)
    if sequence is not None:
        slack = 0.5 * travel_slack(toa.receivers.xy[toa.heard.any(axis=0)]) + _ROUNDING
        counts, each = _links.sequence_counts(bare.first, np.asarray(sequence, float), slack)
    else:
        counts, mean = _links.stable_counts(gaps, schedule.lo)
        each = np.repeat(np.where(counts > 0, mean, 0.0), np.maximum(counts, 1).astype(int))
        if (odd := int((counts == 0).sum())) > 0.1 * max(len(counts), 1):
            raise InputError(
                f"tag {toa.tag or '(no name)'}: {odd} of {len(counts)} gaps between heard pings "
                f"hold no whole number of intervals of {schedule}",
                mend="give the interval as random MIN MAX",
            )
    whole = _links.insert_unheard(bare, np.maximum(counts, 1))
    return whole, Links(np.where(each > 0, 1.0, 0.0), each)


def _heard_only(toa: ArrivalTimes, rows: np.ndarray) -> ArrivalTimes:
    return toa.replace(
        toa=toa.toa[rows],
        sound_speed=toa.sound_speed[rows],
        ping=toa.ping[rows],
        depth=None if toa.depth is None else toa.depth[rows],
        detection=None if toa.detection is None else toa.detection[rows],
        clock_sd=None if toa.clock_sd is None else toa.clock_sd[rows],
    )


def _random_counts(encounters: EncounterHistory, schedule: Schedule) -> np.ndarray:
    """Intervals between rows where the limits leave one answer, else 0, (P - 1,)."""
    n = _links.count_intervals(
        encounters.time, schedule.kind, schedule.lo, schedule.hi, encounters.slack
    )
    return np.where(np.diff(encounters.tag) == 0, n, 0.0)


def _arrivals(toas: list[ArrivalTimes], encounters: EncounterHistory) -> np.ndarray:
    zero = encounters.origin or 0
    return np.concatenate([t.toa + ((t.origin or 0) - zero) / 1e9 for t in toas])


def _interval(schedule: Schedule, nominal: np.ndarray, n: np.ndarray) -> tuple[float, float]:
    counted = n > 0
    if schedule.kind in ("random", "stable"):
        return schedule.lo, schedule.hi
    if counted.any() and nominal.any():
        return float(np.mean(nominal[counted])), _ROUNDING
    return 1.0, 1.0


def _speed_sd(toas: list[ArrivalTimes]) -> float | None:
    """Relative sd of the sound speed: the largest of the tags'."""
    found = [t.sound_speed_sd / float(t.sound_speed.mean()) for t in toas if t.sound_speed_sd]
    return max(found) if found else None
