"""From an encounter history to a fit and its tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._mirror import Line, mirror_line
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import EncounterHistory
    from maloc.infer.encounter_check import Expected

__all__ = ["FittedTags", "fit_tags", "run_model", "tables"]


@dataclass(frozen=True)
class FittedTags:
    """All tags in one fit: the fit, tables of track.csv and missed.csv, who should hear what."""

    history: EncounterHistory
    fit: Any
    table: pl.DataFrame
    missed: pl.DataFrame | None
    expected: Expected
    line: Line | None = None
    late: tuple[np.ndarray, np.ndarray] | None = None  # residual (s) and p_direct, (P, R)


def fit_tags(history: EncounterHistory, options: TrackOptions, log: Log) -> FittedTags:
    """Fit all tags of a history in one model.

    Raises
    ------
    FitError
        If the fit fails.
    """
    with log.stage("engine start"):  # JAX is imported here, and nowhere before
        from maloc import models

    if history.known:
        model = models.known_interval
    else:
        model = models.unknown_interval if history.summed else models.detection_only
    how: dict[str, Any] = {
        "movement": options.movement,
        "detection": options.detection,
        "loss": options.loss,
        "dispersion": options.dispersion,
        "receiver_effects": options.receiver_effects,
    }
    return tables(run_model(model, (history,), how, options, log), history, options, log)


def run_model(model: Any, data: tuple, how: dict[str, Any], options: TrackOptions, log: Log):
    """Fit a model of some data by the method asked for."""
    from maloc import infer

    with log.stage("fit"):
        if options.method == "laplace":
            fit = infer.laplace(model, *data, draws=options.draws, seed=options.seed, **how)
        else:
            from maloc._jax import jax

            key, quiet = jax.random.key(options.seed), log.quiet
            if options.method == "svi":
                how |= {"draws": options.draws, "seed": options.seed, "progress": not quiet}
                fit = infer.svi(key, model, *data, **how)
            else:
                how |= {"draws": options.draws, "chains": options.chains, "progress": not quiet}
                fit = infer.nuts(key, model, *data, method=options.method, **how)
    for name, spent in fit.seconds.items():
        log.seconds.add(f"fit: {name}", spent["wall"], spent["cpu"])
    for text in fit.warnings:
        log.warn(text)
    return fit


def tables(fit: Any, history: EncounterHistory, options: TrackOptions, log: Log) -> FittedTags:
    """Tables of a fit, and what there is to be warned of."""
    from maloc.infer import encounter_check, encounter_track

    line = mirror_line(history.receivers, np.asarray(history.heard.any(axis=0)))
    if line is not None:
        log.warn(
            "the receivers that heard anything stand on one line: every position has a mirror "
            "image that fits as well (mirror_x, mirror_y in track.csv)"
        )
    with log.stage("tables"):
        counted = encounter_track.count_missed(fit, history, options.seed)
        table = encounter_track.track_table(fit, history, counted)
        missed = None if counted is None else encounter_track.missed_table(history, counted)
        expected = encounter_check.expected_hearing(fit, history)
        if missed is not None and (n := int(missed["outside"].sum())):
            log.warn(
                f"{n} of {len(missed)} gaps between heard pings fit no number of burst intervals "
                f"of {history.schedule} (outside in missed.csv): check the interval"
            )
    return FittedTags(history, fit, table, missed, expected, line)
