"""The receivers table: aliases, projection, and every missing coordinate named at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl

from maloc.data._time import OPEN_END, OPEN_START
from maloc.data.receivers import Receivers, collinear, deployment_problem
from maloc.data.report import Note, ReadReport
from maloc.readers import _build, _clock
from maloc.readers._columns import RECEIVER, find, locate, unnamed
from maloc.readers._sheets import is_vps_sheet, moved_moorings, vps_sheet
from maloc.readers._text import Table, from_frame

__all__ = ["COLLINEAR", "matches", "receivers_from_frame", "receivers_from_table"]


def matches(table: Table) -> bool:
    """Say whether a receiver and its place can be found in the header."""
    if is_vps_sheet(table):
        return True
    roles = find(table.columns, RECEIVER, set(RECEIVER))
    return "receiver" in roles and (
        {"x", "y"} <= roles.keys() or {"longitude", "latitude"} <= roles.keys()
    )


def receivers_from_frame(df: pl.DataFrame, crs: str | None = None) -> Receivers:
    """Build Receivers from a dataframe laid out as the table; see `maloc.read_receivers`."""
    return receivers_from_table(from_frame("dataframe", df), crs)


def receivers_from_table(
    table: Table, crs: str | None = None, position_sd: float | None = None
) -> Receivers:
    """Build Receivers from a table; see `maloc.read_receivers`."""
    if is_vps_sheet(table):
        table = vps_sheet(table)
    roles = locate(table, RECEIVER)
    if "receiver" not in roles:
        raise table.error(
            f"no column names the receiver; header: {', '.join(table.columns)}",
            mend="call it 'receiver'",
        )
    metres, degrees = {"x", "y"} <= roles.keys(), {"longitude", "latitude"} <= roles.keys()
    if not (metres or degrees):
        raise table.error(
            f"no coordinates; header: {', '.join(table.columns)}",
            mend="give columns 'x' and 'y' (m) or 'longitude' and 'latitude' (degrees)",
        )
    table = _build.clean(table, [roles["receiver"]])
    if not len(table):
        raise table.error("no receivers in the table")
    table = _unique(table)
    notes = [*table.notes, *_ignored(table, roles, metres and degrees)]
    name = table.text(roles["receiver"])
    notes += moved_moorings(table, name)
    pair = ("x", "y") if metres else ("longitude", "latitude")
    a, b = _coordinates(table, roles, pair, name)
    if degrees and not metres:
        a, b, crs = _project(table, a, b, crs)
        notes.append(table.note("info", f"longitude and latitude projected to {crs}"))
    elif crs is not None:
        _metric(table, crs)
    depth = table.numbers(roles["depth"]) if "depth" in roles else np.full(len(table), np.nan)
    tag = table.text(roles["sync_tag"]).fill_null("") if "sync_tag" in roles else None
    start = _open(table, roles.get("start"), OPEN_START)
    end = _open(table, roles.get("end"), OPEN_END)
    sd = _position_sd(table, roles.get("sd"), position_sd)
    names = np.asarray(name.to_list(), dtype=str)
    if problem := deployment_problem(names, start, end):
        mend = "give each deployment its start and end" if "overlap" in problem[1] else None
        raise table.error(problem[1], problem[0], mend=mend)
    report = ReadReport("receivers table", (table.file,), len(table), tuple(notes))
    sync = np.asarray([""] * len(table) if tag is None else tag.to_list(), dtype=str)
    out = Receivers(names, a, b, depth, sync, start, end, crs, report, sd)
    return replace(out, report=report.add(*_remarks(table, out)))


def _unique(table: Table) -> Table:
    cells = pl.DataFrame([c.alias(str(k)) for k, c in enumerate(table.cells)])
    first = cells.select(pl.struct(pl.all()).is_first_distinct()).to_series().to_numpy()
    if first.all():
        return table
    gone = int((~first).sum())
    text = f"{gone} duplicated row{'s' * (gone != 1)} removed ({_build.lines(table, ~first)})"
    return table.rows(first, table.note("warning", text, gone, int(table.line[~first][0])))


def _ignored(table: Table, roles: dict[str, int], both: bool) -> list[Note]:
    notes = []
    if both:
        text = "both x, y and longitude, latitude are there: x, y are used"
        notes.append(table.note("info", text))
    nameless = unnamed(table)
    if nameless:
        notes.append(
            table.note("info", f"{len(nameless)} column without a name ignored", len(nameless))
        )
    used = set(roles.values()) | set(nameless)
    rest = [c for k, c in enumerate(table.columns) if k not in used]
    if rest:
        notes.append(table.note("info", f"columns not used: {', '.join(rest)}", len(rest)))
    return notes


def _coordinates(
    table: Table, roles: dict[str, int], pair: tuple[str, str], name: pl.Series
) -> tuple[np.ndarray, np.ndarray]:
    a, b = (table.numbers(roles[c]) for c in pair)
    if pair[0] == "longitude":
        nowhere = (a == 0) & (b == 0)
        a, b = np.where(nowhere, np.nan, a), np.where(nowhere, np.nan, b)
    columns = [table.columns[roles[c]] for c in pair]
    bad = np.isnan(a) | np.isnan(b)
    if bad.any():
        each = []
        for i in np.flatnonzero(bad):
            which = [c for c, v in zip(columns, (a, b), strict=True) if np.isnan(v[i])]
            each.append(f"{name[int(i)]} ({', '.join(which)}, line {table.line[i]})")
        first = int(np.flatnonzero(bad)[0])
        lacking = columns[0] if np.isnan(a[first]) else columns[1]
        raise table.error(
            f"coordinates are missing: {'; '.join(each)}",
            first,
            lacking,
            "fill them in or take the receivers out of the table",
        )
    if pair[0] == "longitude":
        for values, limit, column in ((a, 180.0, columns[0]), (b, 90.0, columns[1])):
            wrong = np.flatnonzero(np.abs(values) > limit)
            if len(wrong):
                i = int(wrong[0])
                raise table.error(f"{values[i]:g} is not in degrees", i, column)
    return a, b


def _position_sd(table: Table, k: int | None, otherwise: float | None) -> np.ndarray | None:
    """Errors (D,) m of the places: the column's, ``otherwise`` where it is blank; or None."""
    if k is None:
        return None if otherwise is None else np.full(len(table), float(otherwise))
    sd, column = table.numbers(k), table.columns[k]
    if (sd < 0).any():
        i = int(np.argmax(sd < 0))
        raise table.error(f"a position's error of {sd[i]:g} m is negative", i, column)
    blank = np.isnan(sd)
    if blank.all() and otherwise is None:
        return None
    if blank.any() and otherwise is None:
        mend = "fill it in, 0 for an exact place, or give --receiver-sd (position_sd= in Python)"
        raise table.error("the position's error is missing", int(np.argmax(blank)), column, mend)
    return np.where(blank, np.nan if otherwise is None else otherwise, sd)


