"""Which detections tell of the clocks: sync detections, their pings, and why the rest are left."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import InputError
from maloc.sync._coarse import FEW, CoarseClock, align
from maloc.sync._pings import associate
from maloc.sync._progress import Tell, silent

__all__ = ["Curve", "Grouped", "SyncData", "collect", "group", "resolve_sync_tags", "seconds"]

PING_GAP = 0.5  # emission times of one ping agree within this after coarse alignment, s

USED = ""
NOT_ALIGNED = "clock not aligned"
JUMPED = "near a jump of the clock, on neither side for sure"
ECHO = "later arrival of the same ping"
ALONE = "ping heard by one receiver"


def seconds(time: np.ndarray, origin: int) -> np.ndarray:
    """Seconds (float64) from `origin`; both are ns since 1970, subtracted as integers."""
    return (np.asarray(time, np.int64) - origin) * 1e-9


class SyncData(NamedTuple):
    """Sync detections, arrays (N,).

    Attributes
    ----------
    row : int
        Row of the detections' table.
    recorded : float
        Seconds from the origin on the receiver's clock.
    clock, tag, place, source : int
        Receiver (index in `Receivers.names`), sync tag, deployment that heard and deployment
        beside which the tag was.
    tags : tuple of str
        Full ids of the sync tags.
    """

    row: np.ndarray
    recorded: np.ndarray
    clock: np.ndarray
    tag: np.ndarray
    place: np.ndarray
    source: np.ndarray
    tags: tuple[str, ...]


def resolve_sync_tags(
    detections: Detections, receivers: Receivers
) -> tuple[np.ndarray, list[Note]]:
    """Full id (D,) of each deployment's sync tag as in the detections; "" = none or never heard.

    Raises
    ------
    InputError
        If an id is ambiguous, or two receivers claim one tag at the same time.
    """
    full = np.full(len(receivers), "", dtype=object)
    lost = []
    for d, tag in enumerate(receivers.sync_tag):
        if not tag:
            continue
        ending = [t for t in detections.tags if t == tag or t.endswith(f"-{tag}")]
        if ending:
            full[d] = detections.find_tag(tag)  # raises when ambiguous
        else:
            lost.append(f"{tag} (receiver {receivers.receiver[d]})")
    notes = []
    if lost:
        text = f"{len(lost)} sync tags of the table were never heard: {', '.join(lost)}"
        notes.append(Note("warning", text, len(lost)))
    for tag in sorted(set(full) - {""}):
        mine = np.flatnonzero(full == tag)
        mine = mine[np.argsort(receivers.start[mine], kind="stable")]
        for a, b in zip(mine[:-1], mine[1:], strict=True):
            if receivers.start[b] < receivers.end[a]:
                both = f"{receivers.receiver[a]} and {receivers.receiver[b]}"
                raise InputError(
                    f"sync tag {tag} stands at two places at once: {both}",
                    mend="give each receiver its own sync tag, or start and end",
                )
    return full, notes


def _sources(full: np.ndarray, receivers: Receivers, tag: np.ndarray, time: np.ndarray):
    """Deployment (N,) beside which each sync detection's tag was at the time; -1 = none."""
    source = np.full(len(tag), -1)
    for name in sorted(set(full) - {""}):
        mine = np.flatnonzero(full == name)
        rows = tag == name
        if len(mine) == 1:  # clocks may be hours off: one place needs no date
            source[rows] = mine[0]
            continue
        for d in mine:
            source[rows & (time >= receivers.start[d]) & (time < receivers.end[d])] = d
    return source


def collect(
    detections: Detections, receivers: Receivers, origin: int
) -> tuple[SyncData, tuple[Note, ...]]:
    """Pick the sync detections.

    Raises
    ------
    InputError
        If there is no sync tag in the table or none was heard.
    """
    if not (receivers.sync_tag != "").any():
        raise InputError(
            "no receiver has a sync tag, so clocks cannot be compared",
            column="sync_tag",
            mend="fill the column sync_tag of the receivers' table, or use synchronised times",
        )
    full, notes = resolve_sync_tags(detections, receivers)
    row = np.flatnonzero(np.isin(detections.tag, sorted(set(full) - {""})))
    if len(row) == 0:
        raise InputError(
            f"none of the {len(set(receivers.sync_tag) - {''})} sync tags was detected",
            mend="check the ids in the column sync_tag against the tags in the detections",
        )
    time, tag = detections.time[row], detections.tag[row].astype(str)
    place = receivers.deployment_of(detections.receiver[row], time)
    source = _sources(full, receivers, tag, time)
    for bad, text in (
        (place < 0, "by a receiver that is not in the table or was not deployed"),
        ((source < 0) & (place >= 0), "of a sync tag outside any deployment"),
    ):
        if bad.any():
            n = int(bad.sum())
            notes.append(Note("warning", f"{n} sync detections {text}: left out of the sync", n))
    good = (place >= 0) & (source >= 0)
    row, tag, place, source = row[good], tag[good], place[good], source[good]
    tags, tag_index = np.unique(tag, return_inverse=True)
    names = {name: i for i, name in enumerate(receivers.names)}
    clock_of = np.array([names[r] for r in receivers.receiver], int)
    data = SyncData(
        row,
        seconds(detections.time[row], origin),
        clock_of[place],
        tag_index.astype(int),
        place,
        source,
        tuple(map(str, tags)),
    )
    return data, tuple(notes)


