"""Raw sync detections with known truth, written without any of maloc.sync's own code."""

from typing import NamedTuple

import numpy as np

from maloc.data import Detections, Receivers

ORIGIN = 1_600_000_000 * 10**9


class Truth(NamedTuple):
    detections: Detections
    receivers: Receivers  # true places
    sound_speed: float
    offset: np.ndarray  # (N,) recorded minus true, s, at each detection
    late: np.ndarray  # (N,) bool
    clock: np.ndarray  # (N,) receiver index
    true: np.ndarray  # (N,) true arrival time, s from ORIGIN

    def relative(self, reference: int) -> tuple[np.ndarray, np.ndarray]:
        """Offset (N,) against the reference's clock, and where that clock is known."""
        mine = self.clock == reference
        order = np.argsort(self.true[mine])
        t, o = self.true[mine][order], self.offset[mine][order]
        inside = (self.true >= t[0]) & (self.true <= t[-1])
        return self.offset - np.interp(self.true, t, o), inside


def grid(n: int, spacing: float = 150.0) -> np.ndarray:
    side = int(np.ceil(np.sqrt(n)))
    i = np.arange(n)
    return spacing * np.column_stack([i % side, i // side]).astype(float)


def simulate(
    seed: int,
    n_receivers: int = 6,
    hours: float = 4.0,
    interval: tuple[float, float] = (90.0, 150.0),
    *,
    n_tags: int | None = None,
    offsets: np.ndarray | None = None,
    ppm: float = 20.0,
    curve: float = 0.05,
    reflected: float = 0.15,
    missing: float = 0.30,
    jitter: float = 2e-4,
    rounding: bool = True,
    sound_speed: float = 1480.0,
    self_detections: bool = True,
) -> Truth:
    """Sync tags at the first `n_tags` receivers; daily drift curves of +-`curve` s and more."""
    rng = np.random.default_rng(seed)
    xy = grid(n_receivers) + rng.uniform(-30, 30, (n_receivers, 2))
    n_tags = n_receivers if n_tags is None else n_tags
    if offsets is None:
        offsets = rng.uniform(-100, 100, n_receivers)
        offsets[1:3] += rng.choice([-7200.0, 3600.0, 10800.0], len(offsets[1:3]))
    slope = rng.uniform(-ppm, ppm, n_receivers) * 1e-6
    phase = rng.uniform(0, 2 * np.pi, n_receivers)

    def clock(j: np.ndarray, t: np.ndarray) -> np.ndarray:
        wave = curve * np.sin(2 * np.pi * t / 86400 + phase[j])
        return offsets[j] + slope[j] * t + wave

    columns = []
    for g in range(n_tags):
        n = int(hours * 3600 / np.mean(interval))
        emitted = np.cumsum(rng.uniform(*interval, n))
        for j in range(n_receivers):
            if j == g and not self_detections:
                continue
            heard = rng.random(n) > (missing if j != g else 0.0)
            late = (rng.random(n) < reflected) & (j != g)
            extra = np.where(late, rng.uniform(20, 300, n) / sound_speed, 0.0)
            true = emitted + np.hypot(*(xy[g] - xy[j])) / sound_speed + extra
            direct = true - extra
            columns += [
                (g, j, d, t, q) for d, t, q, h in zip(direct, true, late, heard, strict=True) if h
            ]
    tag, j, direct, true, late = map(np.array, zip(*columns, strict=True))
    offset = clock(j, true)
    recorded = true + offset + jitter * rng.standard_normal(len(true))
    if rounding:
        recorded = np.round(recorded, 3)
    order = np.argsort(recorded, kind="stable")
    tag, j, true, late, offset = tag[order], j[order], true[order], late[order], offset[order]
    names = np.array([f"R{i:03d}" for i in range(n_receivers)])
    ids = np.array([f"A69-1602-{60000 + i}" for i in range(n_tags)])
    time = ORIGIN + np.round(recorded[order] * 1e9).astype(np.int64)
    sync_tag = np.r_[[str(60000 + i) for i in range(n_tags)], [""] * (n_receivers - n_tags)]
    return Truth(
        Detections(time, names[j], ids[tag]),
        Receivers(names, xy[:, 0], xy[:, 1], sync_tag=sync_tag),
        sound_speed,
        offset,
        late,
        j,
        true,
    )
