"""A receiver array with sync tags, clocks that are wrong, drift and jump, and its truth.

Nothing of `maloc.sync` is used here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maloc.data import Detections, Receivers

__all__ = ["SyncArray", "sync_array"]

ORIGIN = 1_600_000_000 * 10**9  # ns since 1970 of true second 0
DAY = 86_400.0


@dataclass(frozen=True, eq=False)
class SyncArray:
    """What `sync_array` made.

    Parameters
    ----------
    detections : Detections
        Of the sync tags, as the receivers' clocks had them.
    receivers : Receivers
        The table, places wrong.
    xy : array (R, 2)
        True places, m.
    clock : array (N,) of int
        Receiver of each detection.
    true : array (N,)
        True arrival time, s from `ORIGIN`.
    offset : array (N,)
        Recorded less true time without the error of the arrival, s.
    steady : array (N,)
        The same without the jumps, s.
    late : array (N,) of bool
        Reflected.
    jump_clock, jump_time, jump_size : array (J,)
        Receiver, true time (s) and size (s) of each jump.
    sound_speed : array (M, 2)
        Time (s) and sound speed (m/s).
    """

    detections: Detections
    receivers: Receivers
    xy: np.ndarray
    clock: np.ndarray
    true: np.ndarray
    offset: np.ndarray
    steady: np.ndarray
    late: np.ndarray
    jump_clock: np.ndarray
    jump_time: np.ndarray
    jump_size: np.ndarray
    sound_speed: np.ndarray

    def relative(self, reference: int) -> np.ndarray:
        """Offset (N,) of each detection against the reference's clock less its jumps, s.

        Where the reference heard nothing its clock is interpolated (a cubic spline).
        """
        from scipy.interpolate import CubicSpline

        mine = np.flatnonzero(self.clock == reference)
        t, first = np.unique(self.true[mine], return_index=True)
        return self.offset - CubicSpline(t, self.steady[mine][first])(self.true)


def sync_array(
    rng: np.random.Generator,
    n_receivers: int = 8,
    days: float = 1.0,
    *,
    interval: tuple[float, float] = (500.0, 700.0),
    spacing: float = 150.0,
    offset: float = 3 * 3600.0,
    drift: float = 60.0,
    reflected: float = 0.15,
    missing: float = 0.30,
    jumps: tuple[int, int] = (2, 4),
    jump_size: tuple[float, float] = (0.02, 3600.0),
    place_sd: float = 1.0,
    speed_wave: float = 2.0,
    jitter: float = 2e-4,
    delay: float = 2e-3,
    resolution: float = 1e-3,
) -> SyncArray:
    """Simulate an array whose receivers each have a sync tag.

    Clocks begin U(-`offset`, `offset`) s wrong and drift by U(-`drift`, `drift`) s a day. They
    swing with the day's warmth by .001 to .05 s (log-uniform: a rate of .07 to 3.6 ppm), and their
    rates walk at random by .017 to .055 ppm in 20 min (log-uniform: `maloc.sync.fit` finds such
    walks in the clocks of a real array, Vemco VR2W in Florida Bay). The sound speed swings with
    the day and drifts.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    n_receivers : int
        R.
    days : float
        Length of the record.
    interval : pair of float
        Intervals of the sync tags are uniform between these, s.
    spacing : float
        Of the jittered grid on which the receivers stand, m.
    offset, drift : float
        s, s a day.
    reflected, missing : float
        Shares of arrivals that come late by 20-300 m, and that nobody hears.
    jumps : pair of int
        Fewest and most jumps of all clocks together.
    jump_size : pair of float
        Smallest and largest size, s, log-uniform, either way.
    place_sd : float
        Error of the table's x and y, m.
    speed_wave : float
        Daily swing of the sound speed, m/s; it drifts by half as much over the record.
    jitter : float
        sd of an arrival's error, s.
    delay : float
        With which a receiver hears its own tag at most, s.
    resolution : float
        Of recorded times, s.

    Returns
    -------
    SyncArray
    """
    side, k = int(np.ceil(np.sqrt(n_receivers))), np.arange(n_receivers)
    xy = spacing * np.column_stack([k % side, k // side])
    xy = xy + rng.uniform(-0.2, 0.2, xy.shape) * spacing
    span = days * DAY
    start = rng.uniform(-offset, offset, n_receivers)
    slope = rng.uniform(-drift, drift, n_receivers) / DAY
    phase = rng.uniform(0, 2 * np.pi, n_receivers)
    swing = np.exp(rng.uniform(np.log(1e-3), np.log(0.05), n_receivers))
    walks = np.exp(rng.uniform(np.log(1.7e-8), np.log(5.5e-8), n_receivers))
    grid = np.arange(0.0, span + 7200.0, 1200.0)
    rate = np.cumsum(walks * rng.standard_normal((len(grid), n_receivers)), axis=0)
    walk = np.cumsum(rate * 1200.0, axis=0)
    n_jumps = int(rng.integers(jumps[0], jumps[1] + 1))
    at_clock = rng.integers(0, n_receivers, n_jumps)
    at_time = np.sort(rng.uniform(0.03 * span, 0.97 * span, n_jumps))
    low, high = np.log(jump_size)
    sizes = rng.choice([-1, 1], n_jumps) * np.exp(rng.uniform(low, high, n_jumps))
    speed = (
        1480.0
        + rng.uniform(-20, 20)
        + speed_wave
        * (
            np.sin(2 * np.pi * grid / DAY + rng.uniform(0, 6.3))
            + rng.uniform(-0.5, 0.5) * grid / span
        )
    )

    from scipy.interpolate import CubicSpline

    wander = CubicSpline(grid, walk, axis=0)

    def steady(j: int, t: np.ndarray) -> np.ndarray:
        wave = swing[j] * np.sin(2 * np.pi * t / DAY + phase[j])
        return start[j] + slope[j] * t + wave + wander(t)[:, j]

    parts = []
    own_delay = rng.uniform(0, delay, n_receivers)
    for g in range(n_receivers):
        emitted = rng.uniform(0, interval[1])
        emitted = emitted + np.cumsum(rng.uniform(*interval, int(span / np.mean(interval)) + 1))
        emitted = emitted[emitted < span]
        c = np.interp(emitted, grid, speed)
        for j in range(n_receivers):
            heard = rng.random(len(emitted)) > (missing if j != g else 0.0)
            late = (rng.random(len(emitted)) < reflected) & (j != g)
            extra = np.where(late, rng.uniform(20, 300, len(emitted)) / c, 0.0)
            true = emitted + np.hypot(*(xy[g] - xy[j])) / c + (own_delay[j] if j == g else 0.0)
            n = int(heard.sum())
            parts.append((np.full(n, g), np.full(n, j), true[heard], (true + extra)[heard],
                          late[heard]))  # fmt: skip
    tag, clock, _, arrived, late = (np.concatenate(p) for p in zip(*parts, strict=True))
    smooth = np.empty(len(tag))
    for j in range(n_receivers):
        smooth[clock == j] = steady(j, arrived[clock == j])
    jumped = np.zeros(len(tag))
    for j, t, size in zip(at_clock, at_time, sizes, strict=True):
        jumped += size * ((clock == j) & (arrived > t))
    recorded = arrived + smooth + jumped + jitter * rng.standard_normal(len(tag))
    recorded = np.round(recorded / resolution) * resolution
    names = np.array([f"R{j:03d}" for j in range(n_receivers)])
    ids = np.array([f"A69-1602-{60000 + g}" for g in range(n_receivers)])
    order = np.lexsort((recorded, clock))
    table = xy + rng.normal(0, place_sd, xy.shape)
    time = ORIGIN + np.round(recorded * 1e9).astype(np.int64)
    return SyncArray(
        Detections(time[order], names[clock[order]], ids[tag[order]]),
        Receivers(names, table[:, 0], table[:, 1], sync_tag=np.array([t[-5:] for t in ids])),
        xy,
        clock[order],
        arrived[order],
        (smooth + jumped)[order],
        smooth[order],
        late[order],
        at_clock,
        at_time,
        sizes,
        np.column_stack([grid, speed]),
    )
