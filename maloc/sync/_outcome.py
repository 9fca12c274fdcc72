"""From a fitted clock model to a ClockSync and what is to be said of it."""

from __future__ import annotations

import dataclasses

import numpy as np

from maloc.data import Note
from maloc.sync import _arrivals, _blocks, _model
from maloc.sync._coarse import FEW
from maloc.sync._curve import to_common
from maloc.sync._locate import TWICE, UNSURE, locate
from maloc.sync._model import Solution
from maloc.sync._prepare import ECHO, JUMPED
from maloc.sync._prepared import Prepared
from maloc.sync._search import Dated
from maloc.sync._tables import jump_text
from maloc.sync.clocks import ClockJumps, ClockSync, SyncResiduals

__all__ = ["outcome"]

LATE, WILD = "late: reflected", "early or wild"
UNFIT = 0.7  # a receiver with a larger share of arrivals that do not fit is not synchronised
UNSURE_SPEED = 15.0  # m/s
DRAWS = 20


def outcome(
    p: Prepared, a: _arrivals.Arrivals, fitted: Solution, dated: Dated, seed: int
) -> ClockSync:
    """Make the ClockSync."""
    names, used, why = p.receivers.names, p.used, p.grouped.why.copy()
    data, ping, ref = p.data, p.grouped.ping, p.grouped.reference
    xyz = fitted.xyz
    residual, direct = np.full(len(why), np.nan), np.full(len(why), np.nan)
    offset = np.full(len(why), np.nan)
    residual[used], direct[used] = fitted.residual, fitted.p_direct
    offset[used] = data.recorded[used] - fitted.common
    rest = np.flatnonzero((why == ECHO) & (ping >= 0))
    residual[rest] = residuals_of_the_rest(p, fitted, rest)
    doubtful = used[direct[used] < 0.5]
    why[doubtful] = np.where(residual[doubtful] > 0, LATE, WILD)
    bad, more = unfit(data.clock[used], direct[used], ref, names)
    good = np.isin(np.arange(len(names)), data.clock[used]) & ~bad
    state, spacing = fitted.end.state, p.grid.spacing
    place_used = np.isin(np.arange(len(p.receivers)), np.r_[data.place[used], data.source[used]])
    shift = np.where(place_used[:, None], xyz[:, :2] - p.geometry.xyz[:, :2], 0.0)
    order = np.argsort(data.row)
    number = ping[order] + 1
    residuals = SyncResiduals(
        data.row[order],
        number,
        np.array(data.tags)[data.tag[order]],
        np.array(names)[data.clock[order]],
        p.detections.time[data.row[order]],
        _arrivals.distances(xyz, data.place, data.source)[order],
        offset[order],
        residual[order],
        direct[order],
        why[order],
    )
    jumps = ClockJumps(
        np.array(names)[dated.jumps.clock] if len(dated.jumps.clock) else np.empty(0, "U1"),
        0.5 * (dated.before + dated.after),
        dated.low,
        dated.high,
        dated.jumps.size,
        fitted.jump_sd,
    )
    draws, jump_draws = _draws(fitted, seed)
    blank = np.where(good, 0.0, np.nan)[:, None]
    sync = ClockSync(
        receivers=dataclasses.replace(
            p.receivers, x=p.receivers.x + shift[:, 0], y=p.receivers.y + shift[:, 1]
        ),
        reference=names[ref],
        origin=p.origin,
        knots=p.grid.time,
        values=state[:, :, 0].T + blank,
        slopes=state[:, :, 1].T / spacing + blank,
        values_sd=fitted.state_sd[:, :, 0].T + blank,
        noise=fitted.end.intensity if fitted.end.intensity is not None else np.zeros(len(names)),
        covariance=_covariance(fitted, dated, p.grid.first, spacing, len(names)),
        jumps=jumps,
        speeds=fitted.speed,
        speeds_sd=fitted.speed_sd,
        span=_spans(fitted.common, data.clock[used], why[used], len(names)),
        sigma=fitted.sigma,
        reflected=fitted.reflected,
        delay=fitted.delay,
        delay_sd=fitted.delay_sd,
        position_sd=np.where(place_used[:, None], fitted.xy_sd, 0.0),
        shift=shift,
        residuals=residuals,
        value_draws=draws[..., 0].transpose(0, 2, 1) + blank,
        slope_draws=draws[..., 1].transpose(0, 2, 1) / spacing + blank,
        jump_draws=jump_draws,
        notes=p.notes + tuple(more),
    )
    sync = dataclasses.replace(sync, residuals=_decided(sync))
    return dataclasses.replace(sync, notes=sync.notes + tuple(_remarks(sync, fitted, p)))


