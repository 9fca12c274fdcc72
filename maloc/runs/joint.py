"""What `maloc track --model joint` reads and fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from maloc.readers.sequence import read_sequence
from maloc.runs.depth import with_depth
from maloc.runs.fit_encounters import FittedTags, run_model, tables
from maloc.runs.load import load, read_shore
from maloc.runs.load_encounters import Encounters
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.sound import with_sound

__all__ = ["fit_joint"]


def fit_joint(options: TrackOptions, log: Log) -> tuple[FittedTags, Encounters]:
    """Read what is asked for, and fit all tags in the joint model.

    Raises
    ------
    InputError
        Bad input, or the schedule does not fit the detections.
    FitError
        If the fit fails.
    """
    source = with_sound(with_depth(load(options, log), options, log), options, log)
    water = read_shore(options, source.receivers, log)
    log.release()
    with log.stage("engine start"):  # JAX is imported here, and nowhere before
        from maloc import models
        from maloc.data import arrival_history

    sequence = None if options.schedule_file is None else read_sequence(options.schedule_file)
    with log.stage("group"):
        history = arrival_history(source.toas, sequence=sequence)
    asked = options.sound_speed
    how: dict[str, Any] = {
        "movement": options.movement,
        "arrivals": "ddetect" if options.error == "auto" else options.error,
        "detection": options.detection,
        "loss": options.loss and history.silence != "unknown",
        "dispersion": options.dispersion,
        "receiver_effects": options.receiver_effects,
        "sound_speed": asked if asked in ("estimated", "drifting") else "auto",
        "positions": options.positions,
    }
    if history.silence == "unknown":
        log.notice("no burst interval is known: pings that nobody heard are not counted")
    fit = run_model(models.joint, (history, *water), how, options, log)
    fitted = tables(fit, history.encounters, options, log)
    states = np.flatnonzero(np.asarray(fit.args[0].ping)[: fit.n_states])
    late = tuple(np.asarray(x, float)[states] for x in (fit.residuals(), fit.p_direct()))
    read = Encounters(fitted.history, source.receivers, source.detections)
    return replace(fitted, late=late), read
