"""Detections of one tag to pings: who heard the same emission, and what fits nowhere."""

from __future__ import annotations

import numpy as np

from maloc.data import _pings
from maloc.data._sorting import Sorting
from maloc.data._time import NS
from maloc.data.arrivals import (
    DEFAULT_SOUND_SPEED,
    DEFAULT_SOUND_SPEED_SD,
    NO_SPEED,
    ArrivalTimes,
    Schedule,
)
from maloc.data.detections import Detections
from maloc.data.receivers import Receivers, collinear
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

__all__ = ["toa_matrix"]

ECHO_S = 0.5  # a second detection within this time at one receiver is the same ping
LATE_S = 0.5  # a reflected arrival is at most this much later than a direct one could be
UNSYNCHRONISED = (
    "run maloc sync first (maloc.sync.fit, then apply), or check that the file is of this array"
)


def toa_matrix(
    detections: Detections,
    receivers: Receivers,
    tag: object,
    *,
    sound_speed: float | np.ndarray | None = None,
    schedule: Schedule | None = None,
    tolerance: float = 0.01,
    origin: int | None = None,
) -> ArrivalTimes:
    """Group one tag's detections into pings.

    The delay between two receivers is limited by their distance: a direct arrival at j comes no
    more than d_jk / c + `tolerance` after one at k, a reflected one up to .5 s later still. There
    is no single threshold for the array. A second detection within .5 s at one receiver is an
    echo: the first is kept.

    Parameters
    ----------
    detections : Detections
        On one common clock (`maloc.sync`); other tags in it are ignored.
    receivers : Receivers
        The array; each deployment becomes a column.
    tag : str or int
        Full tag id or a unique ending of it.
    sound_speed : float or array (P,), optional
        m/s; 1500 with a warning when not given.
    schedule : Schedule, optional
        What is known of the burst interval; a lone detection that no emission can explain is then
        set aside.
    tolerance : float
        Timing error allowed between two receivers, s.
    origin : int, optional
        ns since 1970 UTC of second 0; the whole second before the first detection if not given.

    Returns
    -------
    ArrivalTimes
        One row a ping, in time order, also those that one receiver heard; `set_aside` lists every
        detection that is in no ping, with its reason.

    Raises
    ------
    InputError
        If there are no detections of the tag, one receiver alone heard it, times are whole
        seconds, or the clocks are evidently not synchronised.
    """
    schedule = schedule or Schedule()
    if not len(detections):
        raise InputError("no detections", file=_file(detections))
    if not len(receivers):
        raise InputError("no receivers in the table")
    full = detections.find_tag(tag)
    rows = np.flatnonzero(detections.tag == full)
    ns = detections.time[rows]
    _refuse_whole_seconds(ns, full, detections)
    start = int(ns.min() // NS * NS) if origin is None else int(origin)
    work = _Work(detections, receivers, full, rows, (ns - start) / NS)
    work.place()
    work.drop_whole_seconds()
    work.drop_echoes(_echo_window(schedule))
    work.refuse_too_few()
    speed = DEFAULT_SOUND_SPEED if sound_speed is None else np.asarray(sound_speed, np.float64)
    slowest = float(np.min(speed))
    if not (np.isfinite(slowest) and slowest > 0):
        raise InputError(f"sound speed {slowest:g} m/s is not a positive number")
    if sound_speed is None:
        work.notes.append(Note("warning", NO_SPEED))
    xy = receivers.xy
    down = np.nan_to_num(receivers.depth[:, None] - receivers.depth[None])
    apart = np.hypot(np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)), down)
    travel = apart / slowest
    late = LATE_S if not schedule.shortest > 0 else min(LATE_S, schedule.shortest / 4)
    work.group(travel, tolerance, late)
    _refuse_unsynchronised(work, travel, tolerance)
    if schedule.shortest > 0:
        work.drop_impossible(travel, schedule.shortest, tolerance + late)
    toa = work.finish(speed, schedule, start)
    return toa if sound_speed is not None else toa.replace(sound_speed_sd=DEFAULT_SOUND_SPEED_SD)


