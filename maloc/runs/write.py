"""What `maloc track` leaves in its folder: tables, draws, figures, summary.json."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.export import output
from maloc.runs.fit_tag import Fitted
from maloc.runs.load import Source
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.tags import Done

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

    from maloc.data.receivers import Receivers

__all__ = [
    "file_name",
    "map_figure",
    "sampler_health",
    "summary",
    "tags_table",
    "write_tag",
    "write_track",
]

LEGEND_ROWS = 3
PNG = {"dpi": 110, "pil_kwargs": {"compress_level": 1}}  # quick to write; a little larger


def write_tag(folder: Path, fitted: Fitted, receivers: Receivers, log: Log) -> dict[str, Any]:
    """Write what one tag gives into a folder; what summary.json will say of it.

    Tables as Parquet, unrounded; posterior.nc; diagnostics.png.
    """
    with log.stage("tables"):
        track = output.finish_track(fitted.table, receivers, fitted.line)
        track.write_parquet(folder / "track.parquet")
        output.arrivals_table(fitted.fit, fitted.toa).write_parquet(folder / "arrivals.parquet")
        parameters = output.parameters_table(fitted.fit, fitted.toa.tag)
        parameters.write_parquet(folder / "parameters.parquet")
    with log.stage("posterior"):
        from maloc.infer._export import write_posterior

        tag, origin, crs = fitted.toa.tag, fitted.toa.origin, fitted.toa.receivers.crs
        write_posterior(fitted.fit, folder / "posterior.nc", [tag], origin, crs)
    with log.stage("figures"):
        from matplotlib.figure import Figure

        figure = diagnostics_figure(Figure, fitted, track)
        figure.savefig(folder / "diagnostics.png", **PNG)
    line = fitted.line
    mirror = None if line is None else {"point": line.point, "direction": line.direction}
    return {"tag": _tag_summary(fitted), "mirror": mirror}


def write_track(
    folder: Path, done: Sequence[Done], source: Source, options: TrackOptions, log: Log
) -> None:
    """Write all files of a finished `maloc track` into an empty folder, from those of its tags.

    Tables hold all tags, one after the other. Draws and diagnostics are one file a tag where there
    are several: ``posterior_<tag>.nc``, ``diagnostics_<tag>.png``; and ``tags.csv`` says how each
    fared.
    """
    import polars as pl

    several = len(done) > 1
    fitted = [d for d in done if d.failed is None]
    with log.stage("tables"):
        for name in ("track", "arrivals", "parameters"):
            parts = [pl.read_parquet(d.folder / f"{name}.parquet") for d in fitted]
            output.write_table(pl.concat(parts, how="diagonal_relaxed"), folder / f"{name}.csv")
        if several:
            output.write_table(tags_table(done), folder / "tags.csv")
    with log.stage("posterior"):
        for d in fitted:
            for stem, end in (("posterior", "nc"), ("diagnostics", "png")):
                _same(d.folder / f"{stem}.{end}", folder / file_name(stem, d.name, several, end))
    with log.stage("figures"):
        from matplotlib.figure import Figure

        shown = {d.name: pl.read_parquet(d.folder / "track.parquet") for d in fitted}
        lines = any(d.record["mirror"] for d in fitted)
        figure = map_figure(Figure, shown, source.receivers, mirrored=lines)
        figure.savefig(folder / "map.png", **PNG)
    output.write_json(summary(done, source, options, log), folder / "summary.json")


def tags_table(done: Sequence[Done]) -> pl.DataFrame:
    """One row a tag: done or failed and why, what there was of it, CPU seconds."""
    import polars as pl

    rows = []
    for d in done:
        about = d.record.get("tag", {})
        spent = d.record.get("seconds", {})
        rows.append(
            {
                "tag": d.name,
                "status": "failed" if d.failed else "done",
                "pings": about.get("pings"),
                "heard": about.get("heard"),
                "arrivals_used": about.get("arrivals_used"),
                "median_sd": d.record.get("median_sd"),
                "cpu": spent.get("fit", {}).get("cpu"),
                "warnings": "; ".join(about.get("warnings", [])),
                "why": d.failed or "",
            }
        )
    whole = ("pings", "heard", "arrivals_used")
    types = {"tag": pl.String, "status": pl.String, **dict.fromkeys(whole, pl.Int64)}
    types |= {"median_sd": pl.Float64, "cpu": pl.Float64, "warnings": pl.String, "why": pl.String}
    return pl.DataFrame(rows, schema=types)


def _same(source: Path, target: Path) -> None:
    """The same file at another place, without a copy where the disk allows."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def file_name(stem: str, tag: str, several: bool, end: str) -> str:
    """Return "posterior.nc", or "posterior_A69-1602-15266.nc" where there are several tags."""
    safe = "".join(c if c.isalnum() or c in "-_." else "_" for c in tag)
    return f"{stem}_{safe}.{end}" if several else f"{stem}.{end}"


# -- figures --------------------------------------------------------------------------------------


