"""From raw detections to a ClockSync."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.data._time import NS
from maloc.errors import FitError, InputError
from maloc.sync import _arrivals, _model
from maloc.sync._coarse import FEW
from maloc.sync._curve import to_common
from maloc.sync._outcome import outcome
from maloc.sync._prepare import Curve, Grouped, SyncData, alignment_notes, collect, group
from maloc.sync._progress import Tell, progress_bar, silent
from maloc.sync._search import fit_with_jumps
from maloc.sync._speed import Speed, speed_of
from maloc.sync.clocks import ClockSync

__all__ = ["fit", "prepare"]

UNFIT = 0.7  # a receiver with a larger share of arrivals that do not fit is not synchronised


def fit(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: Any = "varying",
    reference: object = None,
    knot_spacing: float = 1800.0,
    free_positions: Any = 1.0,
    seed: int = 0,
    progress: bool = True,
) -> ClockSync:
    """Synchronise all receivers' clocks from the sync tags beside some of them.

    All sync arrivals are fitted at once: a clock curve per receiver and its jumps, the sound
    speed, the receivers' places and every emission time; late (reflected) arrivals get no weight.
    Clocks may be hours off, drift by up to a minute a day, and jump by 20 ms or more.

    Parameters
    ----------
    detections : Detections
        Raw, of any tags; those of sync tags are used.
    receivers : Receivers
        With `sync_tag` (a number, or a full id) where one is co-located. A row whose receiver
        heard nothing may stand for a sync tag alone (a reference tag).
    sound_speed : float, "varying", "constant", or table
        m/s. "varying": estimated, and followed through the day as far as the pings show it;
        "constant": one estimated number; both with a prior of 1500 +- 50 m/s. A table (a data
        frame, or the path of a CSV file) has columns time and sound_speed, or temperature,
        salinity and depth (see `maloc.medium.with_sound_speed`).
    reference : str, optional
        Receiver whose clock becomes the common time. By default one among those that agree best
        (at the half-sample mode of all clocks halfway through the record): clocks that were set
        right agree with each other, and wrong ones err each in its own way. Sync tags compare
        clocks with each other and never with true time: name the receiver whose clock was right
        if it is known, or use `ClockSync.anchored`, when times must be compared with, say, a GPS.
    knot_spacing : float
        Largest distance between knots of the clock curves, s.
    free_positions : float, or array (D,)
        Prior sd of each deployment's x and y about the table, m; 0 = the table is exact. The
        default of 1 m is less than the error of a common GPS fix (2-5 m), so that the table is
        kept unless many pings speak against it, yet enough for places some metres off to give way:
        held places push their errors into clocks and sound speed. What the pings cannot tell
        (shift and rotation of the whole array) stays as in the table. With free places the scale
        of the array and the sound speed trade off; `sound_speed_sd` says how far.
    seed : int
        For the posterior draws of the clocks.
    progress : bool
        Show a progress bar on stderr, if it takes longer than a second.

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
    sync tags); Bickel & Fruehwirth (2006), Computational Statistics & Data Analysis 50:3500 (the
    half-sample mode); MacKay (1992), Neural Computation 4:415 (the update of the clock noise).
    """
    with progress_bar(progress) as tell:
        p = prepare(
            detections, receivers, sound_speed=sound_speed, reference=reference,
            knot_spacing=knot_spacing, free_positions=free_positions, tell=tell,
        )  # fmt: skip
        try:
            arrivals, fitted, dated = fit_with_jumps(
                p.arrivals, p.common, p.grouped.jumps, p.state, p.geometry, p.grid,
                p.grouped.reference, varying=p.speed.varying, tell=tell,
            )  # fmt: skip
        except np.linalg.LinAlgError as error:
            raise FitError(
                f"the clock model diverged ({error}); are the receivers' places and sync tags "
                "right?"
            ) from error
    return outcome(p, arrivals, fitted, dated, seed)


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Everything that a joint fit needs, and what its outcome is told with.

    Parameters
    ----------
    detections : Detections
    receivers : Receivers
    origin : int
        ns since 1970 of second 0.
    data : SyncData
    grouped : Grouped
    used : array (U,) of int
        Rows of `data` that are in the fit, in the order of `arrivals`.
    arrivals : Arrivals
    common : array (U,)
        Coarse common times, s.
    state : array (K, R, 2)
        Coarse clocks at the knots.
    geometry : Geometry
    grid : Grid
    speed : Speed
    notes : tuple of Note
    """

    detections: Detections
    receivers: Receivers
    origin: int
    data: SyncData
    grouped: Grouped
    used: np.ndarray
    arrivals: _arrivals.Arrivals
    common: np.ndarray
    state: np.ndarray
    geometry: _arrivals.Geometry
    grid: _model.Grid
    speed: Speed
    notes: tuple[Note, ...]


