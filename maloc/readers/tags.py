"""The tags table: code, animal, sensor, burst limits, under the names that are in use."""

from __future__ import annotations

import numpy as np

from maloc.data._time import OPEN_END, OPEN_START
from maloc.data.report import ReadReport
from maloc.data.tags import Tags
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import TAG, find, locate
from maloc.readers._text import Table
from maloc.readers.networks import with_codespace

__all__ = ["matches", "read"]


def matches(table: Table) -> bool:
    """Say whether a code, and something about it, can be found in the header."""
    roles = find(table.columns, TAG, set(TAG))
    return "tag" in roles and bool({"animal", "min_delay", "sensor", "receiver"} & roles.keys())


def read(table: Table) -> Tags:
    """Read a table of tags.

    Raises
    ------
    InputError
        If a column or a code is missing, a code is there twice, or a number cannot be read.
    """
    roles = locate(table, TAG)
    if "tag" not in roles:
        raise table.error(
            f"no column names the tag; header: {', '.join(table.columns)}", mend="call it 'tag'"
        )
    table = _build.clean(table, [roles["tag"]])
    n = len(table)
    tag = Ids.of(table.text(roles["tag"]))
    if "codespace" in roles:
        space = Ids.of(table.text(roles["codespace"]).fill_null(""))
        tag = space.join(tag, "\n").to(with_codespace)

    def words(role: str) -> np.ndarray:
        if role not in roles:
            return np.full(n, "", "U1")
        return np.asarray(table.text(roles[role]).fill_null("").to_list(), str)

    def numbers(role: str) -> np.ndarray:
        return table.numbers(roles[role]) if role in roles else np.full(n, np.nan)

    def times(role: str, opened: int) -> np.ndarray:
        if role not in roles:
            return np.full(n, opened, np.int64)
        ns, known = _clock.stamps(table, roles[role], "UTC", coarse=True)
        return np.where(known, ns, opened)

    notes = [*table.notes, *_build.unused(table, roles.values())]
    report = ReadReport("tags table", (table.file,), n, tuple(notes))
    return Tags(
        tag.array() if n else np.empty(0, "U1"),
        words("animal"),
        np.array([_kind(w) for w in words("sensor")], str),
        numbers("slope"),
        numbers("intercept"),
        numbers("min_delay"),
        numbers("max_delay"),
        times("start", OPEN_START),
        times("end", OPEN_END),
        words("receiver"),
        report,
    )


def _kind(word: str) -> str:
    """Return "depth" or "temperature" for the words that makers have for them."""
    low = word.strip().lower()
    if low in ("depth", "pressure", "d", "p"):
        return "depth"
    if low in ("temperature", "temp", "t"):
        return "temperature"
    return low
