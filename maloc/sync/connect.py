"""Who hears whose sync tag, how long it takes, and in which order pairs could be synchronised."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import Detections, Receivers
from maloc.errors import InputError
from maloc.sync._prepare import collect

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Connectivity", "SyncOrder", "connectivity", "find_sync_order", "latency", "sync_pair"]


@dataclass(frozen=True, eq=False)
class Connectivity:
    """How often receivers heard each other's sync tags.

    Parameters
    ----------
    receivers : Receivers
    heard : array (R, R) of int
        Row: the receiver beside which the tag is, column: the one that heard it, both in the order
        of `receivers.names`.
    """

    receivers: Receivers
    heard: np.ndarray

    @property
    def links(self) -> np.ndarray:
        """Detections of each pair in both directions (R, R); the diagonal is 0."""
        both = self.heard + self.heard.T
        np.fill_diagonal(both, 0)
        return both

    @property
    def total(self) -> np.ndarray:
        """Links of each receiver, summed over the array (R,)."""
        return self.links.sum(axis=0)


def connectivity(detections: Detections, receivers: Receivers) -> Connectivity:
    """Count the detections of sync tags by pair of receivers.

    Parameters
    ----------
    detections : Detections
        Raw or synchronised, of any tags.
    receivers : Receivers
        With `sync_tag`.

    Returns
    -------
    Connectivity
    """
    origin = int(detections.time.min()) if len(detections) else 0
    data, _ = collect(detections, receivers, origin)
    number = {name: i for i, name in enumerate(receivers.names)}
    beside = np.array([number[r] for r in receivers.receiver], int)
    heard = np.zeros((len(number), len(number)), int)
    np.add.at(heard, (beside[data.source], data.clock), 1)
    return Connectivity(receivers, heard)


@dataclass(frozen=True)
class SyncOrder:
    """Pairs of receivers in the order in which they would be synchronised one by one.

    The joint fit (`maloc.sync.fit`) needs no order; this says how an array hangs together.

    Parameters
    ----------
    pairs : tuple of (str, str)
        Controller, whose clock is taken, and target, whose clock is put right.
    """

    pairs: tuple[tuple[str, str], ...]

    def __add__(self, other: SyncOrder) -> SyncOrder:
        return SyncOrder(self.pairs + tuple(p for p in other.pairs if p not in self.pairs))

    def fill(self, found: Connectivity) -> SyncOrder:
        """Add the receivers that are not yet reached, the best connected first."""
        reached = [name for pair in self.pairs for name in pair]
        return self + _grown(list(dict.fromkeys(reached)), found)


def sync_pair(controller: object, target: object) -> SyncOrder:
    """Make an order of one controller and one target, or several; join orders with ``+``."""
    listed = isinstance(target, Iterable) and not isinstance(target, str)
    targets = list(target) if listed else [target]  # pyright: ignore[reportArgumentType]
    return SyncOrder(tuple((str(controller), str(t)) for t in targets))


def find_sync_order(found: Connectivity, controllers: object = None) -> SyncOrder:
    """Find an order that reaches every receiver by its strongest links (Prim's algorithm).

    Parameters
    ----------
    found : Connectivity
    controllers : str or sequence of str, optional
        Where to begin; the best connected receiver if not given.

    Raises
    ------
    InputError
        If a controller is not among the receivers.
    """
    names = found.receivers.names
    if controllers is None:
        begin = [names[int(found.total.argmax())]]
    else:
        begin = [str(c) for c in np.atleast_1d(np.asarray(controllers, dtype=str))]
    for name in begin:
        if name not in names:
            raise InputError(f"controller '{name}' is not among the receivers")
    return _grown(begin, found)


def _grown(begin: list[str], found: Connectivity) -> SyncOrder:
    names, links = found.receivers.names, found.links
    reached, pairs = [names.index(name) for name in begin], []
    while len(reached) < len(names):
        rest = [i for i in range(len(names)) if i not in reached]
        part = links[np.ix_(reached, rest)]
        i, j = np.unravel_index(int(part.argmax()), part.shape)
        if part[i, j] == 0:
            break  # what is left heard nobody that is reached
        pairs.append((names[reached[i]], names[rest[j]]))
        reached.append(rest[j])
    return SyncOrder(tuple(pairs))


def latency(
    detections: Detections, receivers: Receivers, *, within: float = 1.0, sound_speed: float = 1500
) -> pl.DataFrame:
    """Time from a receiver's own detection of its sync tag to that of another receiver.

    Parameters
    ----------
    detections : Detections
        Synchronised; or raw, to see how clocks drift apart as long as they are nearer than
        `within`.
    receivers : Receivers
    within : float
        Detections further from the emission than this are not of it, s.
    sound_speed : float
        m/s, for the expected latency.

    Returns
    -------
    DataFrame
        A row a pair of detections: sync_tag, emitter, receiver, time (UTC, of the emitter's
        detection), latency, expected and error = latency less expected (s).
    """
    import polars as pl

    origin = int(detections.time.min()) if len(detections) else 0
    data, _ = collect(detections, receivers, origin)
    distance = np.linalg.norm(receivers.xy[data.place] - receivers.xy[data.source], axis=1)
    own = data.place == data.source
    kept, sent = [], []
    for tag in range(len(data.tags)):
        mine = np.flatnonzero((data.tag == tag) & own)
        mine = mine[np.argsort(data.recorded[mine])]
        others = np.flatnonzero((data.tag == tag) & ~own)
        if not len(mine) or not len(others):
            continue
        emitted = data.recorded[mine]
        right = np.clip(np.searchsorted(emitted, data.recorded[others]), 1, max(len(mine) - 1, 1))
        right = np.minimum(right, len(mine) - 1)
        left = np.maximum(right - 1, 0)
        nearer = np.abs(data.recorded[others] - emitted[left]) <= np.abs(
            data.recorded[others] - emitted[right]
        )
        at = np.where(nearer, left, right)
        ok = np.abs(data.recorded[others] - emitted[at]) <= within
        kept.append(others[ok])
        sent.append(mine[at[ok]])
    row = np.concatenate(kept) if kept else np.zeros(0, int)
    emission = np.concatenate(sent) if sent else np.zeros(0, int)
    took = data.recorded[row] - data.recorded[emission]
    expected = distance[row] / sound_speed
    return pl.DataFrame(
        {
            "sync_tag": np.array(data.tags, dtype=str)[data.tag[row]].tolist(),
            "emitter": receivers.receiver[data.source[row]].astype(str).tolist(),
            "receiver": receivers.receiver[data.place[row]].astype(str).tolist(),
            "time": pl.Series(detections.time[data.row[emission]]).cast(pl.Datetime("ns", "UTC")),
            "latency": took,
            "expected": expected,
            "error": took - expected,
        }
    ).sort("time")
