"""Which detections tell of the clocks: sync detections, their pings, and why the rest are left."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import InputError
from maloc.sync._coarse import FEW, CoarseClock, align
from maloc.sync._pings import associate

__all__ = ["SyncData", "collect", "group", "most_shared", "resolve_sync_tags", "seconds"]

PING_GAP = 0.5  # emission times of one ping agree within this after coarse alignment, s

USED = ""
SELF = "self-detection"
NOT_ALIGNED = "clock not aligned"
JUMPED = "after or before a jump of the clock"
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


def group(
    data: SyncData, travel: np.ndarray, reference: int, n_clocks: int, self_detections: bool
) -> tuple[dict[int, CoarseClock], np.ndarray, np.ndarray, np.ndarray]:
    """Align coarsely and form pings.

    Returns
    -------
    clocks : dict of int to CoarseClock
    ping : array (N,) of int
        Numbered from 0 in time order over pings with an arrival in the fit; -1 = in none.
    common : array (N,)
        Coarse common time of each arrival; NaN = clock not aligned.
    why : array (N,) of str
        Why an arrival is left out of the fit, "" = it is in.
    """
    emission = data.recorded - travel
    clocks = align(emission, data.tag, data.clock, n_clocks, reference)
    common = np.full(len(emission), np.nan)
    why = np.full(len(emission), NOT_ALIGNED, dtype=object)
    for j, clock in clocks.items():
        mine = np.flatnonzero(data.clock == j)
        own = emission[mine]
        inside = (own >= clock.start) & (own <= clock.end)
        why[mine] = np.where(inside, USED, JUMPED)
        common[mine[inside]] = (data.recorded[mine] - clock.at(own))[inside]
    good = np.flatnonzero(why == USED)
    p, first = associate(data.tag[good], data.clock[good], (common - travel)[good], PING_GAP)
    why[good[~first]] = ECHO
    own = (why == USED) & (data.source == data.place)
    if not self_detections:
        # a receiver that hears no other sync tag has only these
        others = np.bincount(data.clock[(why == USED) & ~own], minlength=n_clocks)
        why[own & (others >= FEW)[data.clock]] = SELF
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
    return clocks, ping, common, why


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
        if clock.jump:
            text = (
                f"the clock of receiver {names[j]} jumps (by {clock.jump:+.1f} s at most): only "
                "the longest stretch without a jump is synchronised (a clock that jumped back "
                "shows some times twice; those are taken as of that stretch)"
            )
            notes.append(Note("warning", text))
        if clock.ambiguous:
            text = (
                f"receiver {names[j]}: several clock offsets fit as well (regular sync intervals); "
                "the smallest was taken"
            )
            notes.append(Note("warning", text))
    return notes
