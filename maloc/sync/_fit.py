"""From raw detections to a ClockSync."""

from __future__ import annotations

import dataclasses

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import FitError, InputError
from maloc.sync import _arrivals, _model
from maloc.sync._coarse import FEW, CoarseClock
from maloc.sync._curve import to_common
from maloc.sync._prepare import ECHO, SELF, SyncData, alignment_notes, collect, group, most_shared
from maloc.sync.clocks import NS, ClockSync, SyncResiduals

__all__ = ["fit"]

DEFAULT_SPEED, SPEED_SD = 1500.0, 50.0  # prior of the sound speed, m/s
UNFIT = 0.7  # a receiver with a larger share of arrivals that do not fit is not synchronised
UNSURE_SPEED = 15.0  # m/s
LATE, WILD = "late: reflected", "early or wild"


def fit(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: float | None = None,
    reference: object = None,
    knot_spacing: float = 1800.0,
    free_positions: float = 1.0,
    self_detections: bool = False,
) -> ClockSync:
    """Synchronise all receivers' clocks from the sync tags beside some of them.

    All sync arrivals are fitted at once: a clock curve per receiver, one sound speed, the
    receivers' places and every emission time; late (reflected) arrivals get no weight. Clocks may
    be hours off and drift by up to a minute a day. A clock that jumps is synchronised over its
    longest stretch without a jump, and the rest is set aside.

    Parameters
    ----------
    detections : Detections
        Raw, of any tags; those of sync tags are used.
    receivers : Receivers
        With `sync_tag` (a number, or a full id) where one is co-located.
    sound_speed : float, optional
        m/s. Without it, it is estimated with a prior of 1500 +- 30 m/s.
    reference : str, optional
        Receiver whose clock becomes the common time. By default the one that shares most sync
        detections with the others. Sync tags compare clocks with each other and never with true
        time: choose the receiver whose clock was right when times must be compared with, say, a
        GPS.
    knot_spacing : float
        Largest distance between knots of the clock curves, s.
    free_positions : float
        Prior sd of each receiver's x and y about the table, m; 0 = the table is exact. The default
        of 1 m is less than the error of a common GPS fix (2-5 m), so that the table is kept
        unless many pings speak against it, yet enough for places some metres off to give way: held
        places push their errors into clocks and sound speed. What the pings cannot tell (shift and
        rotation of the whole array) stays as in the table. With free places the scale of the array
        and the sound speed trade off; `sound_speed_sd` says how far.
    self_detections : bool
        Let a receiver's detections of its own sync tag (distance 0) count. They often carry a
        delay of their own, so by default they do not.

    Returns
    -------
    ClockSync

    Raises
    ------
    InputError
        If there are no sync tags, none was heard, or an argument makes no sense.
    FitError
        If clocks cannot be aligned or the fit does not settle.

    References
    ----------
    Baktoft et al. (2017), Scientific Reports 7:14294 (joint estimation of clocks and places from
    sync tags); MacKay (1992), Neural Computation 4:415 (the update of the clock noise).
    """
    if len(detections) == 0:
        raise InputError("no detections to synchronise")
    for name, value, lowest in (
        ("sound_speed", sound_speed, 300.0),
        ("knot_spacing", knot_spacing, 10.0),
        ("free_positions", free_positions, 0.0),
    ):
        if value is not None and not (np.isfinite(value) and value >= lowest):
            raise InputError(f"{name} must be at least {lowest:g}, got {value}")
    names = receivers.names
    if reference is not None and str(reference) not in names:
        raise InputError(
            f"reference receiver '{reference}' is not in the receivers' table",
            mend=f"choose one of {', '.join(names)}",
        )
    origin = int(detections.time.min()) // NS * NS
    data, notes = collect(detections, receivers, origin)
    ref = most_shared(data, len(names)) if reference is None else names.index(str(reference))
    speed = DEFAULT_SPEED if sound_speed is None else float(sound_speed)

    xyz = _coordinates(receivers)
    travel = _arrivals.distances(xyz, data.place, data.source) / speed
    clocks, ping, common, why = group(data, travel, ref, len(names), self_detections)
    notes += tuple(alignment_notes(data, clocks, names))
    used = np.flatnonzero(why == "")
    if len(clocks) < 2 or len(used) == 0:
        raise FitError(
            f"no clock could be aligned with that of receiver {names[ref]}: no sync ping was "
            "heard by two receivers at an offset within 26 h; check sync_tag in the receivers' "
            "table, or choose another reference"
        )
    first, spacing, n_knots = _knots(common[used], knot_spacing)
    start = _start(clocks, len(names), first, spacing, n_knots)
    number = np.unique(ping[used], return_inverse=True)[1]
    arrivals = _arrivals.Arrivals(
        data.recorded[used], data.clock[used], number, data.place[used], data.source[used]
    )
    speed_sd = SPEED_SD if sound_speed is None else 0.0
    geometry = _arrivals.Geometry(xyz, float(free_positions), speed, speed_sd)
    try:
        fitted = _model.solve(arrivals, geometry, start, first, spacing, ref)
    except np.linalg.LinAlgError as error:
        raise FitError(
            f"the clock model diverged ({error}); are the receivers' places and sync tags right?"
        ) from error

    residual, p_direct = np.full(len(why), np.nan), np.full(len(why), np.nan)
    residual[used], p_direct[used] = fitted.residual, fitted.p_direct
    _judge(data, why, ping, used, fitted, residual, first, spacing)
    doubtful = used[p_direct[used] < 0.5]
    why[doubtful] = np.where(residual[doubtful] > 0, LATE, WILD)
    unfit, more = _unfit(data.clock[used], p_direct[used], ref, names)
    notes += tuple(more)
    heard_by = np.isin(np.arange(len(names)), data.clock[used]) & ~unfit
    values = np.where(heard_by, fitted.state[:, :, 0], np.nan).T
    slopes = np.where(heard_by, fitted.state[:, :, 1] / spacing, np.nan).T
    order = np.argsort(data.row)
    place_used = np.isin(np.arange(len(receivers)), np.r_[data.place[used], data.source[used]])
    shift = np.where(place_used[:, None], fitted.xyz[:, :2] - xyz[:, :2], 0.0)
    residuals = SyncResiduals(
        data.row[order],
        ping[order] + 1,
        np.array(data.tags)[data.tag[order]],
        np.array(names)[data.clock[order]],
        detections.time[data.row[order]],
        _arrivals.distances(fitted.xyz, data.place, data.source)[order],
        residual[order],
        p_direct[order],
        why[order],
    )
    sync = ClockSync(
        receivers=dataclasses.replace(
            receivers, x=receivers.x + shift[:, 0], y=receivers.y + shift[:, 1]
        ),
        reference=names[ref],
        sound_speed=float(fitted.sound_speed),
        sound_speed_sd=float(fitted.sound_speed_sd),
        origin=origin,
        knots=first + spacing * np.arange(n_knots),
        values=values,
        slopes=slopes,
        values_sd=np.where(heard_by, fitted.state_sd[:, :, 0], np.nan).T,
        span=_spans(common, data.clock, why, len(names)),
        jumped=np.array([j in clocks and clocks[j].jump != 0 for j in range(len(names))]),
        sigma=fitted.sigma,
        reflected=fitted.reflected,
        position_sd=np.where(place_used[:, None], fitted.xy_sd, 0.0),
        shift=shift,
        residuals=residuals,
        notes=notes,
    )
    return dataclasses.replace(sync, notes=notes + tuple(_remarks(sync, fitted, reference)))


