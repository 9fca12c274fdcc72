"""Two transmitters with one code: told by pings that one transmitter cannot have sent, and split.

A transmitter's located pings are a chain: from each to the next, time is a number of burst
intervals (some pings missed) and the way is what an animal swims. The best one, two, three chains
that share no ping are found exactly, as flow of least cost through the graph of all such steps
(Zhang, Li & Nevatia 2008, with laws of bursts and of movement). A second transmitter is there when
it explains pings that would else be left out by far, and when the two were not always at one
place (then rather the burst limits are wrong). Pings without a position follow by time and by who
heard them.

References
----------
Zhang, Li & Nevatia (2008) Global data association for multi-object tracking using network flows.
IEEE Conf. Comput. Vis. Pattern Recognit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from maloc.data.arrivals import ArrivalTimes
from maloc.emitters._chain_laws import Pings, Settings
from maloc.emitters._chains import ENTER, Chains, best_chains
from maloc.errors import InputError

__all__ = ["Split", "split_same_code"]

ECHO_S = 1.0  # pings sent so soon after another are its reflections, or collisions
FEW = 5  # pings that make a transmitter
APART = 20.0  # nats by which two paths must explain the places better than one


@dataclass(frozen=True, repr=False, eq=False)
class Split:
    """What one code's pings are.

    Parameters
    ----------
    tables : tuple of ArrivalTimes
        One a transmitter, most pings first; of one transmitter alone the table given, unchanged.
    chain : array (P,) of int
        Transmitter of each ping given, -1 = none.
    why : array (P,) of str
        Why a ping is no transmitter's; "" where it is one's. Empty of one transmitter alone:
        nothing was taken out.
    evidence : float
        Log likelihood ratio (nats) of two transmitters against one; 0 where it is below the 40
        that are asked.
    apart : float
        Part of it (nats) by which two paths explain the places better than one.
    doubt : array (D, 2)
        Moments (s from the origin) at which the transmitters' pings may be exchanged from there
        on, most often because they met; and the nats (below 5) that this would cost.
    n_conflicts : int
        Pairs of successive located pings nearer in time than the shortest burst interval.
    note : str
        The finding in a line.
    """

    tables: tuple[ArrivalTimes, ...]
    chain: np.ndarray
    why: np.ndarray
    evidence: float
    apart: float
    doubt: np.ndarray
    n_conflicts: int
    note: str

    @property
    def n_transmitters(self) -> int:
        """How many transmitters there are."""
        return len(self.tables)

    def __repr__(self) -> str:
        return f"Split: {self.note}"


def split_same_code(
    toa: ArrivalTimes,
    *,
    most: int = 3,
    sigma: float | None = None,
    false_rate: float = 1 / 3600,
) -> Split:
    """Tell whether several transmitters send one code, and give each its own pings.

    Parameters
    ----------
    toa : ArrivalTimes
        One code's pings, with the limits of its burst interval (`Schedule`), as `maloc.toa_matrix`
        makes them.
    most : int
        Transmitters looked for at most.
    sigma : float, optional
        Standard deviation of an arrival's error, m; estimated when not given.
    false_rate : float
        False detections of the code at a receiver, 1/s.

    Returns
    -------
    Split

    Raises
    ------
    InputError
        If the burst interval is not known, or no ping can be located.
    """
    from maloc.points import locate

    schedule = toa.schedule
    if schedule.kind not in ("random", "stable"):
        raise InputError(
            "transmitters of one code are told apart by their burst interval, which is not known",
            mend="give its limits",
        )
    if most < 1 or not false_rate > 0:
        raise InputError("most must be 1 or more, false_rate positive")
    points = locate(toa, sigma=sigma)
    sure = points.located & ~points.ambiguous & np.isfinite(points.covariance).all(axis=(1, 2))
    echo = _echoes(points.emission, toa.n_heard, sure)
    rows = np.flatnonzero(sure & ~echo)
    rows = rows[np.argsort(points.emission[rows], kind="stable")]
    pings = Pings(
        points.emission[rows], points.position[rows, :2], points.covariance[rows, :2, :2],
        toa.n_heard[rows],
    )  # fmt: skip
    settings = Settings(schedule, toa.n_receivers, false_rate, _travel(toa))
    n_conflicts = int((np.diff(pings.time) < settings.shortest).sum())
    found = best_chains(pings, settings, most)
    chains = [c for c in found.chains if len(c) >= FEW]
    note, apart = _judge(found, chains, n_conflicts, len(rows))
    if note:
        return Split(
            (toa,), np.zeros(len(toa), int), np.full(len(toa), ""), found.gain, apart,
            np.empty((0, 2)), n_conflicts, note,
        )  # fmt: skip
    chain, why = _follow(toa, rows, chains, pings, found.settings, echo, float(points.sigma))
    order = np.argsort(-np.bincount(chain[chain >= 0], minlength=len(chains)), kind="stable")
    chain = np.where(chain >= 0, np.argsort(order)[chain], -1)
    tables = tuple(_rows_of(toa, chain == k) for k in range(len(chains)))
    counts = ", ".join(str(len(t)) for t in tables)
    note = (
        f"{len(tables)} transmitters with one code: {counts} pings, {int((chain < 0).sum())} of "
        f"none; {found.gain:.0f} nats better than one, {n_conflicts} pings too soon after another, "
        f"{len(found.exchange)} moments at which they may be exchanged"
    )
    return Split(tables, chain, why, found.gain, apart, found.exchange, n_conflicts, note)


def _judge(found: Chains, chains: list, n_conflicts: int, n_located: int) -> tuple[str, float]:
    """Why it is one transmitter, "" if it is not; and how far apart the two are, nats."""
    if len(found.chains) < 2:
        return (
            f"one transmitter: a second is worth less than {ENTER:g} nats ({n_conflicts} of "
            f"{n_located} located pings come too soon after another)",
            0.0,
        )
    apart = found.apart
    if len(chains) < 2:
        return f"one transmitter: a second would have fewer than {FEW} located pings", apart
    if apart < APART:
        return (
            f"one transmitter: {n_conflicts} pings come sooner than the burst limits allow, but "
            "from where the others come: the limits are wrong",
            apart,
        )
    return "", apart


def _echoes(emission: np.ndarray, n_heard: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Which pings (P,) were sent within a second of one that more receivers heard, or as many."""
    rows = np.flatnonzero(sure)
    rows = rows[np.argsort(emission[rows], kind="stable")]
    out = np.zeros(len(emission), bool)
    for a, b in zip(rows[:-1], rows[1:], strict=True):
        if emission[b] - emission[a] < ECHO_S:
            out[a if n_heard[a] < n_heard[b] and not out[b] else b] = True
    return out


