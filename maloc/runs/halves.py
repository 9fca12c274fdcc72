"""What `maloc halves` does, from options to a finished folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from maloc.errors import FitError, InputError
from maloc.evaluate import Halves, halves, named_half, receiver_offsets
from maloc.evaluate.halves import check_halves, every_other, random_half
from maloc.export import output
from maloc.export.folder import check_free, output_folder
from maloc.runs.depth import with_depth
from maloc.runs.fit_tag import fit_tag
from maloc.runs.load import Source, load, read_shore
from maloc.runs.log import Log
from maloc.runs.options import TrackOptions

if TYPE_CHECKING:
    import polars as pl

    from maloc.data import ArrivalTimes, Receivers

__all__ = ["HalvesOptions", "TagHalves", "halves_of_tag", "run_halves", "score_lines"]

PNG = {"dpi": 110, "pil_kwargs": {"compress_level": 1}}
ALTERNATE, RANDOM = "alternate", "random"


@dataclass(frozen=True)
class HalvesOptions:
    """Everything that `maloc halves` was asked for.

    Parameters
    ----------
    source : TrackOptions
        How each half is tracked.
    split : str
        "alternate" (every other receiver of the table), "random" (by the seed), the receivers of
        the first half with commas between, or a column of the table that has two values.
    least : int
        Pings heard by as many receivers in both halves are compared.

    Raises
    ------
    InputError
        If the options exclude one another.
    """

    source: TrackOptions
    split: str = ALTERNATE
    least: int = 4

    def __post_init__(self) -> None:
        if self.source.model != "toa":
            raise InputError("maloc halves goes with --model toa: tracks by arrival times")
        if self.source.sync == "beacons":
            raise InputError("--sync beacons goes with maloc points")
        if self.least < 3:
            raise InputError(f"--least must be 3 or more, got {self.least}")

    def first(self, receivers: Receivers) -> np.ndarray:
        """Say which deployments (D,) of a table are of the first half."""
        if self.split == ALTERNATE:
            return every_other(receivers)
        if self.split == RANDOM:
            return random_half(np.random.default_rng(self.source.seed), receivers)
        if "," in self.split:
            return named_half(receivers, [n.strip() for n in self.split.split(",") if n.strip()])
        return _by_column(self.source.receivers, self.split, receivers)


class TagHalves(NamedTuple):
    """A tag's two tracks compared, and its receivers by the residuals of the track by all."""

    tag: str
    halves: Halves
    offsets: pl.DataFrame


def run_halves(
    options: HalvesOptions, out: Path, *, force: bool = False, quiet: bool = False
) -> list[str]:
    """Do all of `maloc halves`; nothing is written unless everything worked.

    Parameters
    ----------
    options : HalvesOptions
    out : Path
        Folder to write.

    Returns
    -------
    list of str
        A table, one line a tag, and lines that name receivers.

    Raises
    ------
    InputError
        Bad input, too few receivers, or `out` is taken.
    FitError
        If a fit failed.
    """
    check_free(out, force)
    log = Log(quiet)
    with log.listening():
        source = with_depth(load(options.source, log), options.source, log)
        water = read_shore(options.source, source.receivers, log)
        found = _each(options, source, water, log)
        with output_folder(out, force) as folder:
            _write(folder, found, source, options, log)
    return score_lines(found)


def halves_of_tag(
    toa: ArrivalTimes, first: np.ndarray, options: HalvesOptions, log: Log, water: tuple = ()
) -> TagHalves:
    """Track one tag by all receivers and by each half of them, and compare.

    Parameters
    ----------
    toa : ArrivalTimes
    first : (R,) array of bool
        The deployments of the first half.

    Raises
    ------
    InputError
        If a half has too few receivers.
    FitError
        If a fit fails.
    """
    check_halves(toa, first, options.least)
    name, letters = toa.tag or "track", iter("ab")

    def fit(part: ArrivalTimes) -> Any:
        part = part.replace(tag=f"{name}, half {next(letters)}")
        return fit_tag(part, options.source, part.receivers, log, water).fit

    whole = fit_tag(toa, options.source, toa.receivers, log, water).fit
    compared = halves(toa, fit, first, least=options.least)
    speed = float(np.mean(toa.sound_speed))
    offsets = receiver_offsets(whole.residuals(), whole.p_direct(), toa.receivers.labels, speed)
    return TagHalves(name, compared, offsets)


