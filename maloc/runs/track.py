"""What `maloc track` does with arrival times, from options to a finished folder."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maloc._package.version import __version__
from maloc.errors import FitError, InputError
from maloc.export import output
from maloc.export.folder import check_free, output_folder
from maloc.runs.depth import with_depth
from maloc.runs.encounters import run_encounters
from maloc.runs.fit_tag import Fitted, fit_tag
from maloc.runs.load import Source, load, read_shore
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.sound import with_sound
from maloc.runs.tags import RECORD, Done, Job, key_of, run_each
from maloc.runs.write import write_tag, write_track

if TYPE_CHECKING:
    from maloc.data import ArrivalTimes, Receivers

__all__ = ["run_track", "tag_files"]


def tag_files(
    toa: ArrivalTimes, options: TrackOptions, receivers: Receivers, water: tuple, quiet: bool
) -> dict[str, bytes]:
    """Fit one tag, in whatever process, and return the files that it gives.

    Raises
    ------
    FitError
        If the fit fails.
    """
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
        if workers > 1 or scheduler is not None:
            raise InputError(f"--model {options.model} fits all tags together: leave --workers out")
        return run_encounters(options, out, force=force, quiet=quiet)
    check_free(out, force)
    out = Path(out).absolute()
    log = Log(quiet)
    with log.listening():
        source = with_sound(with_depth(load(options, log), options, log), options, log)
        water = read_shore(options, source.receivers, log)
        log.release()
        done = _each(options, source, water, out, log, workers, scheduler)
        failed = [d for d in done if d.failed is not None]
        if len(failed) == len(done):
            shutil.rmtree(_kept(out), ignore_errors=True)
            more = f" (and so do all {len(done)} tags)" if len(done) > 1 else ""
            raise FitError(f"{failed[0].failed}{more}")
        with output_folder(out, force) as folder:
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
    elsewhere = ("detections", "toa", "tags", "receivers")  # in the arrival times
    how = [(k, v) for k, v in options.record().items() if k not in elsewhere]
    shore = () if options.water is None else options.water.read_bytes()
    xy = source.receivers.xy

    def job(toa: ArrivalTimes) -> Job:
        about = (toa.tag, toa.origin, toa.schedule, toa.sound_speed_sd, toa.set_aside, toa.column)
        arrays = (toa.toa, toa.sound_speed, toa.receivers.xy, toa.ping, xy, toa.depth, toa.clock_sd)
        arrays += (toa.receivers.position_sd, *_profile(toa))
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


def _profile(toa: ArrivalTimes) -> tuple:
    p = toa.profile
    return () if p is None else (p.depth, p.speed, p.time, p.sd)


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
