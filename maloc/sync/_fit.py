"""From raw detections to a ClockSync."""

from __future__ import annotations

from typing import Any

import numpy as np

from maloc.data import Detections, Receivers
from maloc.errors import FitError
from maloc.sync._outcome import outcome
from maloc.sync._prepared import prepare
from maloc.sync._progress import progress_bar
from maloc.sync._search import fit_with_jumps
from maloc.sync.clocks import ClockSync

__all__ = ["fit"]


def fit(
    detections: Detections,
    receivers: Receivers,
    *,
    sound_speed: Any = "varying",
    sound_speed_sd: float = 0.0,
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
    sound_speed_sd : float
        Of a number: standard deviation of its error, m/s, and one speed is estimated with that
        prior; 0 = exact.
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
            detections, receivers, sound_speed=sound_speed, sound_speed_sd=sound_speed_sd,
            reference=reference, knot_spacing=knot_spacing, free_positions=free_positions,
            tell=tell,
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
