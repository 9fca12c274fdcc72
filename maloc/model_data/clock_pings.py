"""Sync pings as the clock model sees them: arrivals on clocks that are nearly right already."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from maloc._jax import jax
from maloc.errors import InputError

if TYPE_CHECKING:
    from maloc.sync import ClockSync

Numbers = Array | np.ndarray

__all__ = ["SPEED", "ClockPings", "as_clock_pings"]

_STATIC = ["speed_known"]
_HOUR = 3600.0
SPEED = 1500.0  # m/s; middle of the prior of an estimated sound speed
_SLOW = 4  # terms of a slow clock


@dataclasses.dataclass(frozen=True)
class ClockPings:
    """Sync pings by the K knots of the clocks: up to M between a knot and the next one.

    D deployments, C clocks besides the reference's, J jumps. A pytree; the last field is static.

    Attributes
    ----------
    arrival : (K, M, D) ms
        From a ping's `emission` to its arrival, on the common clock of the ClockSync; 0 where not
        heard.
    heard : (K, M, D) bool
        Which arrivals there are.
    emission : (K, M) s
        Emission time on that clock, from its origin.
    weights : (K, M, 4)
        Of offset and rate at the knot and at the next one in a clock's offset: 1, h, 1, h.
    source : (K, M) int
        Deployment beside which a ping was emitted.
    after : (K, M, D, J) bool
        Whether a receiver's clock had made each jump by then.
    speed : (K, M) m/s
        Sound speed of the ClockSync.
    dt : (K - 1,) h
        From each knot to the next.
    offset : (K, C) s
        Offsets of the ClockSync at the knots, jumps taken out.
    curves : (K, 2, C) ms, ms/h
        The same and their rates, less a straight line each.
    noise : (C,) ms/h^1.5
        Standard deviation of a clock's rate after an hour, as the ClockSync has it.
    clock : (D,) int
        Clock of each deployment's receiver; C = the reference's.
    given : (D, 3) m
        Places in the table.
    constants : (3 D + 1 + J,)
        Delays (ms), shifts of places (m; x and y of one after the other), relative deviation of the
        mean sound speed from `SPEED`, sizes of jumps (ms, departures), as the ClockSync has them.
    information : (3 D + 1 + J, 3 D + 1 + J)
        About what the pings tell of them: the Gauss-Newton precision with emission times and
        slow clocks (cubics in time) left open. It scales the model's coordinates, no more.
    start : dict
        Values of parameters at which a fit begins: those of the ClockSync.
    speed_known : bool
        Whether the sound speed was given.
    """

    arrival: Float[Numbers, "knot ping deployment"]
    heard: Bool[Numbers, "knot ping deployment"]
    emission: Float[Numbers, "knot ping"]
    weights: Float[Numbers, "knot ping 4"]
    source: Int[Numbers, "knot ping"]
    after: Bool[Numbers, "knot ping deployment jump"]
    speed: Float[Numbers, "knot ping"]
    dt: Float[Numbers, " step"]
    offset: Float[Numbers, "knot clock"]
    curves: Float[Numbers, "knot 2 clock"]
    noise: Float[Numbers, " clock"]
    clock: Int[Numbers, " deployment"]
    given: Float[Numbers, "deployment 3"]
    constants: Float[Numbers, " constant"]
    information: Float[Numbers, "constant constant"]
    start: dict
    speed_known: bool = True


jax.tree_util.register_dataclass(
    ClockPings,
    data_fields=[f.name for f in dataclasses.fields(ClockPings) if f.name not in _STATIC],
    meta_fields=_STATIC,
)


def as_clock_pings(sync: ClockSync | ClockPings) -> ClockPings:
    """Model arrays of a synchronisation's pings.

    Parameters
    ----------
    sync : ClockSync
        What was fitted; its clocks are where the model begins, and say nothing more.

    Raises
    ------
    InputError
        If no ping is in the fit.
    """
    if isinstance(sync, ClockPings):
        return sync
    from maloc.data import Detections
    from maloc.sync._curve import hermite
    from maloc.sync._prepare import collect

    r, receivers = sync.residuals, sync.receivers
    table, _ = collect(Detections(r.time, r.receiver, r.sync_tag), receivers, sync.origin)
    row = table.row
    keep = sync.synced[table.clock] & (r.ping[row] > 0) & np.isfinite(r.p_direct[row])
    if not keep.any():
        raise InputError("no sync ping is in the fit of the clocks")
    row, n = row[keep], int(keep.sum())
    ping = np.unique(r.ping[row], return_inverse=True)[1]
    here, column = np.unique(np.r_[table.place[keep], table.source[keep]], return_inverse=True)
    place, source, d = column[:n], column[n:], len(here)
    common = table.recorded[keep] - r.offset[row]
    speed = np.interp(common, sync.knots, sync.speeds)
    delay = sync.delay[here]
    direct = common - r.distance[row] / speed - np.where(place == source, delay[place], 0.0)
    weight = r.p_direct[row] + 1e-6
    emission = np.bincount(ping, weight * direct) / np.bincount(ping, weight)

    names = np.array(receivers.names)
    whose = np.array([np.flatnonzero(names == name)[0] for name in receivers.receiver[here]])
    clocks = np.setdiff1d(whose[place], np.flatnonzero(names == sync.reference))
    clock = np.where(np.isin(whose, clocks), np.searchsorted(clocks, whose), len(clocks))
    after = np.zeros((len(emission), d, len(sync.jumps)), bool)
    for j, (name, time) in enumerate(zip(sync.jumps.receiver, sync.jumps.time, strict=True)):
        after[:, names[whose] == name, j] = (emission > time)[:, None]

    at = (emission - sync.knots[0]) / sync.spacing
    knot = np.clip(at.astype(int), 0, len(sync.knots) - 2)
    order = np.argsort(knot, kind="stable")
    count = np.bincount(knot, minlength=len(sync.knots))
    slot = np.empty(len(knot), int)
    slot[order] = np.arange(len(knot)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(sync.knots), -(-int(count.max()) // 4) * 4)

    def by_knot(values: np.ndarray, empty: float = 0.0) -> np.ndarray:
        out = np.full((*shape, *values.shape[1:]), empty, values.dtype)
        out[knot, slot] = values
        return out

    arrival, heard = np.zeros((len(emission), d)), np.zeros((len(emission), d), bool)
    arrival[ping, place], heard[ping, place] = 1e3 * (common - emission[ping]), True
    sent = np.zeros(len(emission), int)
    sent[ping] = source
    h = sync.spacing / _HOUR
    line = np.diff(sync.values[clocks][:, [0, -1]]) / (sync.knots[-1] - sync.knots[0])
    straight = sync.values[clocks][:, :1] + line * (sync.knots - sync.knots[0])
    bent = 1e3 * (sync.values[clocks] - straight), 1e3 * _HOUR * (sync.slopes[clocks] - line)
    noise = 1e3 * _HOUR**1.5 * np.sqrt(np.maximum(sync.noise[clocks], 1e-20))
    jumped = np.zeros(len(sync.jumps))
    off = [sync.sound_speed / SPEED - 1]
    constants = np.concatenate([1e3 * delay, sync.shift[here].ravel(), off, jumped])
    z = receivers.depth if np.isfinite(receivers.depth).all() else np.zeros(len(receivers))
    fitted = np.column_stack([receivers.xy, z])[here]
    time = 2 * (emission - emission.min()) / max(float(np.ptp(emission)), 1.0) - 1
    slow = (clock[place][:, None] == np.arange(len(clocks)))[:, :, None]
    slow = (slow * np.vander(time, _SLOW)[ping][:, None]).reshape(n, -1)
    told = _derivatives(fitted[place] - fitted[source], place, source, d, sync.sound_speed)
    rows = np.column_stack([told, after[ping, place], slow])
    data = ClockPings(
        arrival=by_knot(arrival),
        heard=by_knot(heard),
        emission=by_knot(emission),
        weights=by_knot(hermite(at - knot) * np.array([1.0, h, 1.0, h])),
        source=by_knot(sent),
        after=by_knot(after),
        speed=by_knot(np.interp(emission, sync.knots, sync.speeds), SPEED),
        dt=np.full(len(sync.knots) - 1, h),
        offset=sync.values[clocks].T,
        curves=np.stack([b.T for b in bent], axis=1),
        noise=noise,
        clock=clock,
        given=fitted - np.pad(sync.shift[here], ((0, 0), (0, 1))),
        constants=constants,
        information=_information(rows, ping, weight / (1e3 * sync.sigma) ** 2, slow.shape[1]),
        start={
            "clock_noise": noise,
            "sigma": np.asarray(1e3 * sync.sigma),
            "w": np.asarray(np.clip(sync.reflected, 1e-3, 0.5)),
            "constants": np.zeros(len(constants)),
        },
        speed_known=bool((sync.speeds_sd == 0).all()),
    )
    return jax.device_put(data)


def _derivatives(
    between: np.ndarray, place: np.ndarray, source: np.ndarray, d: int, speed: float
) -> np.ndarray:
    """Derivatives (N, 3 D + 1) of arrivals (ms) to delays, shifts and relative sound speed."""
    own = place == source
    distance = np.linalg.norm(between, axis=1)
    toward = 1e3 / speed * between[:, :2] / np.maximum(distance, 1e-9)[:, None]
    heard, sent = (np.eye(d)[k] for k in (place, source))
    shift = (heard - sent)[:, :, None] * toward[:, None]
    slower = -1e3 * distance / speed
    return np.column_stack([heard * own[:, None], shift.reshape(len(place), -1), slower])


def _information(rows: np.ndarray, ping: np.ndarray, weight: np.ndarray, n_open: int) -> np.ndarray:
    """Precision of all but the last columns, with these and a constant a ping left open."""
    total = np.bincount(ping, weight)
    mean = np.zeros((len(total), rows.shape[1]))
    np.add.at(mean, ping, weight[:, None] * rows)
    off = rows - (mean / total[:, None])[ping]
    whole = off.T @ (weight[:, None] * off)
    k = len(whole) - n_open
    return whole[:k, :k] - whole[:k, k:] @ np.linalg.pinv(whole[k:, k:]) @ whole[k:, :k]
