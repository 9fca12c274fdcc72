"""Tables of positions: VPS, ATLAS localizations, Movebank events, yaps's GPS table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.data.positions import Positions
from maloc.data.report import Note, ReadReport
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["matches", "read", "title"]


class _Layout(NamedTuple):
    """Names of columns: those that must be there, what they mean, and what else is carried."""

    title: str
    needed: str
    time: str
    tag: str
    metres: str
    degrees: str
    extra: dict[str, str]


_LAYOUTS = (
    _Layout(
        "VPS positions",
        "detectedid datetime x y hpe",
        "datetime",
        "detectedid",
        "x y",
        "lon lat",
        {"transmitter": "transmitter", "distance": "d", "n": "n", "hpe": "hpe", "hpem": "hpem",
         "temperature": "temp", "depth": "depth", "acceleration": "accel", "heard": "drx",
         "used": "urx"},
    ),
    _Layout(
        "ATLAS localizations",
        "tag time x y nbs varx vary",
        "time",
        "tag",
        "x y",
        "",
        {"n": "nbs", "penalty": "penalty", "z": "z", "sd": "sd", "cov_xy": "covxy"},
    ),
    _Layout(
        "Movebank events",
        "timestamp location_long location_lat",
        "timestamp",
        "individual_local_identifier tag_local_identifier",
        "",
        "location_long location_lat",
        {"sensor_type": "sensor_type", "visible": "visible", "hdop": "gps_hdop",
         "outlier": "algorithm_marked_outlier", "outlier_by_hand": "manually_marked_outlier"},
    ),
    _Layout("yaps GPS table", "ts utm_x utm_y", "ts", "", "utm_x utm_y", "", {}),
)  # fmt: skip


def _layout(table: Table) -> _Layout | None:
    simple = {plain(c) for c in table.columns}
    return next((f for f in _LAYOUTS if set(f.needed.split()) <= simple), None)


def matches(table: Table) -> bool:
    """Say whether the header is one of theirs."""
    return _layout(table) is not None


def title(table: Table) -> str:
    """Name the layout, for messages."""
    found = _layout(table)
    return "" if found is None else found.title


def read(table: Table, how: How) -> Positions:
    """Read a table of positions.

    Raises
    ------
    InputError
        If a value cannot be read.
    """
    layout = _layout(table)
    if layout is None:
        raise table.error("not a table of positions that is known")
    simple = [plain(c) for c in table.columns]
    at = {name: simple.index(name) for name in simple}
    table = _build.clean(table, [at[layout.time]])
    if layout.title.startswith("ATLAS"):
        ms = table.numbers(at["time"])
        whole = np.floor(ms)
        time = whole.astype(np.int64) * 1_000_000 + np.rint((ms - whole) * 1e6).astype(np.int64)
        _clock.refuse_outside(table, time, np.ones(len(table), bool), at["time"])
    else:
        time, _ = _clock.stamps(table, at[layout.time], how.tz or "UTC")
    tags = [at[name] for name in layout.tag.split() if name in at]
    tag = np.full(len(table), "", "U1")
    if tags:
        tag = Ids.of(table.text(tags[0]).fill_null("")).array()
    values = {
        role: table.numbers(at[name]) if name in at else None
        for role, name in zip(
            ("x", "y", "longitude", "latitude"),
            [*(layout.metres.split() or ["", ""]), *(layout.degrees.split() or ["", ""])],
            strict=True,
        )
    }
    wanted = {role: at[name] for role, name in layout.extra.items() if name in at}
    extra = _build.extras(table, wanted)
    for axis in "xy":
        if f"var{axis}" in at:
            extra[f"sd_{axis}"] = np.sqrt(np.maximum(table.numbers(at[f"var{axis}"]), 0))
    nowhere = np.full(len(table), np.nan)
    names = [layout.time, *layout.tag.split(), *layout.metres.split(), *layout.degrees.split()]
    used = [*wanted.values(), *(at[c] for c in [*names, "varx", "vary"] if c in at)]
    notes = [*table.notes, *_build.unused(table, used), *_flagged(table, extra)]
    report = ReadReport(layout.title, (table.file,), len(table), tuple(notes))
    x, y, lon, lat = (nowhere if v is None else v for v in values.values())
    return Positions(time, tag, x, y, lon, lat, extra, None, report)


def _flagged(table: Table, extra: dict[str, np.ndarray]) -> list[Note]:
    """Rows that Movebank hides or marks as outliers are kept, and said."""
    notes = []
    for name, word, text in (
        ("visible", "false", "not visible"),
        ("outlier", "true", "marked as outliers"),
        ("outlier_by_hand", "true", "marked as outliers by hand"),
    ):
        if name in extra:
            n = int(sum(str(v).lower() == word for v in extra[name]))
            if n:
                note = f"{n} positions {text}: kept, see extra['{name}']"
                notes.append(table.note("info", note, n))
    return notes