def prepare(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: Any,
    reference: object,
    knot_spacing: float,
    free_positions: Any,
    tell: Tell = silent,
) -> Prepared:
    """Check, pick the sync detections, align them coarsely and lay the joint fit out."""
    if len(detections) == 0:
        raise InputError("no detections to synchronise")
    if len(detections.receivers) == 1:
        only = detections.receivers[0]
        raise InputError(f"1 receiver ({only}) in the detections: no clock to compare it with")
    if not (np.isfinite(knot_spacing) and knot_spacing >= 10.0):
        raise InputError(f"knot_spacing must be at least 10, got {knot_spacing}")
    names, sd = receivers.names, np.asarray(free_positions, float)
    if not (np.isfinite(sd).all() and (sd >= 0).all()):
        raise InputError(f"free_positions must be at least 0, got {free_positions}")
    if sd.ndim and sd.shape != (len(receivers),):
        raise InputError(
            f"free_positions has shape {sd.shape}, not one number for each of the "
            f"{len(receivers)} rows of the receivers' table"
        )
    if reference is not None and str(reference) not in names:
        raise InputError(
            f"reference receiver '{reference}' is not in the receivers' table",
            mend=f"choose one of {', '.join(names)}",
        )
    origin = int(detections.time.min()) // NS * NS
    speed = speed_of(sound_speed, origin, int(detections.time.max()))
    data, notes = collect(detections, receivers, origin)
    xyz = _coordinates(receivers)
    travel = _arrivals.distances(xyz, data.place, data.source) / speed.mean
    asked = None if reference is None else names.index(str(reference))
    grouped = group(data, travel, asked, len(names), tell)
    notes += tuple(alignment_notes(data, grouped.clocks, names))
    used = np.flatnonzero(grouped.why == "")
    ref = grouped.reference
    if len(grouped.clocks) < 2 or len(used) == 0:
        raise FitError(
            f"no clock could be aligned with that of receiver {names[ref]}: no sync ping was "
            "heard by two receivers at an offset within 26 h; check sync_tag in the receivers' "
            "table"
        )
    if ref not in grouped.clocks:
        raise FitError(
            f"the clock of the reference receiver {names[ref]} could not be aligned with the "
            f"others; choose one of {', '.join(names[j] for j in sorted(grouped.clocks))}"
        )
    used = used[np.lexsort((data.clock[used], grouped.ping[used]))]
    common = grouped.common[used]
    grid = _grid(common, knot_spacing)
    arrivals = _arrivals.Arrivals(
        data.recorded[used],
        data.clock[used],
        np.unique(grouped.ping[used], return_inverse=True)[1],
        data.place[used],
        data.source[used],
        grouped.segment[used],
    )
    geometry = _arrivals.Geometry(
        xyz, np.broadcast_to(sd, (len(receivers),)), speed.mean, speed.sd, speed.at(grid.time)
    )
    state = _start(grouped.curves, len(names), grid)
    return Prepared(
        detections, receivers, origin, data, grouped, used, arrivals, common, state, geometry,
        grid, speed, notes,
    )  # fmt: skip


def _coordinates(receivers: Receivers) -> np.ndarray:
    """Places (D, 3); depth counts only where it is known everywhere."""
    z = receivers.depth if np.isfinite(receivers.depth).all() else np.zeros(len(receivers))
    return np.column_stack([receivers.xy, z])


def _grid(common: np.ndarray, most: float) -> _model.Grid:
    first, last = float(common.min()) - 1.0, float(common.max()) + 1.0
    n = max(1, int(np.ceil((last - first) / most)))
    return _model.Grid(first, (last - first) / n, n + 1)


def _start(curves: dict[int, Curve], n_clocks: int, grid: _model.Grid) -> np.ndarray:
    """State (K, R, 2) at the knots from the coarse offsets; 0 for clocks without one."""
    state = np.zeros((grid.n, n_clocks, 2))
    for j, curve in curves.items():
        state[:, j, 0] = curve.at(grid.time)
        half = grid.spacing / 2
        state[:, j, 1] = curve.at(grid.time + half) - curve.at(grid.time - half)
    return state


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
