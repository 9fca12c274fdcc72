"""What `maloc track` and `maloc sync` do, from options to a finished folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.errors import FitError, InputError
from maloc.export.folder import check_free, output_folder
from maloc.runs.depth import with_depth
from maloc.runs.load import Source, TrackOptions, load, read_shore, speed_of_water
from maloc.runs.log import Log
from maloc.runs.mirror import Line, mirror_line
from maloc.runs.reading import Reading

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import ArrivalTimes, Receivers
    from maloc.runs.tags import Done
    from maloc.sync import ClockSync

__all__ = ["Fitted", "fit_tag", "run_sync", "run_track", "tag_files"]


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


def tag_files(
    toa: ArrivalTimes, options: TrackOptions, receivers: Receivers, water: tuple, quiet: bool
) -> dict[str, bytes]:
    """Fit one tag, in whatever process, and return the files that it gives.

    Raises
    ------
    FitError
        If the fit fails.
    """
    from maloc.runs import output
    from maloc.runs.tags import RECORD
    from maloc.runs.write import write_tag

    log = Log(quiet)  # held back: the run says it
    with tempfile.TemporaryDirectory() as place, log.listening():
        folder = Path(place)
        fitted = fit_tag(toa, options, receivers, log, water)
        record = write_tag(folder, fitted, receivers, log)
        record |= {"line": _line(fitted), "median_sd": _median_sd(fitted)}
        record |= {"warnings": log.warnings, "notices": log.notices, "seconds": log.seconds}
        output.write_json(record, folder / RECORD)
        return {file.name: file.read_bytes() for file in folder.iterdir()}


def run_track(
    options: TrackOptions,
    out: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    force: bool = False,
    quiet: bool = False,
) -> list[str]:
    """Do all of `maloc track`; nothing is written unless everything worked.

    Of several tags those that are done are kept beside `out` until all are, so that a run that was
    stopped goes on where it was; and one that fails does not keep the others from being written.

    Returns
    -------
    list of str
        One line a tag: what was found.

    Raises
    ------
    InputError
        Bad input, or `out` is taken.
    FitError
        A fit failed; of several tags, after the others were written.
    """
    if options.sync == "beacons":
        raise InputError("--sync beacons goes with maloc points")
    if options.model in ("detections", "joint"):
        from maloc.runs.encounters import run_encounters

        if workers > 1 or scheduler is not None:
            raise InputError(f"--model {options.model} fits all tags together: leave --workers out")
        return run_encounters(options, out, force=force, quiet=quiet)
    check_free(out, force)
    out = Path(out).absolute()
    log = Log(quiet)
    with log.listening():
        source = with_depth(load(options, log), options, log)
        water = read_shore(options, source.receivers, log)
        log.release()
        done = _each(options, source, water, out, log, workers, scheduler)
        failed = [d for d in done if d.failed is not None]
        if len(failed) == len(done):
            shutil.rmtree(_kept(out), ignore_errors=True)
            more = f" (and so do all {len(done)} tags)" if len(done) > 1 else ""
            raise FitError(f"{failed[0].failed}{more}")
        with output_folder(out, force) as folder:
            from maloc.runs.write import write_track

            write_track(folder, done, source, options, log)
    shutil.rmtree(_kept(out), ignore_errors=True)
    if failed:
        why = "; ".join(f"{d.name}: {d.failed}" for d in failed[:3])
        raise FitError(
            f"{len(failed)} of {len(done)} tags failed ({why}); the others are written to {out}"
        )
    return [d.record["line"] for d in done]


def _kept(out: Path) -> Path:
    """Where the tags that are done lie until all are."""
    return out.parent / f".{out.name}.tags"


def _each(
    options: TrackOptions,
    source: Source,
    water: tuple,
    out: Path,
    log: Log,
    workers: int,
    scheduler: str | None,
) -> list[Done]:
    """Fit each tag that is not done yet; pass on what there is to be said of it."""
    from maloc._version import __version__
    from maloc.runs.tags import Job, key_of, run_each

    elsewhere = ("detections", "toa", "tags", "receivers")  # in the arrival times
    how = [(k, v) for k, v in options.record().items() if k not in elsewhere]
    shore = () if options.water is None else options.water.read_bytes()
    xy = source.receivers.xy

    def job(toa: ArrivalTimes) -> Job:
        about = (toa.tag, toa.origin, toa.schedule, toa.sound_speed_sd, toa.set_aside, toa.column)
        arrays = (toa.toa, toa.sound_speed, toa.receivers.xy, toa.ping, xy, toa.depth, toa.clock_sd)
        key = key_of(__version__, how, shore, *about, *arrays)
        quiet = log.quiet or len(source.toas) > 1
        return Job(toa.tag, key, tag_files, (toa, options, source.receivers, water, quiet))

    jobs = [job(toa) for toa in source.toas]
    kept = _kept(out)
    try:
        done = run_each(jobs, kept, workers=workers, scheduler=scheduler, quiet=log.quiet)
    except BaseException:
        ready = len(list(kept.glob("*/record.json")))
        if ready:
            log.warn(
                f"stopped: {ready} tags are done and kept; the same command goes on from there"
            )
        else:
            shutil.rmtree(kept, ignore_errors=True)
        raise
    for d in done:
        for text in d.record.get("notices", ()):
            log.notice(text)
        for text in d.record.get("warnings", ()):
            log.warn(text)
        if d.failed is not None:
            log.warn(f"tag {d.name or '(no name)'} failed: {d.failed}")
        for name, spent in d.record.get("seconds", {}).items():
            log.seconds.add(name, spent["wall"], spent["cpu"])
    return done


def _line(fitted: Fitted) -> str:
    toa = fitted.toa
    return (
        f"{toa.tag or 'track'}: {len(fitted.table)} pings ({int((toa.n_heard > 0).sum())} heard), "
        f"{int(toa.heard.sum())} arrivals used, {len(toa.set_aside)} set aside, "
        f"median sd {_median_sd(fitted):.2f} m"
    )


def _median_sd(fitted: Fitted) -> float:
    heard = fitted.table.filter(fitted.table["heard"])
    return float(np.median(heard.select("sd_x", "sd_y").to_numpy()))


def run_sync(
    detections: Sequence[Path],
    receivers: Path,
    out: Path,
    reference: str | None = None,
    *,
    sound_speed: str | None = None,
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
        from maloc.runs import output
        from maloc.sync import fit, read_anchors

        reading = reading or Reading()

        with log.stage("read"):
            table = reading.receivers(receivers, crs)
            log.report(table.report)
            raw = reading.detections(detections)
            log.report(raw.report)
            known = None if anchors is None else read_anchors(anchors)
            if known is not None:
                log.report(known.report)
        with log.stage("sync"):
            how = {"sound_speed": speed, "reference": reference, "progress": not quiet}
            sync = fit(raw, table, **how)
            if known is not None:
                sync = sync.anchored(known.receiver, known.recorded, known.true)
        for note in sync.notes:
            (log.notice if note.level == "info" else log.warn)(note.text)
        log.release()
        with output_folder(out, force) as folder:
            with log.stage("write"):
                sync.write(folder, raw)
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
