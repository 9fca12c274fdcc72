"""The command `maloc halves`: the options of `maloc track`, and how the receivers are split."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from maloc.cli.errors import explained
from maloc.cli.tracks import track

if TYPE_CHECKING:
    from maloc.runs.options import TrackOptions

__all__ = ["halves", "track_options"]

# options of `maloc track` that say nothing here
WITHOUT = "workers", "scheduler"
FIELDS = {"tag": "tags", "schedule": "schedule_file"}  # fields of TrackOptions of other names
READING = "format", "tz", "clock", "tag_table"


def track_options(given: dict[str, Any]) -> TrackOptions:
    """What was asked for, of the options of `maloc track` by their names."""
    from maloc.runs.options import TrackOptions
    from maloc.runs.reading import Reading

    given = dict(given)
    reading = Reading(*(given.pop(name) for name in READING))
    listed = tuple(c.strip() for c in given.pop("ignore_columns").split(",") if c.strip())
    fields: dict[str, Any] = {
        FIELDS.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in given.items()
    }
    fields |= {k: fields[k] or () for k in ("detections", "tags")}
    return TrackOptions(**fields, ignore_columns=listed, reading=reading)


def _with_tracks(command: Callable) -> Callable:
    """Give a command the options of `maloc track`, before its own; it gets them as one dict."""
    own = inspect.signature(command, eval_str=True).parameters
    theirs = inspect.signature(track, eval_str=True).parameters
    shared = {k: p for k, p in theirs.items() if k not in WITHOUT and k not in own}

    def run(**given: Any) -> None:
        command({k: given.pop(k) for k in shared}, **given)

    mine = [p for name, p in own.items() if name != "given"]
    both = [p.replace(kind=p.KEYWORD_ONLY) for p in (*shared.values(), *mine)]
    run.__signature__ = inspect.Signature(both)  # pyright: ignore[reportFunctionMemberAccess]
    run.__annotations__ = {p.name: p.annotation for p in both}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


@_with_tracks
@explained
def halves(
    given: dict,
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    split: Annotated[
        str,
        typer.Option(
            metavar="alternate|random|A,B,..|COLUMN",
            help="Every other receiver of the table, at random by --seed, the receivers of one "
            "half, or a column of the table with two values.",
        ),
    ] = "alternate",
    least: Annotated[
        int, typer.Option(help="Compare pings heard by as many receivers in both halves.")
    ] = 4,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier output folder.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings.")] = False,
) -> None:
    """Track by each half of the receivers, and set the difference against its stated sd.

    Takes the options of maloc track. Writes halves.csv (one row a ping), halves.json, halves.png,
    summary.json. A mean chi-square near 1 says that the tracks' intervals are honest.
    """
    from maloc.runs.halves import HalvesOptions, run_halves

    options = HalvesOptions(track_options(given), split, least)
    lines = run_halves(options, out, force=force, quiet=quiet)
    if not quiet:
        typer.echo("\n".join([*lines, f"written to {out}"]))
