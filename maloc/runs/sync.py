"""What `maloc sync` does, from options to a finished folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maloc.export.folder import check_free, output_folder
from maloc.runs.log import Log
from maloc.runs.reading import Reading
from maloc.runs.speed import speed_error, speed_of_water, sync_speed

if TYPE_CHECKING:
    from maloc.data import Detections
    from maloc.sync import ClockSync

__all__ = ["run_sync", "write_sync"]


def run_sync(
    detections: Sequence[Path],
    receivers: Path,
    out: Path,
    reference: str | None = None,
    *,
    sound_speed: str | None = None,
    sound_speed_sd: str | None = None,
    receiver_sd: float | None = None,
    anchors: Path | None = None,
    crs: str | None = None,
    seed: int = 0,
    reading: Reading | None = None,
    force: bool = False,
    quiet: bool = False,
) -> ClockSync:
    """Do all of `maloc sync`; nothing is written unless everything worked.

    Raises
    ------
    InputError
        Bad input, or `out` is taken.
    FitError
        The clocks could not be aligned.
    """
    check_free(out, force)
    log = Log(quiet)
    speed = sound_speed if sound_speed in ("constant", "varying") else speed_of_water(sound_speed)
    with log.listening():
        from maloc.export import output
        from maloc.sync import fit, read_anchors

        reading = reading or Reading()

        with log.stage("read"):
            table = reading.receivers(receivers, crs, receiver_sd)
            log.report(table.report)
            raw = reading.detections(detections)
            log.report(raw.report)
            known = None if anchors is None else read_anchors(anchors)
            if known is not None:
                log.report(known.report)
        with log.stage("sync"):
            how: dict[str, Any] = {"reference": reference, "progress": not quiet}
            how |= sync_speed(speed, speed_error(sound_speed_sd), table)
            if table.position_sd is not None:
                how["free_positions"] = table.position_sd
            sync = fit(raw, table, **how)
            if known is not None:
                sync = sync.anchored(known.receiver, known.recorded, known.true)
        for note in sync.notes:
            (log.notice if note.level == "info" else log.warn)(note.text)
        log.release()
        with output_folder(out, force) as folder:
            with log.stage("write"):
                write_sync(sync, folder, raw)
            output.write_json(
                {
                    "command": "sync",
                    "versions": output.versions(),
                    "seed": seed,
                    "options": {
                        "detections": [str(p) for p in detections],
                        "receivers": str(receivers),
                        "reference": reference,
                        "sound_speed": sound_speed,
                        "sound_speed_sd": sound_speed_sd,
                        "receiver_sd": receiver_sd,
                        "anchors": None if anchors is None else str(anchors),
                        "crs": crs,
                        **{k: v for k, v in vars(reading).items() if v is not None},
                    },
                    "read": {
                        "detections": len(raw),
                        "format": raw.report.format,
                        "files": list(raw.report.files),
                        "receivers": len(table),
                    },
                    "sync": output.sync_record(sync),
                    "warnings": log.warnings,
                    "notices": log.notices,
                    "seconds": log.seconds,
                },
                folder / "summary.json",
            )
    return sync


def write_sync(
    sync: ClockSync, folder: str | Path, detections: Detections | None = None
) -> list[Path]:
    """Write the files of `maloc sync` into an existing folder; returns their paths.

    sync.nc, receivers_fitted.csv, residuals.csv, links.csv, jumps.csv, figures and, when the
    detections are given, detections_synced.parquet.
    """
    import polars.selectors as cs
    from matplotlib.figure import Figure

    from maloc.plots import _sync as figures
    from maloc.plots._sync_links import sync_matrix
    from maloc.sync._tables import receivers_frame
    from maloc.sync.connect import connectivity

    folder = Path(folder)
    sync.to_netcdf(folder / "sync.nc")
    paths = [folder / "sync.nc"]
    for name, table in (
        ("receivers_fitted.csv", receivers_frame(sync)),
        ("residuals.csv", sync.residuals_frame()),
        ("links.csv", sync.links_frame()),
        ("jumps.csv", sync.jumps_frame()),
    ):
        iso = cs.datetime().dt.strftime("%Y-%m-%dT%H:%M:%S%.6fZ")
        table.with_columns(iso).write_csv(folder / name, float_precision=6)
        paths.append(folder / name)
    if detections is not None:
        paths.append(folder / "detections_synced.parquet")
        sync.apply(detections).to_frame().write_parquet(paths[-1])
    drawn: list[tuple[str, Any]] = [
        ("residuals.png", figures.sync_residuals),
        ("clocks.png", figures.clocks),
    ]
    if detections is not None:
        found = connectivity(detections, sync.receivers)
        drawn.append(("connectivity.png", lambda _, ax: sync_matrix(found, ax=ax)))
    for name, draw in drawn:
        figure = Figure(figsize=(9.0, 4.5))  # no pyplot: nothing global, no window
        draw(sync, figure.subplots())
        paths.append(folder / name)
        figure.savefig(paths[-1], dpi=150, bbox_inches="tight")
    return paths
