"""What `maloc track --model detections` or `joint` does, from options to a finished folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maloc.export.folder import check_free, output_folder
from maloc.runs.fit_encounters import FittedTags, fit_tags
from maloc.runs.joint import fit_joint
from maloc.runs.load_encounters import Encounters, load_encounters
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions
from maloc.runs.write_encounters import write_encounters

__all__ = ["lines", "run_encounters"]


def run_encounters(
    options: TrackOptions, out: Path, *, force: bool = False, quiet: bool = False
) -> list[str]:
    """Do all of `maloc track --model detections` or `joint`; written only if everything worked.

    Returns
    -------
    list of str
        One line a tag: what was found.

    Raises
    ------
    InputError
        Bad input, or `out` is taken.
    FitError
        The fit failed.
    """
    check_free(out, force)
    log = Log(quiet)
    with log.listening():
        if options.model == "joint":
            fitted, source = fit_joint(options, log)
        else:
            source = load_encounters(options, log)
            log.release()
            fitted = fit_tags(source.history, options, log)
        with output_folder(out, force) as folder:
            write_encounters(folder, fitted, source, options, log)
    return lines(fitted, source)


def lines(fitted: FittedTags, source: Encounters) -> list[str]:
    """One line a tag: pings, detections, width."""
    history, out = source.history, []
    for i, tag in enumerate(history.tags):
        mine = history.tag == i
        rows = fitted.table.filter((fitted.table["tag"] == tag) & fitted.table["heard"])
        sd = rows.select("sd_x", "sd_y").to_numpy()
        out.append(
            f"{tag}: {int((fitted.table['tag'] == tag).sum())} pings "
            f"({int((history.n_heard[mine] > 0).sum())} heard), "
            f"{int(history.heard[mine].sum())} detections used, median sd {np.median(sd):.3g} m"
        )
    if len(history.set_aside):
        out.append(f"{len(history.set_aside)} detections set aside (arrivals.csv)")
    return out