def _project(
    table: Table, lon: np.ndarray, lat: np.ndarray, crs: str | None
) -> tuple[np.ndarray, np.ndarray, str]:
    from pyproj import Transformer

    if crs is None:
        centre = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(lon)).mean()))
        zone = int((centre + 180) // 6) % 60 + 1
        crs = f"EPSG:{(32600 if lat.mean() >= 0 else 32700) + zone}"
    _metric(table, crs)
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    bad = np.flatnonzero(~(np.isfinite(x) & np.isfinite(y)))
    if len(bad):
        raise table.error(
            f"{lon[bad[0]]:g}, {lat[bad[0]]:g} cannot be projected to {crs}", int(bad[0])
        )
    return np.asarray(x), np.asarray(y), crs


def _metric(table: Table, crs: str) -> None:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        known = CRS.from_user_input(crs)
    except CRSError:
        raise table.error(
            f"unknown frame crs='{crs}'", mend="use a code such as EPSG:32617"
        ) from None
    if not known.is_projected or any(axis.unit_name != "metre" for axis in known.axis_info[:2]):
        raise table.error(f"crs='{crs}' is not a projected frame in metres")


def _open(table: Table, k: int | None, opened: int) -> np.ndarray:
    if k is None:
        return np.full(len(table), opened, np.int64)
    ns, known = _clock.stamps(table, k, "UTC", coarse=True)
    return np.where(known, ns, opened)


def _remarks(table: Table, receivers: Receivers) -> list[Note]:
    notes = []
    size = max(np.ptp(receivers.x), np.ptp(receivers.y))
    degrees = np.abs(receivers.x).max() <= 180 and np.abs(receivers.y).max() <= 90
    if len(receivers) > 2 and size < 2 and degrees:
        text = f"the whole array is {size:.2g} m wide: are x and y degrees?"
        notes.append(table.note("warning", text))
    places: dict[tuple[float, float], str] = {}
    for name, x, y in zip(receivers.receiver, receivers.x, receivers.y, strict=True):
        other = places.setdefault((float(x), float(y)), str(name))
        if other != name:
            text = f"receivers {other} and {name} are at the same place"
            notes.append(table.note("warning", text, 2))
    if len(receivers) > 2 and collinear(receivers):
        notes.append(table.note("warning", COLLINEAR))
    return notes


COLLINEAR = (
    "all receivers are on one line (collinear): every position has an equally good mirror image "
    "across it"
)