def _echo_window(schedule: Schedule) -> float:
    return min(ECHO_S, schedule.shortest / 2) if schedule.shortest > 0 else ECHO_S


def _file(detections: Detections) -> str | None:
    return ", ".join(detections.report.files) or None


def _refuse_whole_seconds(ns: np.ndarray, tag: str, detections: Detections) -> None:
    if len(ns) > 2 and (ns % NS == 0).all():
        raise InputError(
            f"all {len(ns)} detections of tag {tag} are at whole seconds: no positions from them "
            "(1 s = 1500 m)",
            file=_file(detections),
            mend="tick 'millisecond time precision' when exporting from VUE or Fathom",
        )


class _Work(Sorting):
    """Grouping by arrival times; needs fractions of a second and one clock."""

    def drop_whole_seconds(self) -> None:
        """Set aside a receiver whose times were exported without fractions, others having them."""
        whole = self.detections.time[self.rows] % NS == 0
        names = self.detections.receiver[self.rows]
        for name in np.unique(names[whole]):
            mine = self.detections.receiver[self.rows] == name
            if mine.sum() >= 5 and whole[mine].all():
                why = ["whole-second time"] * int(mine.sum())
                whole = whole[~mine]
                self.drop(mine, why, f"detections of {name} are at whole seconds", "warning")

    def refuse_too_few(self) -> None:
        """Refuse what can give no position at all."""
        heard = np.unique(self.column)
        if not len(heard):
            raise InputError(
                f"no detection of tag {self.tag} is from a receiver of the table while deployed",
                file=_file(self.detections),
                mend="compare the receivers' names in both files",
            )
        names = np.unique(self.receivers.receiver[heard])
        if len(names) == 1:
            raise InputError(
                f"tag {self.tag} was heard by 1 receiver ({names[0]}): no position is possible",
                file=_file(self.detections),
            )

    def group(self, travel: np.ndarray, tolerance: float, late: float) -> None:
        """Number the pings."""
        self.ping = _pings.group(self.time, self.column, travel, tolerance, late)

    def finish(self, speed: float | np.ndarray, schedule: Schedule, origin: int) -> ArrivalTimes:
        """Fill the matrix."""
        n, r = int(self.ping.max()) + 1, len(self.receivers)
        toa, source = np.full((n, r), np.nan), np.full((n, r), -1, np.int64)
        toa[self.ping, self.column] = self.time
        source[self.ping, self.column] = self.rows
        if np.ndim(speed) and np.shape(speed) != (n,):
            raise InputError(f"sound_speed has shape {np.shape(speed)}, there are {n} pings")
        self._remarks(toa)
        old = self.detections.report
        report = ReadReport(old.format, old.files, len(self.detections), old.notes)
        return ArrivalTimes(
            toa,
            self.receivers,
            np.broadcast_to(speed, (n,)),
            self.tag,
            origin,
            np.arange(1, n + 1),
            schedule,
            self._depth(n),
            detection=source,
            set_aside=self.set_aside(),
            report=report.add(*self.notes),
        )

    def _depth(self, n: int) -> np.ndarray | None:
        """Depth that the tag's sensor sent with each ping, m: the median of who heard it."""
        depth = self.detections.extra.get("depth")
        if depth is None or depth.dtype.kind not in "iuf":
            return None
        sent = np.asarray(depth, float)[self.rows]
        known = np.flatnonzero(np.isfinite(sent))
        if not len(known):
            return None
        order = known[np.lexsort((sent[known], self.ping[known]))]
        ping, first, count = np.unique(self.ping[order], return_index=True, return_counts=True)
        out = np.full(n, np.nan)
        out[ping] = (sent[order[first + (count - 1) // 2]] + sent[order[first + count // 2]]) / 2
        return out

    def _remarks(self, toa: np.ndarray) -> None:
        heard = np.isfinite(toa)
        silent = [self.receivers.labels[j] for j in np.flatnonzero(~heard.any(0))]
        if silent:
            text = f"receivers that listened and heard nothing of {self.tag}: {', '.join(silent)}"
            self.notes.append(Note("info", text, len(silent)))
        usable = int((heard.sum(1) >= 3).sum())
        if usable < 3:
            text = f"only {usable} pings were heard by 3 or more receivers"
            self.notes.append(Note("warning", text, usable))
        there = np.flatnonzero(heard.any(0))
        if len(there) > 2 and collinear(self.receivers.subset(there)):
            text = (
                "the receivers that heard the tag are on one line (collinear): every position has "
                "an equally good mirror image across it"
            )
            self.notes.append(Note("warning", text))


def _refuse_unsynchronised(work: _Work, travel: np.ndarray, tolerance: float) -> None:
    """Refuse clocks that cannot be on one time; warn of a single one that is not.

    Two signs: a receiver whose detections join no ping although others hear the tag at the same
    time, and a pair of receivers whose common pings mostly violate the limit of direct arrivals.
    """
    size = np.bincount(work.ping)
    shared = size[work.ping] > 1
    there, counts = np.unique(work.column, return_counts=True)
    often = there[counts >= 3]
    if len(often) < 2:
        return
    lost = []
    for c in often:
        mine = work.column == c
        if shared[mine].mean() < 0.2 and _others_listen(work, mine):
            lost.append(int(c))
    wrong, tested = _wrong_pairs(work, travel + tolerance)
    names = work.receivers.labels
    if len(lost) * 2 >= len(often) or (wrong and 5 * len(wrong) >= tested):
        if len(lost) * 2 >= len(often):
            who = ", ".join(names[c] for c in lost[:6])
            why = f"most detections at {who} match none at other receivers"
        else:
            why = (
                f"{len(wrong)} of {tested} pairs of receivers hear pings further apart in time "
                "than sound needs"
            )
        raise InputError(
            f"the clocks look unsynchronised: {why} (tag {work.tag})",
            file=_file(work.detections),
            mend=UNSYNCHRONISED,
        )
    if len(often) > 2 and shared.mean() < 0.5 and size.max() < 3:
        raise InputError(
            f"the clocks look unsynchronised: {len(often)} receivers heard tag {work.tag}, but of "
            f"{len(shared)} detections {int((~shared).sum())} match none at another receiver and "
            "no ping can be matched at three",
            file=_file(work.detections),
            mend=UNSYNCHRONISED,
        )
    for c in lost:
        n = int((work.column == c).sum())
        text = f"clock of {names[c]} looks wrong: its {n} detections match none elsewhere"
        work.notes.append(Note("warning", text, n))
    for a, b in wrong:
        text = f"clocks of {names[a]} and {names[b]} disagree: most delays exceed their distance"
        work.notes.append(Note("warning", text))


def _others_listen(work: _Work, mine: np.ndarray) -> bool:
    """Whether other receivers heard the tag during most of this one's detections' span."""
    lo, hi = np.percentile(work.time[mine], [10, 90])
    other = work.time[~mine]
    return int(((other >= lo) & (other <= hi)).sum()) >= 0.5 * int(mine.sum())


def _wrong_pairs(work: _Work, limit: np.ndarray) -> tuple[list[tuple[int, int]], int]:
    there = np.unique(work.column)
    grid = np.full((int(work.ping.max()) + 1, len(there)), np.nan)
    grid[work.ping, np.searchsorted(there, work.column)] = work.time
    wrong, tested = [], 0
    for i in range(len(there)):
        for k in range(i):
            gap = np.abs(grid[:, i] - grid[:, k])
            gap = gap[np.isfinite(gap)]
            if len(gap) < 3:
                continue
            tested += 1
            if (gap > limit[there[i], there[k]]).mean() > 0.5:
                wrong.append((int(there[k]), int(there[i])))
    return wrong, tested