def _decided(sync: ClockSync) -> SyncResiduals:
    """Residuals, without offsets of late or wild arrivals that a jump leaves open when they were.

    A direct arrival shows by itself on which side of a jump it lies.
    """
    r = sync.residuals
    status = locate(sync, r.receiver, r.time).status
    open_ = np.isin(r.why, [LATE, WILD]) & np.isin(status, [UNSURE, TWICE])
    why = r.why.copy()
    why[open_] = JUMPED
    return dataclasses.replace(r, offset=np.where(open_, np.nan, r.offset), why=why)


def _covariance(
    fitted: Solution, dated: Dated, first: float, spacing: float, n_clocks: int
) -> np.ndarray:
    """Covariance (M, 4, 4) of offset and slope times spacing at both ends of every interval.

    Intervals of a clock follow each other, those with a jump once for each side of it.
    """
    step, layout = fitted.step, fitted.layout
    n_knots = len(step.knots)
    number = {int(c): i for i, c in enumerate(layout.free)}
    columns = slice(layout.parts[1].start, layout.parts[2].stop)  # jumps, then constants
    border = step.border_cov[columns, columns]
    middle = 0.5 * (dated.before + dated.after)
    at = np.clip(((middle - first) / spacing).astype(int), 0, n_knots - 2)
    level = np.array([1.0, 0.0, 1.0, 0.0])
    out = []
    for j in range(n_clocks):
        own = np.flatnonzero(dated.jumps.clock == j)
        own = own[np.argsort(dated.jumps.order[own])]
        edges = [0, *np.maximum.accumulate(at[own]).tolist(), n_knots - 2]
        for n, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            rows = np.arange(a, b + 1)
            cov = np.zeros((len(rows), 4, 4))
            mixed = np.zeros((len(rows), 4, len(border)))
            if j in number:
                i = slice(2 * number[j], 2 * number[j] + 2)
                cov[:, :2, :2], cov[:, 2:, 2:] = step.cov[rows, i, i], step.cov[rows + 1, i, i]
                cov[:, :2, 2:] = step.cross[rows, i, i]
                cov[:, 2:, :2] = cov[:, :2, 2:].swapaxes(1, 2)
                mixed[:, :2] = step.cov_border[rows, i, columns]
                mixed[:, 2:] = step.cov_border[rows + 1, i, columns]
            past = np.isin(np.arange(len(border)), own[:n]).astype(float)
            if layout.held and j in number:
                past[len(dated.jumps.clock) + number[j]] = 1.0
            both = (mixed @ past)[:, :, None] * level
            cov += both + both.swapaxes(1, 2) + (past @ border @ past) * np.outer(level, level)
            out.append(cov)
    return np.concatenate(out)


