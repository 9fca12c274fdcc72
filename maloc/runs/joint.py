"""What `maloc track --model joint` does, from options to a finished folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from maloc.errors import InputError
from maloc.runs.depth import with_depth
from maloc.runs.encounters import FittedTags, run_model, tables
from maloc.runs.load import TrackOptions, load, read_shore
from maloc.runs.load_encounters import Encounters
from maloc.runs.log import Log

__all__ = ["fit_joint", "read_sequence"]


def read_sequence(path: Path) -> np.ndarray:
    """Burst intervals of a tag in their order, s: one number a line, a heading at most.

    Raises
    ------
    InputError
        If the file cannot be read, a line is no positive number, or there are none.
    """
    try:
        rows = path.read_text(encoding="utf-8-sig").split("\n")
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"cannot be read: {problem}", file=path) from None
    found = []
    for i, text in enumerate(rows, 1):
        if not (cell := text.strip().strip(",;")):
            continue
        try:
            value = float(cell)
        except ValueError:
            if not found and i == 1:
                continue  # a heading
            value = float("nan")
        if not (np.isfinite(value) and value > 0):
            raise InputError(
                f"'{cell}' is no burst interval", file=path, row=i, mend="give seconds, one a line"
            )
        found.append(value)
    if not found:
        raise InputError("holds no burst intervals", file=path)
    return np.array(found)


def fit_joint(options: TrackOptions, log: Log) -> tuple[FittedTags, Encounters]:
    """Read what is asked for, and fit all tags in the joint model.

    Raises
    ------
    InputError
        Bad input, or the schedule does not fit the detections.
    FitError
        If the fit fails.
    """
    source = with_depth(load(options, log), options, log)
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
        "arrivals": options.error,
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
