"""What a synchronisation keeps of its detections, and of the jumps of clocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["ClockJumps", "SyncResiduals"]


@dataclass(frozen=True, repr=False, eq=False)
class SyncResiduals:
    """Every sync detection and how it fits, arrays (N,) in the order of the detections' table.

    Parameters
    ----------
    row : int
        Row of the detections' table.
    ping : int
        Sync ping, numbered from 1 in time order; 0 = in none.
    sync_tag, receiver : str
    time : int64
        Recorded time, ns since 1970.
    distance : float
        From the sync tag to the receiver, at the fitted places, m.
    offset : float
        Recorded less common time, s; NaN = in no ping of the fit.
    residual : float
        Arrival less expected arrival on the common clock, s; NaN = in no ping of the fit.
    p_direct : float
        Posterior probability that the arrival came by the direct path; NaN = not in the fit.
    why : str
        Why it was left out or does not count; "" = used.
    """

    row: np.ndarray
    ping: np.ndarray
    sync_tag: np.ndarray
    receiver: np.ndarray
    time: np.ndarray
    distance: np.ndarray
    offset: np.ndarray
    residual: np.ndarray
    p_direct: np.ndarray
    why: np.ndarray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def used(self) -> np.ndarray:
        """Whether an arrival counts (N,)."""
        return np.asarray(self.why == "")

    def __repr__(self) -> str:
        return f"SyncResiduals: {len(self)} sync detections, {int(self.used.sum())} used"


@dataclass(frozen=True, eq=False)
class ClockJumps:
    """Jumps of clocks, arrays (J,).

    Parameters
    ----------
    receiver : str
    time : float
        Common time, s from the origin: midway between the sync detections around it.
    low, high : float
        Between which it lies for sure, s: two sync detections of the receiver.
    size, size_sd : float
        By how much the clock stepped forward, s.
    """

    receiver: np.ndarray
    time: np.ndarray
    low: np.ndarray
    high: np.ndarray
    size: np.ndarray
    size_sd: np.ndarray

    def __len__(self) -> int:
        return len(self.time)