def most_shared(data: SyncData, n_clocks: int) -> int:
    """Receiver that shares most sync detections with the others."""
    heard = np.zeros((n_clocks, len(data.tags)))
    np.add.at(heard, (data.clock, data.tag), 1)
    shared = np.minimum(heard[:, None], heard[None]).sum(2)
    np.fill_diagonal(shared, 0)
    return int(shared.sum(1).argmax())


class Curve(NamedTuple):
    """Coarse clock in common time: piecewise linear, jumps taken out.

    Attributes
    ----------
    time, offset : array (M,)
        s; offset as before the first jump.
    drift : array (2,)
        Slope before the first and after the last node, s/s.
    """

    time: np.ndarray
    offset: np.ndarray
    drift: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """Offset (N,) at common times (N,), s."""
        inside = np.clip(time, self.time[0], self.time[-1])
        slope = np.where(time < inside, self.drift[0], self.drift[1])
        return np.interp(inside, self.time, self.offset) + slope * (time - inside)

    def against(self, other: Curve) -> Curve:
        """Return the offset to another clock, in that clock's time."""
        shift = other.at(self.time)
        return Curve(self.time + shift, self.offset - shift, self.drift - other.drift)


class Grouped(NamedTuple):
    """Coarse clocks and the pings that they show.

    Attributes
    ----------
    clocks : dict of int to CoarseClock
    curves : dict of int to Curve
        On the reference's clock.
    reference : int
    reason : str
        Why it is the reference.
    jumps : list of (clock, size)
        Jumps that votes found, s, those of a clock in time order.
    segment, ping : int arrays (N,)
        Jumps of its clock before each detection; ping numbered from 0 in time order over pings
        with an arrival in the fit, -1 = in none.
    common : array (N,)
        Coarse common time of each arrival; NaN = clock not aligned.
    why : array (N,) of str
        Why an arrival is left out of the fit, "" = it is in.
    """

    clocks: dict[int, CoarseClock]
    curves: dict[int, Curve]
    reference: int
    reason: str
    jumps: list[tuple[int, float]]
    segment: np.ndarray
    ping: np.ndarray
    common: np.ndarray
    why: np.ndarray


def _align(
    data: SyncData, emission: np.ndarray, n_clocks: int, tell: Tell
) -> dict[int, CoarseClock]:
    """Coarse clocks on the clock of a receiver that does not jump as far as votes can see."""
    tried: set[int] = set()
    reference = most_shared(data, n_clocks)
    clocks = align(emission, data.tag, data.clock, n_clocks, reference, tell=tell)
    while reference not in tried and _jumps_itself(clocks, reference):
        tried.add(reference)
        often = np.bincount(data.clock, minlength=n_clocks)
        few = [
            (len(c.jumps) - len(clocks[reference].jumps), -often[j], j)
            for j, c in clocks.items()
            if j not in tried
        ]
        if not few:
            break
        reference = min(few)[2]
        clocks = align(emission, data.tag, data.clock, n_clocks, reference, tell=tell)
    return clocks


def _jumps_itself(clocks: dict[int, CoarseClock], reference: int) -> bool:
    """Whether most other clocks seem to jump at one moment by the same."""
    others = [c.jumps for j, c in clocks.items() if j != reference]

    def alike(a: tuple[float, float], b: tuple[float, float]) -> bool:
        # clocks that drift differently see one jump by amounts that differ
        return abs(a[1] - b[1]) < 0.3 + 2e-3 * abs(a[1]) and abs(a[0] - b[0]) < 3 * 3600

    for jump in (jump for jumps in others for jump in jumps):
        same = [any(alike(jump, other) for other in jumps) for jumps in others]
        if len(others) > 2 and sum(same) > len(others) / 2:
            return True
    return False


def _curve(clock: CoarseClock) -> Curve:
    """One clock in common time, its jumps taken out."""
    lead = np.concatenate([[0.0], np.cumsum([size for _, size in clock.jumps])])
    parts = zip(clock.stretches, lead, strict=True)
    nodes = [(s.common, s.offset - before) for s, before in parts]
    time, offset = (np.concatenate(p) for p in zip(*nodes, strict=True))
    order = np.argsort(time, kind="stable")
    ends = np.array([clock.stretches[0].drift, clock.stretches[-1].drift])
    return Curve(time[order], offset[order], ends / (1 - ends))


