"""Several files of detections as one table: what two files both hold counts once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from maloc.data._codespaces import same_tags
from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.data.events import ClockReferences, correct_clocks
from maloc.data.receivers import serial
from maloc.data.report import Note
from maloc.errors import InputError
from maloc.readers.innovasea import CORRECTED_TIMES, DEVICE_TIMES

__all__ = ["merge", "on_asked_clock", "under_one_name"]

FEWEST = 10  # detections in the overlap of two files, to say that they hold the same
SAME = 0.9  # share of them that must agree


def merge(parts: Sequence[Detections]) -> Detections:
    """Join detections of several files.

    Detections of the same time, receiver and tag count once. Where two files hold the same
    detections of a receiver in different words, in whole seconds in one or on another clock, they
    would count twice: whole seconds give way to fractions, other clocks are refused.

    Raises
    ------
    InputError
        If two files hold the same detections of a receiver on different clocks.
    """
    parts = _serials(list(parts))
    for a, b in combinations(range(len(parts)), 2):
        for name in set(parts[a].receivers) & set(parts[b].receivers):
            parts[a], parts[b] = _once(parts[a], parts[b], name)
    out = Detections.concat(parts)
    mixed = [_clock_of(p) for p in parts]
    if "device" in mixed and "corrected" in mixed:
        files = [f for p, m in zip(parts, mixed, strict=True) if m == "device"
                 for f in p.report.files]  # fmt: skip
        text = (
            f"corrected times in some files and device times in others ({', '.join(files[:6])}): "
            "they may be seconds apart; --clock device or --clock linear treats all alike"
        )
        out = replace(out, report=out.report.add(Note("warning", text, len(files))))
    return out


def _serials(parts: list[Detections]) -> list[Detections]:
    """Call a receiver by its serial number where one file does and another puts its model first."""
    names = {n for p in parts for n in p.receivers}
    other = {n: serial(n) for n in names if serial(n) != n and serial(n) in names}
    if not other:
        return parts
    return [
        replace(p, receiver=np.array([other.get(n, n) for n in p.receiver.tolist()], str))
        if set(p.receivers) & other.keys()
        else p
        for p in parts
    ]


def _clock_of(part: Detections) -> str | None:
    said = [n.text for n in part.report.notes]
    if any(t.startswith(CORRECTED_TIMES) for t in said):
        return "corrected"
    return "device" if DEVICE_TIMES in said else None


def _once(a: Detections, b: Detections, receiver: str) -> tuple[Detections, Detections]:
    """Make sure that no detection of a receiver is in both files in other words."""
    mine = [np.flatnonzero(d.receiver == receiver) for d in (a, b)]
    first = max(int(d.time[m].min()) for d, m in zip((a, b), mine, strict=True))
    last = min(int(d.time[m].max()) for d, m in zip((a, b), mine, strict=True))
    inside = [
        m[(d.time[m] >= first - NS) & (d.time[m] <= last + NS)]
        for d, m in zip((a, b), mine, strict=True)
    ]
    few = min(map(len, inside))
    if few < FEWEST:
        return a, b
    keys = [_keys(d, m) for d, m in zip((a, b), inside, strict=True)]
    if len(keys[0] & keys[1]) > (1 - SAME) * few:
        return a, b
    whole = [bool((d.time[m] % NS == 0).all()) for d, m in zip((a, b), inside, strict=True)]
    if whole[0] != whole[1]:
        coarse = 0 if whole[0] else 1
        return _without_whole_seconds((a, b), inside, coarse, receiver)
    apart = _same_sequence((a, b), inside)
    if apart is not None:
        one, other = (d.report.files[0] if d.report.files else "?" for d in (a, b))
        raise InputError(
            f"holds the detections of receiver {receiver} that {one} holds too, about "
            f"{apart:.3g} s apart: the same data with another clock correction",
            file=other,
            mend="give one of the two",
        )
    return a, b


def _keys(d: Detections, rows: np.ndarray) -> set[tuple[int, str]]:
    return set(zip(d.time[rows].tolist(), d.tag[rows].tolist(), strict=True))


def _without_whole_seconds(
    pair: tuple[Detections, Detections], inside: list[np.ndarray], coarse: int, receiver: str
) -> tuple[Detections, Detections]:
    fine = 1 - coarse
    seconds = pair[fine].time[inside[fine]]
    tags = pair[fine].tag[inside[fine]].tolist()
    near = {
        (int(t) // NS + k, tag) for t, tag in zip(seconds, tags, strict=True) for k in (0, 1)
    }  # cut or rounded
    rows = inside[coarse]
    mine = zip(
        (pair[coarse].time[rows] // NS).tolist(), pair[coarse].tag[rows].tolist(), strict=True
    )
    there = np.array([k in near for k in mine])
    if there.mean() < SAME:
        return pair
    keep = np.ones(len(pair[coarse]), bool)
    keep[rows[there]] = False
    n, out = int(there.sum()), list(pair)
    text = f"{n} detections of {receiver} are in another file with fractions of a second: left out"
    less = pair[coarse].take(keep)
    out[coarse] = replace(less, report=less.report.add(Note("info", text, n)))
    return out[0], out[1]


def _same_sequence(pair: tuple[Detections, Detections], inside: list[np.ndarray]) -> float | None:
    """Return how far apart (s) two lists of detections are that agree but for their clock."""
    ordered = [
        rows[np.argsort(d.time[rows], kind="stable")] for d, rows in zip(pair, inside, strict=True)
    ]
    n = min(map(len, ordered))
    best = None
    for shift in range(-3, 4):  # the ends of the overlap differ by what the clocks do
        i = np.arange(max(0, -shift), min(len(ordered[0]), len(ordered[1]) - shift))
        if len(i) < max(FEWEST, SAME * n):
            continue
        one, other = ordered[0][i], ordered[1][i + shift]
        apart = (pair[1].time[other] - pair[0].time[one]) / NS
        centre = float(np.median(apart))
        # the rhythm must be the same too: any two lists of one tag have the same tags
        agree = (pair[0].tag[one] == pair[1].tag[other]) & (np.abs(apart - centre) < 1.0)
        if agree.mean() >= SAME and (best is None or abs(centre) < abs(best)):
            best = centre
    return best


def under_one_name(detections: Detections) -> Detections:
    """Give tags that are there under two names (code spaces of two makers) one of them."""
    other = same_tags(detections.tags)
    if not other:
        return detections
    tag = detections.tag.astype(object)
    notes = []
    for name, use in other.items():
        mine = detections.tag == name
        tag[mine] = use
        text = f"{int(mine.sum())} detections of {name} counted as {use}: two names of one tag"
        notes.append(Note("info", text, int(mine.sum())))
    report = detections.report.add(*notes)
    return replace(detections, tag=tag.astype(str), report=report)


def on_asked_clock(
    detections: Detections, references: ClockReferences, clock: str | None
) -> Detections:
    """Correct device times if asked to; else say what could be corrected.

    Raises
    ------
    InputError
        If a correction is asked for and no file holds comparisons of clocks.
    """
    if clock == "linear":
        if not len(references):
            raise InputError(
                "no comparisons of clocks to correct device times by (--clock linear)",
                file=", ".join(detections.report.files),
                mend="give the Fathom/VDAT logs, or VUE's receiver events beside the detections",
            )
        return correct_clocks(detections, references)
    notes = []
    on_device = any(n.text == DEVICE_TIMES for n in detections.report.notes)
    if len(references) and (on_device or clock == "device"):
        for line in references.describe():
            notes.append(Note("info", f"{line}; --clock linear does it"))
    if not notes:
        return detections
    return replace(detections, report=detections.report.add(*notes))
