"""Sync detections to pings: one emission of one sync tag, as heard by several receivers."""

from __future__ import annotations

import numpy as np

__all__ = ["associate"]


def associate(
    tag: np.ndarray, receiver: np.ndarray, emission: np.ndarray, gap: float
) -> tuple[np.ndarray, np.ndarray]:
    """Group detections whose emission times agree.

    Parameters
    ----------
    tag, receiver : array (N,) of int
    emission : array (N,)
        Arrival time on the common clock minus the travel time from the sync tag, s.
    gap : float
        Two detections of a tag further apart than this, with none between, are of two pings, s.

    Returns
    -------
    ping : array (N,) of int
        Ping of each detection, numbered from 0 by tag, then time.
    first : array (N,) of bool
        Whether it is the earliest arrival of its ping at its receiver; the others are echoes.
    """
    order = np.lexsort((emission, tag))
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(tag[order]) != 0) | (np.diff(emission[order]) > gap)
    ping = np.empty(len(order), int)
    ping[order] = np.cumsum(new) - 1
    by_receiver = np.lexsort((emission, receiver, ping))
    first = np.ones(len(order), bool)
    p, r = ping[by_receiver], receiver[by_receiver]
    first[by_receiver[1:]] = (np.diff(p) != 0) | (np.diff(r) != 0)
    return ping, first
