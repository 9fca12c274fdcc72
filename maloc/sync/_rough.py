"""Clocks brought together to about a second, by the animals' own tags: no sync tags are needed."""

from __future__ import annotations

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.data._time import NS
from maloc.errors import InputError
from maloc.sync._coarse import FEW, align

__all__ = ["rough"]

LIMIT = 2 * 3600.0  # s; clocks further off are an unset zone, which sync tags must settle
JUMP = 3.0  # s; smaller ones do no harm to the grouping


def rough(
    detections: Detections,
    receivers: Receivers,
    *,
    reference: object = None,
    limit: float = LIMIT,
) -> Detections:
    """Bring receivers' clocks together by the pings that several of them heard, of any tag.

    Two receivers that hear the same pings see their times apart by a constant and a drift, and by
    travel times of under a second: enough to tell pings from one another, not for positions by
    arrival times (`maloc.sync.fit`). Receivers that share too few pings with the others keep their
    own clocks, which is reported.

    Parameters
    ----------
    detections : Detections
        Raw.
    receivers : Receivers
        The array; receivers that are not in it are left as they are.
    reference : str, optional
        Receiver whose clock is the common time; the middle of all clocks if not given.
    limit : float
        Largest difference of two clocks that is looked for, s.

    Returns
    -------
    Detections
        The same rows, times changed; the report says by how much.

    Raises
    ------
    InputError
        If the reference is not among the receivers that could be brought together.
    """
    if not len(detections):
        return detections
    names, who = np.unique(receivers.canonical(detections.receiver), return_inverse=True)
    known = np.isin(names, receivers.names)[who]
    tags, tag = np.unique(detections.tag, return_inverse=True)
    zero = int(detections.time.min())
    seconds = (detections.time - zero) / NS
    heard = np.zeros((len(names), len(tags)))
    np.add.at(heard, (who[known], tag[known]), 1)
    shared = np.minimum(heard[:, None], heard[None]).sum(2)
    np.fill_diagonal(shared, 0)
    clocks = align(
        seconds[known], tag[known], who[known], len(names), int(shared.sum(1).argmax()), limit=limit
    )
    offset = np.zeros(len(seconds))
    for j, clock in clocks.items():
        mine = known & (who == j)
        offset[mine] = clock.at(seconds[mine])
    level = {j: float(np.median(offset[known & (who == j)])) for j in clocks}
    middle = float(np.median(list(level.values())))
    aligned = known & np.isin(who, list(clocks))
    offset[aligned] -= middle if reference is None else _own(reference, level, names)
    time = detections.time - np.round(offset * NS).astype(np.int64)
    notes: list[Note] = []
    if len(clocks) > 1:
        most = max(abs(v - middle) for v in level.values())
        text = f"clocks of {len(clocks)} receivers brought together by the pings they share"
        notes.append(Note("info", f"{text}: they were up to {most:.3g} s off", len(clocks)))
    alone = [str(n) for j, n in enumerate(names) if j not in clocks and heard[j].sum() >= FEW]
    if alone:
        text = "share too few pings with others to compare clocks, which are taken as they are"
        notes.append(Note("info", f"{len(alone)} receivers {text}: {', '.join(alone)}", len(alone)))
    doubtful = [
        str(names[j]) for j, clock in clocks.items() if clock.ambiguous or abs(clock.jump) > JUMP
    ]
    if doubtful:
        text = "regular pings or a jump leave the clocks in doubt of"
        notes.append(Note("warning", f"{text} {', '.join(doubtful)}", len(doubtful)))
    report = detections.report.add(*notes)
    return Detections(time, detections.receiver, detections.tag, dict(detections.extra), report)


def _own(reference: object, level: dict[int, float], names: np.ndarray) -> float:
    """How far the reference's clock is from the one that all were compared with, s."""
    for j, value in level.items():
        if str(names[j]) == str(reference):
            return value
    raise InputError(
        f"reference receiver '{reference}' shares too few pings with the others",
        mend=f"choose one of {', '.join(str(names[j]) for j in level)}",
    )