def map_figure(
    figure_type: type[Figure], tracks: Mapping[str, Any], receivers: Any, *, mirrored: bool = False
) -> Figure:
    """Draw the tables of all tags on one map; its shape follows the array's and the tracks'."""
    from maloc.plots._style import CYCLE
    from maloc.plots._track import track

    figure = figure_type(figsize=(8.0, 8.0))
    ax = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    several = len(tracks) > 1
    for i, (tag, table) in enumerate(tracks.items()):
        track(
            table,
            receivers if i == 0 else None,
            label=(tag or "track") if several else "posterior mean and 95 % (dark to light: time)",
            colour=CYCLE[i % len(CYCLE)] if several else None,
            ax=ax,
        )
    names = ", ".join(tag for tag in tracks if tag)
    note = "Receivers on one line: the mirror image fits as well." if mirrored else ""
    # legend: each label once, above the map; the page follows the map's shape
    entries = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    shown = list(entries)[: 4 * LEGEND_ROWS]
    ax.legend(
        [entries[k] for k in shown],
        shown,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=4,
        frameon=False,
        fontsize=8,
    )
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    ratio = float(np.clip((y1 - y0) / (x1 - x0), 0.35, 1.6))
    top, bottom = 0.6 + 0.2 * -(-len(shown) // 4), 0.6  # inches
    left = 0.07 + 0.01 * max(len(f"{y:.0f}") for y in (y0, y1))  # northings have seven digits
    width = 0.98 - left
    height = 8.0 * width * ratio + top + bottom
    figure.set_size_inches(8.0, height)
    ax.set_position((left, bottom / height, width, 1 - (top + bottom) / height))
    title = names if len(names) <= 75 else f"{len(tracks)} tags"
    figure.text(left, 1 - 0.28 / height, title or "Track", fontsize=12, fontweight="bold")
    figure.text(left, 1 - 0.5 / height, note, fontsize=9, color="#B04000")
    return figure


def diagnostics_figure(figure_type: type[Figure], fitted: Fitted, table: Any) -> Figure:
    """Draw the six panels of one tag."""
    from maloc.plots._diagnostics import diagnostics

    figure = figure_type(figsize=(14.0, 8.0))
    names = fitted.toa.receivers.labels
    title = f"{fitted.toa.tag or 'Track'}  ({fitted.fit.method})"
    diagnostics(fitted.fit, table, names, title=title, figure=figure)
    return figure


# -- summary --------------------------------------------------------------------------------------


def summary(
    done: Sequence[Done], source: Source, options: TrackOptions, log: Log
) -> dict[str, Any]:
    """Return what summary.json holds."""
    read: dict[str, Any] = {"receivers": len(source.receivers)}
    if source.detections is not None:
        report = source.detections.report
        read |= {
            "detections": len(source.detections),
            "format": report.format,
            "files": list(report.files),
            "tags": list(source.detections.tags),
        }
    else:
        read |= {
            "detections": int(sum(a.heard.sum() + len(a.set_aside) for a in source.toas)),
            "format": "TOA matrix",
            "files": [str(options.toa)],
        }
    out: dict[str, Any] = {
        "command": "track",
        "versions": output.versions(),
        "seed": options.seed,
        "options": options.record(),
        "read": read,
        "sync": None if source.sync is None else output.sync_record(source.sync),
        "tags": {d.name or "track": d.record["tag"] for d in done if d.failed is None},
        "failed_tags": {d.name or "track": d.failed for d in done if d.failed is not None},
        "skipped_tags": source.skipped,
        "mirror": _mirror_summary(done),
        "warnings": log.warnings,
        "notices": log.notices,
        "seconds": log.seconds,
    }
    total = [v for k, v in log.seconds.items() if not k.startswith("fit: ")]
    out["seconds_total"] = {k: sum(v[k] for v in total) for k in ("wall", "cpu")}
    return out


def _tag_summary(fitted: Fitted) -> dict[str, Any]:
    toa, fit = fitted.toa, fitted.fit
    direct = np.asarray(fit.p_direct(), float)[toa.heard[toa.n_heard > 0]]
    return {
        "pings": toa.n_pings,
        "heard": int((toa.n_heard > 0).sum()),
        "unheard": int((toa.n_heard == 0).sum()),
        "rows_in_track": len(fitted.table),
        "receivers": [str(n) for n in np.array(toa.receivers.labels)[toa.heard.any(0)]],
        "receivers_that_heard_nothing": [
            str(n) for n in np.array(toa.receivers.labels)[~toa.heard.any(0)]
        ],
        "arrivals_used": int(toa.heard.sum()),
        "arrivals_late": int((direct < 0.5).sum()),
        "set_aside": output.counts(toa.set_aside.why),
        "sound_speed": float(np.mean(toa.sound_speed)),
        "schedule": {"kind": toa.schedule.kind, "lo": toa.schedule.lo, "hi": toa.schedule.hi},
        "method": fit.method,
        "sampler": sampler_health(fit),
        "notes": [str(n) for n in toa.report.notes],
        "warnings": list(fit.warnings),
    }


def sampler_health(fit: Any) -> dict[str, Any] | None:
    """Worst R-hat and effective sample sizes over the parameters; None where nothing sampled."""
    if fit.method in ("laplace", "svi"):
        return None
    rows, stats = fit.parameters(), getattr(fit, "stats", {})

    def worst(name: str, pick: Any) -> float | None:
        values = [r[name] for r in rows if r.get(name) is not None and np.isfinite(r[name])]
        return pick(values) if values else None

    return {
        "r_hat": worst("r_hat", max),
        "ess_bulk": worst("ess_bulk", min),
        "ess_tail": worst("ess_tail", min),
        "divergences": int(np.sum(stats["diverging"])) if "diverging" in stats else None,
        "acceptance": float(np.mean(stats["accept"])) if "accept" in stats else None,
        "step_size": stats.get("step_size"),
    }


def _mirror_summary(done: Sequence[Done]) -> dict[str, Any] | None:
    lines = {d.name or "track": d.record["mirror"] for d in done if d.record.get("mirror")}
    if not lines:
        return None
    return {
        "meaning": "the receivers that heard the tag stand on one line: each position has a "
        "mirror image that fits as well, given as mirror_x, mirror_y in track.csv",
        "lines": lines,
    }
