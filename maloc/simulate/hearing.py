"""What receivers make of a ping: heard or not, on the direct path or late, with what error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from maloc.errors import InputError

__all__ = ["Arrivals", "Hearing", "hear"]


@dataclass(frozen=True)
class Hearing:
    """How well receivers hear.

    Parameters
    ----------
    p_na : float
        Share of arrivals that is missing at any distance.
    scale : float
        Detection falls with distance d as exp(-d^2 / (2 scale^2)), m; infinity = not at all.
    p_mp : float
        Share of arrivals that comes late, by a detour of Uniform(`detour`) m.
    detour : pair of float
        Shortest and longest detour of a reflected arrival, m.
    noise : {"poisson", "gaussian"}
        "poisson": a Poisson(1) number of milliseconds with a random sign; "gaussian": N(0, `sd`).
    sd : float
        Seconds, for "gaussian".
    resolution : float
        Clocks show multiples of it, s; 0 = they show everything.
    """

    p_na: float = 0.3
    scale: float = np.inf
    p_mp: float = 0.06
    detour: tuple[float, float] = (50.0, 300.0)
    noise: str = "poisson"
    sd: float = 1e-3
    resolution: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("p_na", "p_mp"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} is {getattr(self, name)}, not a share from 0 to 1")
        if self.noise not in ("poisson", "gaussian"):
            raise InputError(f"noise '{self.noise}' is neither poisson nor gaussian")
        if not (self.scale > 0 and self.sd >= 0 and self.resolution >= 0):
            raise InputError("scale must be positive, sd and resolution not negative")
        if not 0 <= self.detour[0] <= self.detour[1]:
            raise InputError(f"detour {self.detour} is not a shortest and a longest length")


class Arrivals(NamedTuple):
    """The parts of each arrival time, all (P, R): ``heard`` bool, the rest seconds.

    ``direct`` is emission plus distance over sound speed, ``late`` the detour of a reflected
    arrival (0 = direct), ``noise`` the error of the receiver.
    """

    heard: np.ndarray
    direct: np.ndarray
    late: np.ndarray
    noise: np.ndarray

    def observed(self, resolution: float, clock_error: np.ndarray | float = 0.0) -> np.ndarray:
        """Return times as a clock that is `clock_error` s ahead shows them; NaN = not heard."""
        time = self.direct + self.late + self.noise + clock_error
        if resolution > 0:
            time = np.rint(time / resolution) / (1 / resolution)  # 12.524, not 12.524000000000001
        return np.where(self.heard, time, np.nan)


def hear(
    rng: np.random.Generator,
    emission: np.ndarray,
    xy: np.ndarray,
    receivers: np.ndarray,
    sound_speed: np.ndarray,
    hearing: Hearing,
) -> Arrivals:
    """Draw what R receivers hear of P pings.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    emission : array (P,)
        Emission times, s.
    xy : array (P, 2)
        Where the tag was, m.
    receivers : array (R, 2)
        Where the receivers stand, m.
    sound_speed : array (P,)
        m/s.
    hearing : Hearing
        Shares, noise and resolution.

    Returns
    -------
    Arrivals
        Each part of each arrival time. Collisions of pings are not simulated.
    """
    distance = np.linalg.norm(xy[:, None] - receivers, axis=2)
    shape = distance.shape
    c = sound_speed[:, None]
    p = (1 - hearing.p_na) * np.exp(-0.5 * (distance / hearing.scale) ** 2)
    late = np.where(rng.random(shape) < hearing.p_mp, rng.uniform(*hearing.detour, shape) / c, 0.0)
    if hearing.noise == "poisson":
        noise = 1e-3 * rng.poisson(1.0, shape) * rng.choice((-1.0, 1.0), shape)
    else:
        noise = hearing.sd * rng.standard_normal(shape)
    return Arrivals(rng.random(shape) < p, emission[:, None] + distance / c, late, noise)