def _draws(fitted: Solution, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Posterior draws of the state (S, K, R, 2) and of the jumps (S, J)."""
    rng = np.random.default_rng(seed)
    step, layout = fitted.step, fitted.layout
    n_knots, n = step.knots.shape
    border = np.linalg.cholesky(step.border_cov) @ rng.standard_normal((len(step.border), DRAWS))
    knots = _blocks.draw(step.factor, rng.standard_normal((n_knots, n, DRAWS)))
    knots = (knots - step.through @ border)[:, : 2 * len(layout.free)]
    state = np.repeat(fitted.end.state[None], DRAWS, axis=0)
    state[:, :, layout.free] += knots.transpose(2, 0, 1).reshape(DRAWS, n_knots, -1, 2)
    if layout.held:
        state[:, :, layout.free, 0] += border[layout.parts[2]].T[:, None]
    jumps = fitted.end.jumps.size + border[layout.parts[1]].T
    return state, jumps


def _spans(common: np.ndarray, clock: np.ndarray, why: np.ndarray, n_clocks: int) -> np.ndarray:
    span = np.full((n_clocks, 2), np.nan)
    for j in range(n_clocks):
        mine = common[(clock == j) & (why == "")]
        if len(mine):
            span[j] = mine.min(), mine.max()
    return span


def _remarks(sync: ClockSync, fitted: Solution, p: Prepared) -> list[Note]:
    notes = []
    text = f"common time is the clock of receiver {sync.reference} ({p.grouped.reason})"
    if p.grouped.reason != "asked for":
        text += "; whether it was right cannot be known from sync tags, reference= chooses another"
    notes.append(Note("info", text))
    for j in range(len(sync.jumps)):
        notes.append(Note("warning", jump_text(sync, j)))
    own = np.flatnonzero(np.abs(sync.delay) > 3 * np.maximum(sync.delay_sd, 1e-9))
    if len(own):
        each = [f"{sync.receivers.labels[d]} {1e3 * sync.delay[d]:+.2f} ms" for d in own]
        text = "receivers hear the sync tag beside them with a delay, which is taken off"
        notes.append(Note("info", f"{text}: {', '.join(each)}", len(own)))
    if not fitted.converged:
        text = f"the clock fit had not settled after {fitted.rounds} rounds"
        notes.append(Note("warning", text))
    if sync.sound_speed_sd > UNSURE_SPEED:
        text = (
            f"the sync pings hardly tell the sound speed ({sync.sound_speed:.0f} +- "
            f"{sync.sound_speed_sd:.0f} m/s); --sound-speed (sound_speed= in Python) gives it"
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


def residuals_of_the_rest(p: Prepared, fitted: _model.Solution, rest: np.ndarray) -> np.ndarray:
    """Residuals of arrivals outside the fit whose ping is in it (echoes), s."""
    lead = fitted.end.jumps.lead(p.data.clock[rest], p.grouped.segment[rest])
    common = to_common(
        fitted.end.state, p.grid.first, p.grid.spacing, p.data.clock[rest],
        p.data.recorded[rest] - lead,
    )  # fmt: skip
    way = _arrivals.distances(fitted.xyz, p.data.place[rest], p.data.source[rest])
    travel = way / np.interp(common, p.grid.time, fitted.speed)
    pings = np.unique(p.grouped.ping[p.used])
    return common - travel - fitted.emission[np.searchsorted(pings, p.grouped.ping[rest])]


def unfit(
    clock: np.ndarray, p_direct: np.ndarray, reference: int, names: tuple[str, ...]
) -> tuple[np.ndarray, list[Note]]:
    """Receivers (R,) whose arrivals mostly do not fit, so that their clock is not believed."""
    total = np.bincount(clock, minlength=len(names))
    bad = np.bincount(clock, p_direct < 0.5, minlength=len(names))
    share = bad / np.maximum(total, 1)
    out = (total >= FEW) & (share > UNFIT)
    out[reference] = False
    notes = []
    for j in np.flatnonzero((total >= FEW) & (share > 0.5)):
        end = "its clock is not used" if out[j] else "kept"
        text = (
            f"receiver {names[j]}: {bad[j]:.0f} of {total[j]} sync arrivals do not fit (wrong "
            f"place, wrongly aligned clock, or seldom a direct path); {end}"
        )
        notes.append(Note("warning", text, int(bad[j])))
    return out, notes
