"""Plain detection tables: `time` (or `epo` + `frac`), `receiver`, `tag`, under many names.

Covers maloc's own table, yaps detections (tag, epo, frac, serial), GLATOS and actel tables.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import DETECTION, find, locate, plain
from maloc.readers._how import How
from maloc.readers._text import Table
from maloc.readers.networks import with_codespace

__all__ = ["NAME", "TITLE", "matches", "read", "unix_time"]

NAME = "plain"
TITLE = "plain table (time or epo + frac, receiver, tag)"


def _tag_column(table: Table, roles: dict[str, int]) -> dict[str, int]:
    # actel names the tag number "Signal", beside its code space
    if "tag" not in roles and "codespace" in roles and "signal" in roles:
        roles = roles | {"tag": roles["signal"]}
        del roles["signal"]
    return roles


def matches(table: Table) -> bool:
    """Say whether time, receiver and tag can be found in the header."""
    roles = _tag_column(table, find(table.columns, DETECTION, set(DETECTION)))
    return {"receiver", "tag"} <= roles.keys() and ("time" in roles or "epo" in roles)


def read(table: Table, how: How) -> Detections:
    """Read a plain table.

    Parameters
    ----------
    table : Table
        The file.
    how : How
        `tz`: zone of stamps that name none; UTC when not given, unless the header says local.

    Raises
    ------
    InputError
        If a value cannot be read, or `epo` and `frac` contradict one another.
    """
    roles = _tag_column(table, locate(table, DETECTION))
    if "epo" in roles and ("frac" in roles or "time" not in roles):
        used = [roles[r] for r in ("epo",)]
        table = _build.clean(table, [*used, roles["receiver"], roles["tag"]])
        time, table = unix_time(table, roles["epo"], roles.get("frac"))
    else:
        k = roles["time"]
        table = _build.clean(table, [k, roles["receiver"], roles["tag"]])
        name = plain(table.columns[k])
        if _is_number(table, k):
            time, known = _clock.seconds(table, k)
            _clock.refuse_outside(table, time, known, k)
        else:
            time, _ = _clock.stamps(table, k, _zone(name, how))
    tag = Ids.of(table.text(roles["tag"]))
    if "codespace" in roles:
        space = Ids.of(table.text(roles["codespace"]).fill_null(""))
        tag = space.join(tag, "\n").to(with_codespace)
    optional = ("signal", "noise", "snr", "sensor", "sensor_unit", "depth", "station")
    taken = {roles[r] for r in ("receiver", "tag")}
    wanted = {r: roles[r] for r in optional if r in roles and roles[r] not in taken}
    extra = _build.extras(table, wanted)
    receiver = Ids.of(table.text(roles["receiver"]))
    return _build.detections(table, "detections table", time, receiver, tag, extra, roles.values())


def _zone(name: str, how: How) -> str | None:
    if name.endswith("utc"):
        return "UTC"
    return how.tz or (None if "local" in name else "UTC")


def _is_number(table: Table, k: int) -> bool:
    cell = table.cells[k]
    if cell.dtype == pl.String:
        values = table.text(k).drop_nulls()
        return len(values) > 0 and bool(values.str.contains(r"^\d{9,10}(\.\d+)?$").all())
    if cell.dtype.is_integer() and len(cell) and abs(cell.max() or 0) > 10**14:  # pyright: ignore
        raise table.error("looks like nanoseconds", None, table.columns[k], "write dates")
    return cell.dtype.is_numeric()


def unix_time(table: Table, epo: int, frac: int | None) -> tuple[np.ndarray, Table]:
    """Return ns since 1970 from a Unix second and its fraction.

    Where `epo` already holds the fraction that `frac` repeats, it is used once, with a note
    (yaps 1.2.5 leaves it in both when times have fractions).

    Raises
    ------
    InputError
        If a fraction is missing or outside [0, 1), or contradicts the one in `epo`.
    """
    time, known = _clock.seconds(table, epo)
    _clock.refuse_outside(table, time, known, epo)
    if frac is None:
        return time, table
    name = table.columns[frac]
    part, given = _clock.seconds(table, frac)
    if not given.all():
        raise table.error(
            "a fraction of a second is missing",
            int(np.flatnonzero(~given)[0]),
            name,
            "fill in 0 only if that second is really whole",
        )
    bad = np.flatnonzero((part < 0) | (part >= NS))
    if len(bad):
        raise table.error(
            "a fraction of a second lies outside 0..1", int(bad[0]), name, "give seconds, not ms"
        )
    inside = time % NS
    if not inside.any():
        return time + part, table
    apart = np.abs(inside - part)
    contrary = np.flatnonzero(np.minimum(apart, NS - apart) > NS // 1000)
    if len(contrary):
        raise table.error(
            f"'{table.columns[epo]}' already has a fraction and '{name}' holds another one",
            int(contrary[0]),
            name,
            "give whole Unix seconds beside the fraction",
        )
    text = f"'{table.columns[epo]}' already holds the fraction in '{name}': counted once"
    return time, _build.merge_notes(table, table.note("warning", text, len(time)))
