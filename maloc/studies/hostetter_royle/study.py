"""The study of Hostetter & Royle (2020) again: data sets in parallel, four models, resumable.

Each data set and model is one job of `maloc.studies.jobs`.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maloc.errors import FitError, InputError
from maloc.studies.jobs import claim, put, run_jobs

if TYPE_CHECKING:
    import polars as pl

    from maloc.simulate.hostetter_royle import Design

__all__ = ["MODELS", "Settings", "fit_job", "run_study"]

MODELS = ("independent", "detection_only", "known_interval", "unknown_interval")
TRUE = {"sigma_step": "sigma_step", "scale": "scale", "p0": "p0"}  # site -> field of Design


@dataclasses.dataclass(frozen=True)
class Settings:
    """What makes a job's result, apart from its data set's number and its model.

    Parameters
    ----------
    design : Design
    seed : int
        Data set i is drawn from the generator seeded with (seed, i).
    draws, warmup, chains : int
    method : {"auto", "nuts", "hmc"}
        Auto: HMC, but NUTS for the independent model, whose positions, which no movement ties, are
        rings rather than normal.
    """

    design: Design
    seed: int = 0
    draws: int = 1000
    warmup: int = 200
    chains: int = 2
    method: str = "auto"

    def sampler(self, model: str) -> str:
        """The sampler of a model."""
        if self.method == "auto":
            return "nuts" if model == "independent" else "hmc"
        return self.method

    def as_text(self) -> str:
        """JSON, to be compared with that of an earlier run in the same folder."""
        return json.dumps(dataclasses.asdict(self), indent=1) + "\n"


def _rows(section: str, columns: dict[str, Any]) -> pl.DataFrame:
    import polars as pl

    return pl.DataFrame({**columns}).with_columns(pl.lit(section).alias("section"))


def fit_job(settings: Settings, index: int, model: str) -> pl.DataFrame:
    """Simulate data set ``index``, fit one model, and score it.

    Returns
    -------
    polars.DataFrame
        Rows of five sections: "parameter" (name, true, mean, sd, low, high, ess, r_hat),
        "position" (tag, time, detections, distance, precision, ellipse, kernel), "gap" (tag, name,
        time, duration, true, mean, covered, sure), "run" (name, mean), "warning" (name).
    """
    import numpy as np
    import polars as pl

    import maloc
    import maloc.models
    from maloc._jax import jax
    from maloc.infer._diagnostics import r_hat
    from maloc.simulate.hostetter_royle import simulate_study

    study = simulate_study(np.random.default_rng([settings.seed, index]), settings.design)
    history = study.history(model)  # pyright: ignore[reportArgumentType]
    key = jax.random.fold_in(jax.random.key(settings.seed), len(MODELS) * index)
    began = time.process_time()
    fit = maloc.infer.nuts(
        jax.random.fold_in(key, MODELS.index(model)),
        getattr(maloc.models, model),
        history,
        draws=settings.draws,
        warmup=settings.warmup,
        chains=settings.chains,
        method=settings.sampler(model),
        progress=False,
    )
    spent = time.process_time() - began
    tables = [_parameters(fit, settings.design), _positions(fit, study, history)]
    if model == "unknown_interval":
        tables.append(_gaps(fit, study, history, index))
    run = {
        "cpu": spent,
        "cpu_after_warmup": float(np.sum(fit.stats["cpu"])),
        "divergences": float(np.sum(fit.stats["diverging"])),
        "draws": float(np.prod(fit.stats["diverging"].shape)),
        "steps": float(np.mean(fit.stats["steps"])),
        "r_hat_position": float(np.max(r_hat(fit.x[:, :, : fit.n_states]))),
        "states": float(fit.n_states),
    }
    tables.append(_rows("run", {"name": list(run), "mean": list(run.values())}))
    if fit.warnings:
        tables.append(_rows("warning", {"name": list(fit.warnings)}))
    found = pl.concat(tables, how="diagonal_relaxed")
    about = (pl.lit(index).alias("dataset"), pl.lit(model).alias("model"))
    return found.select(*about, "section", pl.exclude("section"))


def _parameters(fit, design: Design) -> pl.DataFrame:
    rows = [r for r in fit.parameters() if r["name"] in TRUE]
    return _rows(
        "parameter",
        {
            "name": [r["name"] for r in rows],
            "true": [getattr(design, TRUE[r["name"]]) for r in rows],
            **{
                new: [float(r[old]) for r in rows]
                for new, old in [("mean", "mean"), ("sd", "sd"), ("low", "q2.5"), ("high", "q97.5")]
            },
            "ess": [r["ess_bulk"] for r in rows],
            "r_hat": [r["r_hat"] for r in rows],
        },
    )


def _positions(fit, study, history) -> pl.DataFrame:
    import numpy as np

    from maloc.studies.hostetter_royle.scores import score_positions

    pings = np.flatnonzero(np.asarray(fit.args[0].ping)[: fit.n_states])
    draws = fit.x[:, :, pings, :2].reshape(-1, len(pings), 2)
    scores = score_positions(draws, study.truth(history))
    columns = {
        "tag": [history.tags[i] for i in history.tag],
        "time": history.time,
        "detections": history.n_heard,
    }
    return _rows("position", columns | scores._asdict())


def _gaps(fit, study, history, seed: int) -> pl.DataFrame:
    import numpy as np

    from maloc.infer.encounter_track import count_missed
    from maloc.studies.hostetter_royle.scores import count_set

    counted = count_missed(fit, history, seed)
    if counted is None:
        raise FitError("no gap was summed over")
    gaps, pmf = counted.gaps, counted.pmf
    tags = [history.tags[g.tag] for g in gaps]
    spans = [(g.start, g.start + g.duration) for g in gaps]
    true = np.array([study.missed(tag, *span) for tag, span in zip(tags, spans, strict=True)])
    inside = count_set(pmf)
    place = np.minimum(true, pmf.shape[1] - 1)
    covered = inside[np.arange(len(gaps)), place] & (true < pmf.shape[1])
    return _rows(
        "gap",
        {
            "tag": tags,
            "name": [g.kind for g in gaps],
            "time": [g.start for g in gaps],
            "duration": [g.duration for g in gaps],
            "true": true.astype(float),
            "mean": pmf @ np.arange(pmf.shape[1]),
            "covered": covered,
            "sure": pmf.max(axis=1) > 1 - 1e-6,
        },
    )


def _job_file(out: Path, index: int, model: str) -> Path:
    return out / f"{index:04d}_{model}.parquet"


def _job(settings: Settings, index: int, model: str, out: Path) -> str:
    """Do one job and put its file in place whole; return what went wrong, or nothing."""
    import polars as pl

    try:
        found = fit_job(settings, index, model)
        problem = ""
    except FitError as error:
        problem = f"data set {index}, {model}: {error}"
        found = pl.DataFrame(
            {"dataset": [index], "model": [model], "section": ["failed"], "name": [str(error)]}
        )
    put(found, _job_file(out, index, model))
    return problem


def run_study(
    settings: Settings,
    datasets: int,
    out: Path,
    *,
    models: Sequence[str] = MODELS,
    workers: int = 1,
    quiet: bool = False,
) -> pl.DataFrame:
    """Do what is not done yet, and return the results of all data sets and models asked for.

    Parameters
    ----------
    settings : Settings
    datasets : int
        Data sets 0 to ``datasets`` - 1.
    out : Path
        Folder of the results; an earlier run with the same settings is gone on with.
    models : sequence of str
        Some of `MODELS`.
    workers : int
        Processes, of one thread each.
    quiet : bool
        No progress bar.

    Raises
    ------
    InputError
        If a model is unknown, or the folder holds something else.
    """
    if strange := [m for m in models if m not in MODELS]:
        raise InputError(f"model '{strange[0]}' is none of {', '.join(MODELS)}")
    claim(out, settings.as_text())
    pairs = [(i, m) for i in range(datasets) for m in models]
    return run_jobs(
        _job,
        [(settings, i, m, out) for i, m in pairs],
        [_job_file(out, i, m) for i, m in pairs],
        workers=workers,
        quiet=quiet,
    )
