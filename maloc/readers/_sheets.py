"""Deployment sheets brought to the layout of the receivers table: OTN, GLATOS, VPS projects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl

from maloc.data.report import Note
from maloc.readers._columns import plain
from maloc.readers._text import Table

__all__ = ["is_vps_sheet", "moved_moorings", "vps_sheet"]

MOVED_M = 50.0  # more than a GPS is off: a mooring was found elsewhere than it was put
_METRES_A_DEGREE = 111_195.0


def is_vps_sheet(table: Table) -> bool:
    """Say whether it is the sheet Stations of a VPS project: devices of both kinds in a column."""
    simple = {plain(c) for c in table.columns}
    return {"name", "latitude", "longitude", "device"} <= simple


def vps_sheet(table: Table) -> Table:
    """Return a receivers table of a VPS project's stations.

    Blank cells mean "as above". A sync tag (an id such as A69-1602-60001) becomes the `sync_tag`
    of the receivers at its station; a station of a tag alone is left out, with a note.
    """
    at = {plain(c): k for k, c in enumerate(table.columns)}
    shared = [c for c in ("name", "latitude", "longitude", "start_time", "end_time") if c in at]
    cells = list(table.cells)
    for c in shared:
        cells[at[c]] = table.text(at[c]).fill_null(strategy="forward").fill_null("")
    device = table.text(at["device"]).fill_null("")
    is_tag = device.str.contains(r"^A\d+-\d+-\d+$")
    tags = dict(zip(cells[at["name"]].filter(is_tag), device.filter(is_tag), strict=True))
    station = cells[at["name"]]
    sync = pl.Series([tags.get(s, "") for s in station], dtype=pl.String)
    keep = (~is_tag & (device != "")).to_numpy()
    notes = list(table.notes)
    alone = [t for s, t in tags.items() if s not in set(station.filter(pl.Series(keep)))]
    if alone:
        text = f"sync tags without a receiver left out: {', '.join(alone)}"
        notes.append(table.note("info", text, len(alone)))
    # what a column means in this sheet, in the words of the receivers table
    words = {"device": "receiver", "name": "station", "device_depth": "depth"}
    names = [words.get(plain(c), c) for c in table.columns]
    whole = replace(
        table,
        columns=(*names, "sync_tag"),
        cells=(*cells, sync),
        notes=tuple(notes),
        _text={},
    )
    return whole.rows(keep)


def moved_moorings(table: Table, receiver: pl.Series) -> list[Note]:
    """Say which moorings were recovered far from where they were deployed."""
    at = {plain(c): k for k, c in enumerate(table.columns)}
    pair = [("deploy_lat", "recover_lat"), ("deploy_long", "recover_long")]
    if not all(c in at for names in pair for c in names):
        return []
    lat, lat2, lon, lon2 = (table.numbers(at[c]) for names in pair for c in names)
    east = (lon2 - lon) * np.cos(np.deg2rad(lat))
    metres = _METRES_A_DEGREE * np.hypot(lat2 - lat, east)
    far = np.flatnonzero(metres > MOVED_M)
    if not len(far):
        return []
    said = ", ".join(f"{receiver[int(i)]} ({metres[i]:.0f} m)" for i in far[:8])
    text = f"recovered far from where they were deployed, so where they stood is unsure: {said}"
    return [table.note("warning", text, len(far), int(table.line[far[0]]))]
