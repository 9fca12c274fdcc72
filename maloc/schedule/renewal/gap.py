"""One gap: the nodes of its path, and which form it is computed in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from maloc.errors import InputError
from maloc.schedule.intervals import IntervalLaw, Stable, Table
from maloc.schedule.renewal.grid import Grid, grid_of
from maloc.schedule.renewal.long import ENDS

__all__ = [
    "Gap",
    "KINDS",
    "adiabatic",
    "away",
    "end_of",
    "gap_nodes",
    "is_long",
    "is_narrow",
    "kind_code",
    "knots",
    "needed",
]

KINDS = ("inside", "before", "after")
_NARROW = 0.06  # sd / mean below which counts are summed
_LONG, _PHASE = 10.0, 0.36


@dataclass(frozen=True)
class Gap:
    """One gap: a stretch in which pings may have been missed.

    Parameters
    ----------
    kind : {"inside", "before", "after"}
        Between two heard pings, from the tag's start to its first heard ping, from the last heard
        ping to the end.
    duration : float
        Seconds.
    nodes : (K,) array
        Seconds after the gap's start, as `gap_nodes` gives them: heard pings included.
    states : (K,) array of int
        State of the chain at each node.
    first_at_start : bool
        Kind "before": the tag was switched on at the gap's start.

    Raises
    ------
    InputError
        If the kind is none of these, or the numbers do not fit together.
    """

    kind: str
    duration: float
    nodes: np.ndarray = field(default_factory=lambda: np.empty(0))
    states: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    first_at_start: bool = False

    def __post_init__(self) -> None:
        _checked(self.kind, self.duration)
        if len(self.nodes) != len(self.states):
            raise InputError(f"a gap has {len(self.nodes)} nodes and {len(self.states)} states")
        if np.any(np.diff(self.nodes) <= 0):
            raise InputError("a gap's nodes are not in order of time")


def _checked(kind: str, duration: float) -> None:
    if kind not in KINDS:
        raise InputError(f"gap of kind '{kind}' is not inside, before or after")
    if not (np.isfinite(duration) and duration >= 0):
        raise InputError(f"a gap of {duration:g} s is not zero or more")


def _knot_step(law: IntervalLaw) -> tuple[float, float]:
    """Earliest knot after a heard ping and the distance of knots, s."""
    if isinstance(law, Table) and not is_narrow(law):
        grid = grid_of(law)
        return grid.start, grid.path_step
    return law.mean, law.mean


def is_narrow(law: IntervalLaw) -> bool:
    """Whether counts are summed: the interval hardly varies."""
    return isinstance(law, Stable) or law.sd < _NARROW * law.mean


def is_long(law: IntervalLaw, duration) -> np.ndarray:
    """Whether the adiabatic form serves: the gap has forgotten the phase of its first ping."""
    return np.asarray(duration) > max(_LONG, _PHASE * (law.mean / law.sd) ** 2) * law.mean


def gap_nodes(duration: float, kind: str, law: IntervalLaw, *, most: int = 64) -> np.ndarray:
    """Times in a gap at which the path is needed.

    Parameters
    ----------
    duration : float
        Seconds.
    kind : {"inside", "before", "after"}
        See `Gap`.
    law : IntervalLaw
    most : int
        Most nodes between the ends.

    Returns
    -------
    (K,) array
        Seconds after the gap's start, ascending, the heard pings at its ends included (their states
        are in the chain anyway); about one shortest interval apart, evenly spaced if that would
        need more than `most`; empty where no ping can have been missed.

    Raises
    ------
    InputError
        If the kind or the duration is not as above.
    """
    _checked(kind, duration)
    start, step = _knot_step(law)
    if duration <= (2 * law.lo if kind == "inside" else law.lo) or duration == 0:
        return np.empty(0)
    at = start + step * np.arange(max(round((duration - start) / step), 1))
    at = at[(at > 0.5 * min(start, step)) & (at < duration - 0.5 * min(step, duration - start))]
    if len(at) > most:
        at = duration * np.arange(1, most + 1) / (most + 1)
    at = np.concatenate([[0.0], at, [duration]])
    return duration - at[::-1] if kind == "before" else at


def away(gap: Gap) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and states of a gap by time away from a heard ping (backward if kind "before")."""
    if gap.kind == "before":
        return gap.duration - np.asarray(gap.nodes)[::-1], np.asarray(gap.states)[::-1]
    return np.asarray(gap.nodes, float), np.asarray(gap.states)


def end_of(law: Table | Stable, kind: str, first_at_start: bool):
    """What closes a gap: function of the time since the last missed ping, breaks, reach."""
    if kind == "inside":
        return law.density, law.breaks, law.hi
    if kind == "after":
        return law.survival, law.breaks, law.hi if law.expiry == 0 else np.inf
    breaks = law.first_breaks(first_at_start)
    return lambda x: law.first_density(x, first_at_start), breaks, breaks[-1]


def needed(gap: Gap, law: Table, grid: Grid) -> int:
    """Nodes of the grid that a gap needs."""
    last = gap.duration - (law.lo if gap.kind == "inside" else 0.0)
    return int(np.ceil((last - grid.start) / grid.step - 1e-9)) + 1


def knots(gap: Gap, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left and right state and share of the way at times away from the heard ping."""
    nodes, states = away(gap)
    if len(nodes) == 1:
        return np.full(len(at), states[0]), np.full(len(at), states[0]), np.zeros(len(at))
    k = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return states[k], states[k + 1], (at - nodes[k]) / (nodes[k + 1] - nodes[k])


def adiabatic(gap: Gap, law: Table) -> bool:
    """Whether a gap is computed in the adiabatic form."""
    return bool(is_long(law, gap.duration)) and not (law.expiry and gap.kind == "after")


def kind_code(gap: Gap) -> int:
    """Place of the gap's kind in `maloc.schedule.renewal.long.ENDS`."""
    return ENDS.index((gap.kind, gap.kind == "before" and gap.first_at_start))
