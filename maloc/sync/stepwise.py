"""The clocks one part at a time, as kaltoa does it: the joint model with its other parts held.

First the curves of the clocks with places and sound speed as given, then a constant a clock, then
the places, each with everything else held. `maloc.sync.fit` does all at once, which is better.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from maloc.data import Detections, Receivers
from maloc.errors import InputError
from maloc.sync import _model
from maloc.sync._fit import fit
from maloc.sync._outcome import outcome
from maloc.sync._prepared import prepare
from maloc.sync._search import Dated
from maloc.sync.clocks import ClockSync

__all__ = ["fit_clock_drift", "fit_clock_offsets", "fit_receiver_positions"]


def fit_clock_drift(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: float = 1500.0,
    reference: object = None,
) -> ClockSync:
    """Fit the clocks' curves and jumps, places and sound speed as given.

    Parameters
    ----------
    detections, receivers, reference
        As in `maloc.sync.fit`.
    sound_speed : float
        m/s.
    """
    return fit(
        detections, receivers, sound_speed=sound_speed, reference=reference, free_positions=0.0
    )


def fit_clock_offsets(
    sync: ClockSync, detections: Detections, *, estimate_sound_speed: bool = False
) -> ClockSync:
    """Fit one constant a clock, the curves' shapes and the places held.

    Parameters
    ----------
    sync : ClockSync
    detections : Detections
        Raw, as it was fitted to.
    estimate_sound_speed : bool
        Else it is held too.
    """
    return _refit(sync, detections, np.zeros(len(sync.receivers)), estimate_sound_speed)


def fit_receiver_positions(
    sync: ClockSync,
    detections: Detections,
    *,
    ref_receivers: Sequence[object] = (),
    sd: float = 1.0,
    estimate_sound_speed: bool = True,
) -> ClockSync:
    """Fit the places and one constant a clock, the curves' shapes held.

    Parameters
    ----------
    sync : ClockSync
    detections : Detections
        Raw, as it was fitted to.
    ref_receivers : sequence of str
        Receivers whose places are known; at least two hold shift and rotation of the array.
    sd : float
        Prior sd of x and y of the others about where they are now, m.
    estimate_sound_speed : bool

    Raises
    ------
    InputError
        If a reference is not among the receivers.
    """
    known = [str(name) for name in ref_receivers]
    if unknown := [name for name in known if name not in sync.receivers.names]:
        raise InputError(f"reference receiver '{unknown[0]}' is not among the receivers")
    free = np.where(np.isin(sync.receivers.receiver, known), 0.0, sd)
    return _refit(sync, detections, free, estimate_sound_speed)


def _refit(sync: ClockSync, detections: Detections, free: np.ndarray, estimate: bool) -> ClockSync:
    p = prepare(
        detections, sync.receivers, sound_speed="constant" if estimate else sync.sound_speed,
        reference=sync.reference, knot_spacing=sync.spacing, free_positions=free,
    )  # fmt: skip
    grid = _model.Grid(float(sync.knots[0]), sync.spacing, len(sync.knots))
    state = np.nan_to_num(np.stack([sync.values.T, sync.slopes.T * sync.spacing], axis=-1))
    number = {name: i for i, name in enumerate(sync.receivers.names)}
    clock = np.array([number[str(name)] for name in sync.jumps.receiver], int)
    order, segment = np.zeros(len(clock), int), np.zeros(len(p.common), int)
    for j in np.unique(clock):
        own = np.flatnonzero(clock == j)
        order[own] = np.argsort(np.argsort(sync.jumps.time[own]))
        mine = p.arrivals.receiver == j
        segment[mine] = np.searchsorted(np.sort(sync.jumps.time[own]), p.common[mine])
    jumps = _model.Jumps(clock, order, sync.jumps.size)
    arrivals = p.arrivals._replace(segment=segment)
    start = _model.Start(state, jumps, reflected=sync.reflected, intensity=sync.noise + 1e-20)
    geometry = p.geometry._replace(sound_speed=sync.sound_speed)
    fitted = _model.solve(
        arrivals, geometry, start, grid, p.grouped.reference, varying=False, held=True
    )
    q = sync.jumps
    dated = Dated(fitted.end.jumps, q.low, q.high, q.time, q.time)
    p = dataclasses.replace(p, arrivals=arrivals, grid=grid, state=state, geometry=geometry)
    return outcome(p, arrivals, fitted, dated, 0)