def score_lines(found: list[TagHalves]) -> list[str]:
    """A table for the terminal: one line a tag, and receivers that are late on the whole."""
    width = max(len("tag"), *(len(f.tag) for f in found))
    head = f"{'tag':{width}}  receivers  pings  chi2 x  chi2 y  <1.96 x  <1.96 y  median m  worst m"
    lines = [head]
    for tag, h, _ in found:
        s, sizes = h.scores, f"{len(h.receivers[0])} + {len(h.receivers[1])}"
        lines.append(
            f"{tag:{width}}{sizes:>11}{s['n']:>7.0f}{s['chi2_x']:>8.2f}{s['chi2_y']:>8.2f}"
            f"{s['within_x']:>9.2f}{s['within_y']:>9.2f}{s['median']:>10.2f}{s['worst']:>9.2f}"
        )
    return [*lines, *(line for f in found if (line := _named(f)))]


def _named(found: TagHalves, most: int = 3) -> str:
    """Name the receivers whose direct arrivals are late or early on the whole."""
    far = found.offsets.filter("far")
    if not len(far):
        return ""
    parts = [
        f"{r['receiver']} {r['median']:+.2f} m (se {r['se']:.2f}, {r['n']} arrivals)"
        for r in far.head(most).iter_rows(named=True)
    ]
    more = ", ..." if len(far) > most else ""
    return (
        f"{found.tag}: direct arrivals are off on the whole at {len(far)} of {len(found.offsets)} "
        f"receivers: {', '.join(parts)}{more}"
    )


def _each(options: HalvesOptions, source: Source, water: tuple, log: Log) -> list[TagHalves]:
    """All tags; of several, one that cannot be halved or fitted is said and left out."""
    found: list[TagHalves] = []
    problem: InputError | FitError | None = None
    for toa in source.toas:
        try:
            first = options.first(toa.receivers)
            check_halves(toa, first, options.least)
            log.release()
            found.append(halves_of_tag(toa, first, options, log, water))
        except (InputError, FitError) as reason:
            problem = problem or reason
            if len(source.toas) > 1:
                log.warn(f"{reason}; skipped")
    if not found:
        assert problem is not None
        raise problem
    return found


def _by_column(file: Path, column: str, receivers: Receivers) -> np.ndarray:
    """Deployments (D,) of the first value of a column of the table of receivers."""
    import polars as pl

    how = f"--split {column} is no column of the table of receivers"
    mend = "give alternate, random, a column with two values, or receivers with commas between"
    try:
        table = pl.read_csv(file, infer_schema=False)
    except (pl.exceptions.PolarsError, UnicodeDecodeError) as problem:
        raise InputError(f"{how} as CSV", file=file, mend=mend) from problem
    if column not in table.columns:
        raise InputError(how, file=file, mend=mend)
    kept = table.filter(pl.any_horizontal(pl.all().is_in(list(receivers.names))))
    same = [c for c in table.columns if kept[c].to_list() == list(receivers.receiver)]
    values = kept[column].unique(maintain_order=True)
    if not same or len(values) != 2:
        what = f"{len(values)} values" if same else "rows that are not the receivers'"
        raise InputError(f"{what}, not two halves", file=file, column=column, mend=mend)
    return (kept[column] == values[0]).fill_null(False).to_numpy()


def _write(
    folder: Path, found: list[TagHalves], source: Source, options: HalvesOptions, log: Log
) -> None:
    import polars as pl
    import polars.selectors as cs

    tables = [f.halves.rows.select(pl.lit(f.tag).alias("tag"), pl.all()) for f in found]
    rows = pl.concat(tables).with_columns(cs.float().round(4))
    output.write_table(rows, folder / "halves.csv")
    tags = {
        f.tag: {
            "receivers_a": f.halves.receivers[0],
            "receivers_b": f.halves.receivers[1],
            **f.halves.scores,
            "receivers": f.offsets.to_dicts(),
        }
        for f in found
    }
    asked = {"split": options.split, "least": options.least}
    output.write_json({**asked, "tags": tags}, folder / "halves.json")
    with log.stage("figures"):
        from matplotlib.figure import Figure

        from maloc.plots._halves import halves as draw

        figure = Figure(figsize=(8.0, 3.2 * len(found)), layout="constrained")
        for ax, f in zip(figure.subplots(len(found), squeeze=False)[:, 0], found, strict=True):
            draw(f.halves, ax=ax)
            ax.set_title(f"{f.tag}: {ax.get_title(loc='left')}", loc="left", fontsize="medium")
        figure.savefig(folder / "halves.png", **PNG)
    summary = {
        "command": "halves",
        "versions": output.versions(),
        "seed": options.source.seed,
        "options": options.source.record() | asked,
        "sync": None if source.sync is None else output.sync_record(source.sync),
        "skipped_tags": source.skipped,
        "warnings": log.warnings,
        "notices": log.notices,
        "seconds": log.seconds,
    }
    output.write_json(summary, folder / "summary.json")
