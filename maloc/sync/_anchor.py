"""The common time put right by moments at which the true time is known."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import numpy as np

from maloc.data import Note
from maloc.errors import InputError
from maloc.sync._clocks import Clocks
from maloc.sync._locate import offset_of

__all__ = ["anchored"]

HOUR = 3600.0

C = TypeVar("C", bound=Clocks)


def anchored(sync: C, receiver: object, recorded: object, true: object) -> C:
    """See `maloc.sync.ClockSync.anchored`."""
    recorded = np.atleast_1d(np.asarray(recorded, np.int64))
    true = np.atleast_1d(np.asarray(true, np.int64))
    if recorded.shape != true.shape:
        raise InputError(f"{recorded.size} recorded times, but {true.size} true ones")
    name = np.broadcast_to(np.asarray(receiver, dtype=str), recorded.shape)
    offset = offset_of(sync, name, recorded)
    known = np.isfinite(offset)
    if not known.any():
        raise InputError(
            "no anchor is of a synchronised receiver",
            mend=f"give moments of {', '.join(np.array(sync.receivers.names)[sync.synced])}",
        )
    ahead = ((recorded - true) * 1e-9 - offset)[known]  # common less true time
    common = ((recorded - sync.origin) * 1e-9 - offset)[known]
    slope = 0.0
    if np.ptp(common) > HOUR:
        middle = common.mean()
        slope = float(((common - middle) * ahead).sum() / ((common - middle) ** 2).sum())
    level = float(np.mean(ahead - slope * common))
    rest = float(np.abs(ahead - level - slope * common).max())

    # exact, because a line maps equally spaced knots to such: true = common - level - slope common
    def moved(time: np.ndarray) -> np.ndarray:
        return time - level - slope * time

    faster = 1 / (1 - slope)
    jumps = dataclasses.replace(
        sync.jumps, **{n: moved(getattr(sync.jumps, n)) for n in ("time", "low", "high")}
    )
    line = level + slope * sync.knots
    residuals = dataclasses.replace(
        sync.residuals,
        offset=sync.residuals.offset
        + level
        + slope * ((sync.residuals.time - sync.origin) * 1e-9 - sync.residuals.offset),
    )
    lost = int((~known).sum())
    also = f" ({lost} more are of no synchronised receiver, or of when it is not)" if lost else ""
    text = (
        f"common time put right by {int(known.sum())} moments of known true time{also}: by "
        f"{-level:+.4g} s at the first detection and {-86_400 * slope:+.3g} s a day; they agree "
        f"within {rest:.2g} s"
    )
    return dataclasses.replace(
        sync,
        knots=moved(sync.knots),
        values=sync.values + line,
        slopes=(sync.slopes + slope) * faster,
        value_draws=sync.value_draws + line,
        slope_draws=(sync.slope_draws + slope) * faster,
        jumps=jumps,
        span=moved(sync.span),
        residuals=residuals,
        notes=(*sync.notes, Note("info", text, int(known.sum()))),
    )