def _travel(toa: ArrivalTimes) -> float:
    """Sound time across the array, s."""
    extent = float(np.linalg.norm(np.ptp(toa.receivers.xy, axis=0)))
    return extent / float(toa.sound_speed.min())


def _follow(
    toa: ArrivalTimes,
    rows: np.ndarray,
    chains: list[np.ndarray],
    pings: Pings,
    settings: Settings,
    echo: np.ndarray,
    sigma: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Chain of each ping, those without a position by their times; and why they are of none."""
    chain = np.full(len(toa), -1)
    why = np.full(len(toa), "", dtype=object)
    why[rows] = "fits no transmitter's times and way"
    why[echo] = "sent within a second of another: its echo, or a collision"
    why[toa.n_heard == 0] = "heard by nobody"
    for k, members in enumerate(chains):
        chain[rows[members]] = k
    why[chain >= 0] = ""
    reach = np.linalg.norm(pings.xy[:, None] - toa.receivers.xy, axis=2)
    scale = float(np.sqrt((reach[toa.heard[rows]] ** 2).mean()))
    laws = [_Along(pings, members, settings, sigma, scale) for members in chains]
    for row in np.flatnonzero((chain < 0) & (why == "")):
        heard = toa.heard[row]
        ranges = toa.toa[row, heard] * toa.sound_speed[row]
        score = [law.log_ratio(ranges, toa.receivers.xy[heard], toa.sound_speed[row])
                 for law in laws]  # fmt: skip
        if np.isfinite(score).any():
            chain[row] = int(np.argmax(score))
        else:
            why[row] = "without a position, and fits between no transmitter's pings"
    return chain, why.astype(str)


class _Along(NamedTuple):
    """A transmitter's path between its located pings, to see whether a further ping is its."""

    pings: Pings
    members: np.ndarray
    settings: Settings
    sigma: float
    scale: float

    def log_ratio(self, ranges: np.ndarray, xy: np.ndarray, speed: float) -> float:
        """Log likelihood ratio that this transmitter sent a ping; -inf where it cannot have.

        From arrivals (n,) as ranges, m, at receivers (n, 2), and the sound speed. Time by the law
        of bursts, arrivals by the place between the pings before and after (a Brownian bridge),
        nearer receivers more likely to hear.
        """
        times = self.pings.time[self.members]
        place = self._place(times, float(ranges.min()) / speed)
        distance = np.linalg.norm(place - xy, axis=1)
        time = float(np.median(ranges - distance)) / speed
        at = int(np.searchsorted(times, time))
        gaps = np.diff(np.concatenate([times[max(at - 1, 0) : at], [time], times[at : at + 1]]))
        total = float(self.settings.log_gap(gaps).sum())
        if len(gaps) == 2:
            total -= float(self.settings.log_gap(gaps.sum(keepdims=True))[0])
            between = float(gaps.prod() / gaps.sum())
        else:
            between = float(gaps.sum())
        total -= float((distance**2).mean()) / (2 * self.scale**2)
        variance = self.sigma**2 + self.settings.diffusion * between
        off = ranges - distance - speed * time
        if len(off) > 2 and np.median(np.abs(off)) > 4 * np.sqrt(variance):
            return -np.inf
        normal = np.exp(-0.5 * off**2 / variance) / np.sqrt(2 * np.pi * variance)
        wild = 1 / (speed * self.settings.travel)
        return total + float(np.log(0.9 * normal + 0.1 * wild).sum())

    def _place(self, times: np.ndarray, time: float) -> np.ndarray:
        xy = self.pings.xy[self.members]
        return np.array([np.interp(time, times, xy[:, i]) for i in (0, 1)])


def _rows_of(toa: ArrivalTimes, mine: np.ndarray) -> ArrivalTimes:
    """The table of some pings."""
    parts = {
        name: None if (value := getattr(toa, name)) is None else value[mine]
        for name in ("toa", "sound_speed", "ping", "depth", "detection", "clock_sd")
    }
    return toa.replace(**parts)
