"""What `maloc track --model detections` leaves in its folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data._time import NS
from maloc.export import output
from maloc.runs.fit_encounters import FittedTags
from maloc.runs.load_encounters import Encounters
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.write import PNG, map_figure, sampler_health

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import Detections, EncounterHistory

__all__ = ["encounters_table", "summary", "write_encounters"]


def write_encounters(
    folder: Path, fitted: FittedTags, source: Encounters, options: TrackOptions, log: Log
) -> None:
    """Write all files of a finished `maloc track --model detections` into an empty folder."""
    history = source.history
    with log.stage("tables"):
        table = output.finish_track(fitted.table, source.receivers, fitted.line)
        output.write_table(table, folder / "track.csv")
        arrivals = encounters_table(history, source.detections, fitted.late)
        output.write_table(arrivals, folder / "arrivals.csv")
        output.write_table(output.parameters_table(fitted.fit, ""), folder / "parameters.csv")
        if fitted.missed is not None:
            output.write_table(fitted.missed, folder / "missed.csv")
    with log.stage("posterior"):
        from maloc.infer._export import write_posterior

        path, crs = folder / "posterior.nc", history.receivers.crs
        write_posterior(fitted.fit, path, history.tags, history.origin, crs)
    with log.stage("figures"):
        from matplotlib.figure import Figure

        from maloc.plots._encounters import encounters

        tracks = {tag: table.filter(table["tag"] == tag) for tag in history.tags}
        figure = map_figure(Figure, tracks, source.receivers, mirrored=fitted.line is not None)
        figure.savefig(folder / "map.png", **PNG)
        figure = Figure(figsize=(14.0, 8.0))
        title = f"{_named(history)}  ({fitted.fit.method})"
        encounters(fitted.fit, table, fitted.expected, fitted.missed, title=title, figure=figure)
        figure.savefig(folder / "diagnostics.png", **PNG)
    output.write_json(summary(fitted, source, options, log), folder / "summary.json")


def _named(history: EncounterHistory) -> str:
    names = ", ".join(history.tags)
    return names if len(names) <= 75 else f"{len(history.tags)} tags"


def encounters_table(
    history: EncounterHistory,
    detections: Detections | None = None,
    late: tuple[np.ndarray, np.ndarray] | None = None,
) -> pl.DataFrame:
    """Return one row a detection, those used by tag and ping, then those set aside.

    Returns
    -------
    DataFrame
        Columns `maloc.export.output.ARRIVALS`; residual and p_direct, two (P, R) arrays, are empty
        where times of arrival are not modelled. `ping` counts the rows of a tag's pings from 1.
    """
    import polars as pl

    row, column = np.nonzero(history.heard)
    aside, known = history.set_aside, history.detection
    nothing = [None] * len(aside)
    whose = nothing if detections is None else detections.tag[aside.detection].tolist()
    names = np.asarray(history.receivers.labels, dtype=str)
    start = 0.0 if history.origin is None else history.origin / NS
    number = row - history.first_rows[history.tag[row]] + 1
    detection = [None] * len(row) if known is None else known[row, column].tolist()
    used = len(row)
    residual, direct = ([None] * used,) * 2
    why = [""] * used
    if late is not None:
        residual, direct = (np.asarray(x, float)[row, column].tolist() for x in late)
        why = [output.LATE if p < 0.5 else "" for p in direct]
    columns: dict[str, list] = {
        "ping": number.tolist() + nothing,
        "receiver": names[column].tolist() + aside.receiver.tolist(),
        "residual": residual + nothing,
        "p_direct": direct + nothing,
        "used": [True] * used + [False] * len(aside),
        "why": why + aside.why.tolist(),
        "tag": [history.tags[i] for i in history.tag[row]] + whose,
        "t": (start + np.concatenate([history.time[row], aside.time])).tolist(),
        "detection": detection + aside.detection.tolist(),
    }
    types = {
        "ping": pl.Int64,
        "residual": pl.Float64,
        "p_direct": pl.Float64,
        "used": pl.Boolean,
        "t": pl.Float64,
        "detection": pl.Int64,
    }
    return pl.DataFrame(
        [pl.Series(k, columns[k], types.get(k, pl.String)) for k in output.ARRIVALS]
    )


def summary(
    fitted: FittedTags, source: Encounters, options: TrackOptions, log: Log
) -> dict[str, Any]:
    """Return what summary.json holds."""
    history, fit, detections = source.history, fitted.fit, source.detections
    read: dict[str, Any] = {"receivers": len(source.receivers)}
    if detections is not None:
        report = detections.report
        read |= {
            "detections": len(detections),
            "format": report.format,
            "files": list(report.files),
            "tags": list(detections.tags),
        }
    else:
        read |= {"format": "TOA matrix", "files": [str(options.toa)]}
    out: dict[str, Any] = {
        "command": "track",
        "versions": output.versions(),
        "seed": options.seed,
        "options": options.record(),
        "read": read,
        "model": fit.model_name,
        "method": fit.method,
        "sampler": sampler_health(fit),
        "states": fit.n_states,
        "slack": history.slack,
        "state_space": {"low": history.low, "high": history.high},
        "schedule": {
            "kind": history.schedule.kind,
            "lo": history.schedule.lo,
            "hi": history.schedule.hi,
        },
        "tags": {tag: _tag_summary(fitted, i) for i, tag in enumerate(history.tags)},
        "set_aside": output.counts(history.set_aside.why),
        "receivers_that_heard_nothing": [
            str(n) for n in np.array(history.receivers.labels)[~history.heard.any(0)]
        ],
        "mirror": None if fitted.line is None else fitted.line._asdict(),
        "warnings": log.warnings,
        "notices": log.notices,
        "seconds": log.seconds,
    }
    total = [v for k, v in log.seconds.items() if not k.startswith("fit: ")]
    out["seconds_total"] = {k: sum(v[k] for v in total) for k in ("wall", "cpu")}
    return out


def _tag_summary(fitted: FittedTags, i: int) -> dict[str, Any]:
    history, tag = fitted.history, fitted.history.tags[i]
    mine = history.tag == i
    out = {
        "pings": int(mine.sum()),
        "heard": int((history.n_heard[mine] > 0).sum()),
        "rows_in_track": int((fitted.table["tag"] == tag).sum()),
        "detections_used": int(history.heard[mine].sum()),
    }
    if fitted.missed is not None:
        rows = fitted.missed.filter(fitted.missed["tag"] == tag)
        out |= {
            "gaps": len(rows),
            "gaps_outside_the_limits": int(rows["outside"].sum()),
            "missed": float(rows["mean"].sum()),
        }
    return out