def _coordinates(receivers: Receivers) -> np.ndarray:
    """Places (D, 3); depth counts only where it is known everywhere."""
    z = receivers.depth if np.isfinite(receivers.depth).all() else np.zeros(len(receivers))
    return np.column_stack([receivers.xy, z])


def _knots(common: np.ndarray, most: float) -> tuple[float, float, int]:
    first, last = float(common.min()) - 1.0, float(common.max()) + 1.0
    n = max(1, int(np.ceil((last - first) / most)))
    return first, (last - first) / n, n + 1


def _start(
    clocks: dict[int, CoarseClock], n_clocks: int, first: float, spacing: float, n_knots: int
) -> np.ndarray:
    """State (K, R, 2) at the knots from the coarse offsets; 0 for clocks without one."""
    knots = first + spacing * np.arange(n_knots)
    state = np.zeros((n_knots, n_clocks, 2))
    for j, clock in clocks.items():

        def at(common: np.ndarray, clock: CoarseClock = clock) -> np.ndarray:
            offset = clock.at(common)
            for _ in range(3):
                offset = clock.at(common + offset)
            return offset

        state[:, j, 0] = at(knots)
        state[:, j, 1] = at(knots + spacing / 2) - at(knots - spacing / 2)
    return state


def _judge(
    data: SyncData,
    why: np.ndarray,
    ping: np.ndarray,
    used: np.ndarray,
    fitted: _model.Solution,
    residual: np.ndarray,
    first: float,
    spacing: float,
) -> None:
    """Residuals of arrivals outside the fit whose ping is in it (self-detections, echoes)."""
    rest = np.flatnonzero(np.isin(why, [SELF, ECHO]) & (ping >= 0))
    common = to_common(fitted.state, first, spacing, data.clock[rest], data.recorded[rest])
    travel = (
        _arrivals.distances(fitted.xyz, data.place[rest], data.source[rest]) / fitted.sound_speed
    )
    pings = np.unique(ping[used])
    residual[rest] = common - travel - fitted.emission[np.searchsorted(pings, ping[rest])]


