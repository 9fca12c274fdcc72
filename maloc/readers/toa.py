"""The wide matrix of arrival times: columns by name, order checked, Unix seconds kept exact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from maloc.data._tags import match_tag
from maloc.data._time import NS
from maloc.data.arrivals import (
    DEFAULT_SOUND_SPEED,
    DEFAULT_SOUND_SPEED_SD,
    NO_SPEED,
    ArrivalTimes,
    Schedule,
)
from maloc.data.receivers import Receivers, collinear
from maloc.data.report import Note, ReadReport
from maloc.readers import _clock
from maloc.readers._columns import TOA, locate, plain, unnamed
from maloc.readers._text import Table, from_frame, read_table

__all__ = [
    "DEFAULT_SOUND_SPEED",
    "UNIX_FROM_S",
    "matches",
    "tags_of",
    "toa_from_frame",
    "toa_from_table",
]

UNIX_FROM_S = 1e8  # larger than this is taken for Unix seconds (1973 on)


def matches(table: Table, receivers: Receivers | None = None) -> bool:
    """Say whether the header looks like a TOA matrix."""
    simple = [plain(c) for c in table.columns]
    if sum(c.startswith("toa_") for c in simple) > 1:
        return True
    names = set() if receivers is None else set(receivers.names) | set(receivers.labels)
    return "ping" in simple or len(names & set(table.columns)) > 1


def tags_of(path: Path) -> list[str]:
    """Return the tags that a matrix of arrival times has rows of, in order."""
    table = read_table(path)
    k = locate(table, TOA).get("tag")
    return [] if k is None else table.text(k).drop_nulls().unique(maintain_order=True).to_list()


def toa_from_frame(df: pl.DataFrame, receivers: Receivers, **options: Any) -> ArrivalTimes:
    """Build ArrivalTimes from a wide dataframe; see `maloc.read_toa`."""
    return toa_from_table(from_frame("dataframe", df), receivers, **options)


def toa_from_table(
    table: Table,
    receivers: Receivers,
    *,
    ignore_columns: tuple[str, ...] = (),
    sound_speed: float | None = None,
    schedule: Schedule | None = None,
    tag: object = None,
    origin: int | None = None,
) -> ArrivalTimes:
    """Build ArrivalTimes from a table; see `maloc.read_toa`."""
    roles = locate(table, TOA)
    columns, notes = _receiver_columns(table, receivers, roles, ignore_columns)
    if len(table) and table.cut_last:
        i = len(table) - 1
        raise table.error("the last line is cut short", i, mend="export the file again")
    table, tag_id = _one_tag(table, roles.get("tag"), tag)
    if not len(table):
        raise table.error("no pings, only a header")
    kept = [d for d in range(len(receivers)) if d in columns]
    toa, origin = _times(table, [columns[d] for d in kept], origin)
    used = receivers.subset(np.asarray(kept, dtype=np.int64))
    if absent := [receivers.labels[d] for d in range(len(receivers)) if d not in columns]:
        text = f"receivers without a column, left out: {', '.join(absent)}"
        notes.append(table.note("info", text, len(absent)))
    ping = _pings(table, roles.get("ping"))
    _check_order(table, toa)
    speed, more = _speed(table, roles.get("sound_speed"), sound_speed)
    guessed = sound_speed is None and "sound_speed" not in roles
    notes += more + _remarks(table, toa, used, speed)
    depth = table.numbers(roles["depth"]) if "depth" in roles else None
    report = ReadReport("TOA matrix", (table.file,), len(table), (*table.notes, *notes))
    return ArrivalTimes(
        toa,
        used,
        speed,
        tag_id,
        origin,
        ping,
        schedule or Schedule(),
        depth,
        sound_speed_sd=DEFAULT_SOUND_SPEED_SD if guessed else None,
        report=report,
    )


def _receiver_columns(
    table: Table, receivers: Receivers, roles: dict[str, int], ignore: tuple[str, ...]
) -> tuple[dict[int, int], list[Note]]:
    """Return {deployment: column}, every other column accounted for."""
    wanted = {label: d for d, label in enumerate(receivers.labels)}
    out: dict[int, int] = {}
    unknown, notes = [], []
    nameless = unnamed(table)
    for k, name in enumerate(table.columns):
        short = name[4:] if name.lower().startswith("toa_") and name not in wanted else name
        if name in ignore or k in nameless:
            continue
        if short in wanted:
            if wanted[short] in out:
                raise table.error(f"two columns for receiver {short}")
            out[wanted[short]] = k
        elif k not in roles.values():
            unknown.append(name)
    if unknown:
        moved = [n for n in unknown if n.removeprefix("toa_") in receivers.names]
        known = ", ".join(receivers.labels[:12]) + (", ..." if len(receivers) > 12 else "")
        why = "a receiver with several deployments needs one column each (name#1, name#2)"
        raise table.error(
            f"columns that are no receiver of the table: {', '.join(unknown[:20])}",
            mend=why if moved else f"receivers are {known}; or name them in ignore_columns",
        )
    if not out:
        raise table.error("no column is a receiver of the table")
    if nameless:
        text = f"{len(nameless)} column without a name ignored"
        notes.append(table.note("info", text, len(nameless)))
    for role, k in list(roles.items()):
        if table.columns[k] in ignore or k in out.values():
            del roles[role]
    return out, notes


def _one_tag(table: Table, k: int | None, tag: object) -> tuple[Table, str]:
    if k is None:
        return table, "" if tag is None else str(tag)
    ids = table.text(k)
    there = ids.drop_nulls().unique().to_list()
    if tag is None and len(there) > 1:
        listed = ", ".join(sorted(there)[:20])
        raise table.error(f"{len(there)} tags: {listed}", None, table.columns[k], "say which")
    if not there:
        return table, "" if tag is None else str(tag)
    chosen = there[0] if tag is None else match_tag(there, tag)
    mine = (ids == chosen).fill_null(len(there) == 1).to_numpy()
    return table.rows(mine), chosen


def _times(table: Table, columns: list[int], origin: int | None) -> tuple[np.ndarray, int | None]:
    """Return seconds (P, R) and their origin; Unix seconds go through integers."""
    rough = np.column_stack([table.numbers(k) for k in columns])
    size = np.abs(rough[np.isfinite(rough)])
    if origin is not None or not len(size) or np.median(size) < UNIX_FROM_S:
        large = np.argwhere(np.abs(np.nan_to_num(rough)) >= UNIX_FROM_S)
        if len(large):
            i, j = large[0]
            raise table.error("far from all other times", int(i), table.columns[columns[j]])
        return rough, origin
    parts = [_clock.seconds(table, k) for k in columns]
    ns = np.column_stack([p[0] for p in parts])
    known = np.column_stack([p[1] for p in parts])
    for j, k in enumerate(columns):
        _clock.refuse_outside(table, ns[:, j], known[:, j], k)
    origin = int(ns[known].min() // NS * NS)
    return np.where(known, (ns - origin) / NS, np.nan), origin


def _pings(table: Table, k: int | None) -> np.ndarray:
    if k is None:
        return np.arange(1, len(table) + 1)
    ids = table.numbers(k)
    bad = np.flatnonzero(~(ids % 1 == 0) | (np.abs(ids) > 2**53))
    if len(bad):
        raise table.error("a ping's id is no whole number", int(bad[0]), table.columns[k])
    out = ids.astype(np.int64)
    again = np.setdiff1d(np.arange(len(out)), np.unique(out, return_index=True)[1])
    if len(again):
        raise table.error(f"ping {out[again[0]]} is there twice", int(again[0]), table.columns[k])
    return out


def _check_order(table: Table, toa: np.ndarray) -> None:
    first = np.where(np.isfinite(toa), toa, np.inf).min(axis=1)
    rows = np.flatnonzero(np.isfinite(first))
    for a, b in zip(rows[:-1], rows[1:], strict=True):
        if np.array_equal(toa[a], toa[b], equal_nan=True):
            raise table.error(f"the ping of line {table.line[a]} is there again", int(b))
        if first[b] < first[a]:
            raise table.error(
                f"pings are not in time order: {first[b]:.6f} s after {first[a]:.6f} s",
                int(b),
                mend="sort the rows by time",
            )


def _speed(table: Table, k: int | None, given: float | None) -> tuple[np.ndarray, list[Note]]:
    n = len(table)
    notes = []
    if given is not None:
        speed = np.full(n, float(given))
    elif k is not None:
        speed = table.numbers(k)
        bad = np.flatnonzero(np.isnan(speed) | (speed <= 0))
        if len(bad):
            raise table.error(
                "a sound speed is missing or not positive", int(bad[0]), table.columns[k]
            )
    else:
        speed = np.full(n, DEFAULT_SOUND_SPEED)
        notes.append(table.note("warning", NO_SPEED))
    if n and not (1300 <= speed.min() and speed.max() <= 1700):
        text = f"sound speed {speed.min():g}..{speed.max():g} m/s is not that of water"
        notes.append(table.note("warning", text))
    return speed, notes


def _remarks(table: Table, toa: np.ndarray, receivers: Receivers, speed: np.ndarray) -> list[Note]:
    notes = []
    heard = np.isfinite(toa)
    usable = int((heard.sum(1) >= 3).sum())
    if usable < 3:
        text = f"only {usable} pings were heard by 3 or more receivers"
        notes.append(table.note("warning", text, usable))
    silent = [receivers.labels[j] for j in np.flatnonzero(~heard.any(0))]
    if silent:
        text = f"receivers that heard nothing: {', '.join(silent)}"
        notes.append(table.note("info", text, len(silent)))
    if heard.any():
        xy = receivers.xy
        width = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)).max()
        low = np.where(heard, toa, np.inf).min(1)
        high = np.where(heard, toa, -np.inf).max(1)
        wide = np.flatnonzero(high - low > width / speed + 1.0)
        if len(wide):
            text = (
                f"{len(wide)} pings arrive over a longer time than sound needs across the array "
                f"(first: line {table.line[wide[0]]}): are the clocks synchronised?"
            )
            notes.append(table.note("warning", text, len(wide), int(table.line[wide[0]])))
    if len(receivers) > 2 and collinear(receivers):
        from maloc.readers.receivers import COLLINEAR

        notes.append(table.note("warning", COLLINEAR))
    return notes