def _mode(values: np.ndarray) -> float:
    """Half-sample mode (Bickel & Fruehwirth 2006): where values lie closest together."""
    x = np.sort(values)
    while len(x) > 3:
        half = (len(x) + 1) // 2
        i = int((x[half - 1 :] - x[: len(x) - half + 1]).argmin())
        x = x[i : i + half]
    if len(x) == 3 and x[1] - x[0] != x[2] - x[1]:
        x = x[:2] if x[1] - x[0] < x[2] - x[1] else x[1:]
    return float(x.mean())


def _agreeing_clock(
    data: SyncData, clocks: dict[int, CoarseClock], curves: dict[int, Curve]
) -> int:
    """The clock among those that agree best, of those that heard much and did not jump."""
    often = np.bincount(data.clock)
    at = np.array([np.median([np.median(c.time) for c in curves.values()])])
    value = {j: float(c.at(at)[0]) for j, c in curves.items()}
    mode = _mode(np.array(list(value.values())))
    enough = 0.5 * np.median([often[j] for j in curves])
    good = [j for j in curves if often[j] >= enough and not clocks[j].jumps] or list(curves)
    return min(good, key=lambda j: (abs(value[j] - mode), j))


def group(
    data: SyncData,
    travel: np.ndarray,
    reference: int | None,
    n_clocks: int,
    tell: Tell = silent,
) -> Grouped:
    """Align coarsely and form pings.

    Parameters
    ----------
    data : SyncData
    travel : array (N,)
        Travel time, s.
    reference : int, optional
        Clock that is to be the common time; one of those that agree best if not given.
    n_clocks : int
    tell : Tell
        Told of each clock that is aligned.
    """
    emission = data.recorded - travel
    clocks = _align(data, emission, n_clocks, tell)
    segment = np.zeros(len(emission), int)
    common = np.full(len(emission), np.nan)
    why = np.full(len(emission), NOT_ALIGNED, dtype=object)
    jumps: list[tuple[int, float]] = []
    curves = {j: _curve(clock) for j, clock in clocks.items()}
    for j, clock in clocks.items():
        why[data.clock == j] = JUMPED
        jumps += [(j, size) for _, size in clock.jumps]
        for n, stretch in enumerate(clock.stretches):
            rows = stretch.rows
            why[rows], segment[rows] = USED, n
            common[rows] = data.recorded[rows] - stretch.at(emission[rows])
    if reference is None:
        reference = _agreeing_clock(data, clocks, curves)
        reason = "it is among the clocks that agree best, as clocks that are right do"
    else:
        reason = "asked for"
    if reference in curves:
        own = curves[reference]
        common = common + own.at(np.nan_to_num(common))
        curves = {j: curve.against(own) for j, curve in curves.items()}
    good = np.flatnonzero(why == USED)
    p, first = associate(data.tag[good], data.clock[good], (common - travel)[good], PING_GAP)
    why[good[~first]] = ECHO
    in_fit = why[good] == USED
    n_pings = int(p.max(initial=-1)) + 1
    alone = np.bincount(p[in_fit], minlength=n_pings) < 2
    why[good[in_fit & alone[p]]] = ALONE
    ping = np.full(len(emission), -1)
    kept = why == USED
    time_of = np.full(n_pings, np.inf)
    np.minimum.at(time_of, p, (common - travel)[good])
    real = np.unique(p[kept[good]])
    number = np.full(n_pings, -1)
    number[real[np.argsort(time_of[real], kind="stable")]] = np.arange(len(real))
    ping[good] = number[p]
    return Grouped(clocks, curves, reference, reason, jumps, segment, ping, common, why)


def alignment_notes(
    data: SyncData, clocks: dict[int, CoarseClock], names: tuple[str, ...]
) -> list[Note]:
    """Say which receivers could not be aligned, and what was odd about those that could."""
    notes = []
    count = np.bincount(data.clock, minlength=len(names))
    none = [names[j] for j in range(len(names)) if count[j] == 0]
    lost = [(names[j], count[j]) for j in range(len(names)) if count[j] and j not in clocks]
    if none:
        text = f"receivers that heard no sync tag, not synchronised: {', '.join(none)}"
        notes.append(Note("warning", text, len(none)))
    for name, n in lost:
        reason = f"fewer than {FEW}" if n < FEW else "no offset within 26 h that they agree on"
        text = f"receiver {name} not synchronised: {n} sync detections, {reason}"
        notes.append(Note("warning", text, int(n)))
    for j, clock in sorted(clocks.items()):
        if clock.ambiguous:
            text = (
                f"receiver {names[j]}: several clock offsets fit as well (regular sync intervals); "
                "the smallest was taken"
            )
            notes.append(Note("warning", text))
    return notes