def _spans(common: np.ndarray, clock: np.ndarray, why: np.ndarray, n_clocks: int) -> np.ndarray:
    span = np.full((n_clocks, 2), np.nan)
    for j in range(n_clocks):
        mine = common[(clock == j) & (why == "")]
        if len(mine):
            span[j] = mine.min(), mine.max()
    return span


def _unfit(
    clock: np.ndarray, p_direct: np.ndarray, reference: int, names: tuple[str, ...]
) -> tuple[np.ndarray, list[Note]]:
    """Receivers (R,) whose arrivals mostly do not fit, so that their clock is not believed."""
    total = np.bincount(clock, minlength=len(names))
    bad = np.bincount(clock, p_direct < 0.5, minlength=len(names))
    share = bad / np.maximum(total, 1)
    unfit = (total >= FEW) & (share > UNFIT)
    unfit[reference] = False
    notes = []
    for j in np.flatnonzero((total >= FEW) & (share > 0.5)):
        end = "its clock is not used" if unfit[j] else "kept"
        text = (
            f"receiver {names[j]}: {bad[j]:.0f} of {total[j]} sync arrivals do not fit (wrong "
            f"place, jumping or wrongly aligned clock, or seldom a direct path); {end}"
        )
        notes.append(Note("warning", text, int(bad[j])))
    return unfit, notes


def _remarks(sync: ClockSync, fitted: _model.Solution, asked: object) -> list[Note]:
    r = sync.residuals
    notes = []
    reason = "asked for" if asked is not None else "it shares most sync detections with the others"
    text = f"common time is the clock of receiver {sync.reference} ({reason})"
    if asked is None:
        text += "; whether it was right cannot be known from sync tags, reference= chooses another"
    notes.append(Note("info", text))
    own = r.why == SELF
    if own.any():
        late = r.residual[own & np.isfinite(r.residual)]
        middle = (
            f", {1e3 * np.median(late):+.2f} ms from the fit in the median" if len(late) else ""
        )
        text = (
            f"{int(own.sum())} detections by receivers of their own sync tag do not count{middle}"
        )
        notes.append(Note("info", text, int(own.sum())))
    if not fitted.converged:
        text = f"the clock fit had not settled after {fitted.rounds} rounds"
        notes.append(Note("warning", text))
    if sync.sound_speed_sd > UNSURE_SPEED:
        text = (
            f"the sync pings hardly tell the sound speed ({sync.sound_speed:.0f} +- "
            f"{sync.sound_speed_sd:.0f} m/s); sound_speed= gives it"
        )
        notes.append(Note("warning", text))
    far = np.hypot(*sync.shift.T) > 3.0
    if far.any():
        moved = [
            f"{sync.receivers.labels[d]} by {np.hypot(*sync.shift[d]):.1f} m"
            for d in np.flatnonzero(far)
        ]
        text = f"fitted more than 3 m from the table: {', '.join(moved)}"
        notes.append(Note("warning", text, int(far.sum())))
    return notes
