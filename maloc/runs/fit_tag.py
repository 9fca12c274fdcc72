"""From one tag's arrival times to a fit and its table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._mirror import Line, mirror_line
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import ArrivalTimes, Receivers

__all__ = ["Fitted", "fit_tag"]


@dataclass(frozen=True)
class Fitted:
    """A fitted tag: its arrival times, the fit, the table of track.csv, the mirror line."""

    toa: ArrivalTimes
    fit: Any
    table: pl.DataFrame
    line: Line | None = None


def fit_tag(
    toa: ArrivalTimes, options: TrackOptions, receivers: Receivers, log: Log, water: tuple = ()
) -> Fitted:
    """Fit one tag's track.

    Parameters
    ----------
    toa : ArrivalTimes
        Checked by `load`.
    options : TrackOptions
        What to fit, and how.
    receivers : Receivers
        As given, to see whether they stand on one line.
    log : Log
        Takes warnings and seconds.
    water : tuple
        One `maloc.habitat.Water`, or none.

    Raises
    ------
    FitError
        If the fit fails.
    """
    with log.stage("engine start"):  # JAX is imported here, and nowhere before
        from maloc import infer, models
        from maloc.infer.track import gaps_outside, track_table

    heard = np.unique(toa.receivers.receiver[toa.heard.any(0)])
    line = mirror_line(receivers, np.isin(receivers.receiver, heard))
    if line is not None:
        log.warn(
            f"tag {toa.tag or '(no name)'}: the receivers that heard it stand on one line: every "
            "position has a mirror image that fits as well (mirror_x, mirror_y in track.csv)"
        )
    how: dict[str, Any] = {
        "movement": options.movement,
        "error": options.error,
        "receivers": options.receiver_errors,
        "sound_speed": "estimated" if options.sound_speed == "estimated" else "auto",
        "positions": options.positions,
    }
    with log.stage("fit"):
        if options.method == "laplace":
            fit = infer.laplace(
                models.toa_track, toa, *water, draws=options.draws, seed=options.seed, **how
            )
        else:
            from maloc._jax import jax

            fit = infer.nuts(
                jax.random.key(options.seed),
                models.toa_track,
                toa,
                *water,
                method=options.method,
                chains=options.chains,
                draws=options.draws,
                progress=not log.quiet,
                **how,
            )
    for name, spent in fit.seconds.items():
        log.seconds.add(f"fit: {name}", spent["wall"], spent["cpu"])
    for text in getattr(fit, "notices", ()):
        log.notice(f"tag {toa.tag}: {text}" if toa.tag else text)
    for text in fit.warnings:
        log.warn(f"tag {toa.tag}: {text}" if toa.tag else text)
    with log.stage("tables"):
        table = track_table(fit, toa, options.seed)
        if outside := gaps_outside(toa):
            log.warn(
                f"tag {toa.tag or '(no name)'}: {outside} gaps between heard pings fit no number "
                f"of burst intervals of {toa.schedule}: check the interval"
            )
    return Fitted(toa, fit, table, line)
