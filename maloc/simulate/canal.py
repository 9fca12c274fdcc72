"""The thesis's simulation study: fish in a canal's array, missing and late arrivals at will."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.data.arrivals import ArrivalTimes, Schedule
from maloc.data.receivers import Receivers
from maloc.errors import InputError
from maloc.simulate import arrays
from maloc.simulate.animals import correlated_walk
from maloc.simulate.hearing import Hearing, hear
from maloc.simulate.pings import burst_times, sound_speed_walk
from maloc.simulate.simulation import Truth

__all__ = ["CanalDesign", "canal_receivers", "simulate_canal"]


@dataclass(frozen=True)
class CanalDesign:
    """What is simulated, apart from the array and the shares of missing and late arrivals.

    Parameters
    ----------
    n_pings : int
    lo, hi : float
        Burst intervals are Uniform(lo, hi) s (the thesis's: Vemco's V13-P).
    noise : {"gaussian", "poisson"}
        Arrival errors: N(0, `sd`), or a Poisson(1) number of milliseconds with a random sign.
    sd : float
        Seconds.
    resolution : float
        Clocks show multiples of it, s.
    detour : pair of float
        Late arrivals come by a detour of Uniform(`detour`) m.
    p0, scale : float
        Half-normal detection p0 exp(-d^2 / (2 scale^2)), scale in m (infinity: the same at any
        distance); what it leaves is thinned by the share of missing arrivals.
    drift_sd, drift_time : float
        The logarithm of the scale is a stationary Gauss-Markov process: its standard deviation,
        and the time (s) after which its correlation is 1 / e.
    margin : float
        Fish roam the array's bounding box widened by this, m.
    in_water : bool
        Fish keep to the water of `maloc.simulate.arrays.canal` instead, between its receivers.
    speed, turn : float
        Of the correlated random walk: mean speed, m/s, and the standard deviation of its change of
        heading in a second, radians.
    sound_speed, sound_speed_rate : float
        m/s at the start, and its random walk in m/s per square root second; known to the models.

    Raises
    ------
    InputError
        If a number makes no sense.
    """

    n_pings: int = 250
    lo: float = 20.6
    hi: float = 36.6
    noise: str = "gaussian"
    sd: float = 0.3e-3
    resolution: float = 1e-3
    detour: tuple[float, float] = (50.0, 300.0)
    p0: float = 1.0
    scale: float = np.inf
    drift_sd: float = 0.0
    drift_time: float = 3600.0
    margin: float = 60.0
    in_water: bool = False
    speed: float = 0.15
    turn: float = 0.135
    sound_speed: float = 1450.0
    sound_speed_rate: float = 0.07

    def __post_init__(self) -> None:
        if self.n_pings < 2:
            raise InputError(f"{self.n_pings} pings are no track")
        if not 0 < self.p0 <= 1:
            raise InputError(f"p0 is {self.p0}, not a chance above 0")
        if self.drift_sd < 0 or self.drift_time <= 0 or self.margin < 0:
            raise InputError("the drift's sd or the margin is negative, or its time not positive")
        if not self.scale > 0:
            raise InputError(f"the detection's scale is {self.scale} m, not positive")
        self.hearing(0.0)
        _ = self.schedule

    @property
    def schedule(self) -> Schedule:
        """The tag's burst interval."""
        return Schedule("random", self.lo, self.hi)

    def hearing(self, p_mp: float) -> Hearing:
        """What the receivers make of a ping, were all arrivals heard."""
        return Hearing(
            p_na=0.0,
            p_mp=p_mp,
            detour=self.detour,
            noise=self.noise,
            sd=self.sd,
            resolution=self.resolution,
        )


def canal_receivers() -> Receivers:
    """Twelve receivers along both banks of an invented bend (`maloc.simulate.arrays.canal`)."""
    array = arrays.canal()
    return Receivers(np.array(array.name), array.xy[:, 0], array.xy[:, 1])


def simulate_canal(
    rng: np.random.Generator,
    p_na: float,
    p_mp: float,
    receivers: Receivers | None = None,
    design: CanalDesign | None = None,
) -> tuple[ArrivalTimes, Truth]:
    """Simulate one track's arrival times.

    The same generator gives the same track, noise and detours whatever the shares, and an arrival
    that is missing (or late) at one share is so at all larger ones: cells differ by nothing else.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    p_na, p_mp : float
        Shares of missing and of late arrivals.
    receivers : Receivers, optional
        The array; `canal_receivers` by default.
    design : CanalDesign, optional
        All the rest.

    Returns
    -------
    toa : ArrivalTimes
        On one clock; every ping has a row, heard or not.
    truth : Truth
        Emission times and positions.

    References
    ----------
    Section 4.4 of the thesis on cleaning fish tracks in the Albert Canal (Ghent University), which
    compares YAPS (Baktoft et al. 2017) with positioning, outlier and Kalman filters.
    """
    design = CanalDesign() if design is None else design
    receivers = canal_receivers() if receivers is None else receivers
    emission = burst_times(rng, design.n_pings, design.schedule)
    if design.in_water:
        room = np.asarray(arrays.canal().water)
    else:
        low, high = receivers.xy.min(0) - design.margin, receivers.xy.max(0) + design.margin
        room = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    start = receivers.xy[rng.integers(len(receivers))]
    at = (float(start[0]), float(start[1]))
    xy = correlated_walk(rng, emission, room, design.speed, design.turn, at)
    speed = sound_speed_walk(rng, emission, design.sound_speed, design.sound_speed_rate)
    arrivals = hear(rng, emission, xy, receivers.xy, speed, design.hearing(p_mp))
    distance = np.linalg.norm(xy[:, None] - receivers.xy, axis=2)
    scale = design.scale * np.exp(_drift(rng, emission, design))
    near = design.p0 * np.exp(-0.5 * (distance / scale[:, None]) ** 2)
    heard = rng.random(distance.shape) < (1 - p_na) * near
    toa = ArrivalTimes(
        arrivals._replace(heard=heard).observed(design.resolution),
        receivers,
        speed,
        schedule=design.schedule,
    )
    ping = np.arange(1, design.n_pings + 1)
    return toa, Truth(ping, emission, xy[:, 0], xy[:, 1], heard.sum(axis=1))


def _drift(rng: np.random.Generator, time: np.ndarray, design: CanalDesign) -> np.ndarray:
    """Logarithm of the detection range over its median at each time, (P,)."""
    kept = np.exp(-np.diff(time) / design.drift_time)
    out = design.drift_sd * rng.standard_normal(len(time))
    for k in range(len(kept)):
        out[k + 1] = kept[k] * out[k] + np.sqrt(1 - kept[k] ** 2) * out[k + 1]
    return out
