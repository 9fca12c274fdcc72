"""What models of arrival times see of them, whether a state is a heard ping or more."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Array, Bool, Float

Numbers = Array | np.ndarray

__all__ = ["ArrivalData", "Numbers"]


@dataclasses.dataclass(frozen=True)
class ArrivalData:
    """Arrivals of T pings, or states, at R receivers, and what is known of their medium.

    Attributes
    ----------
    range : (T, R) m
        Reference sound speed x (arrival - first arrival of the ping); 0 where not heard.
    heard : (T, R) bool
        Which receivers' arrival times count.
    speed : (T,) m/s
        Reference sound speed.
    speed_sd : ()
        Relative standard deviation of the sound speed, for models that estimate it.
    receiver_xy : (R, 2) m
        Receiver positions.
    centre : (2,) m
        Middle of the receivers that heard something.
    spread : () m
        Standard deviation of the first position around it, and of a ping's range.
    phi : () m
        Largest lateness of a reflected arrival.
    n_intervals : (T - 1,)
        Burst intervals from one to the next; 0 where not known.
    interval : (2,) s
        MIN, MAX (random schedule); MEAN, SD (stable, sequence).
    """

    range: Float[Numbers, "ping receiver"]
    heard: Bool[Numbers, "ping receiver"]
    speed: Float[Numbers, " ping"]
    speed_sd: Float[Numbers, ""]
    receiver_xy: Float[Numbers, "receiver 2"]
    centre: Float[Numbers, 2]
    spread: Float[Numbers, ""]
    phi: Float[Numbers, ""]
    n_intervals: Float[Numbers, " step"]
    interval: Float[Numbers, 2]

    @property
    def interval_known(self):
        """Where the number of burst intervals to the next is known, (T - 1,) bool."""
        return self.n_intervals > 0
