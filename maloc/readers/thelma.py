"""Thelma Biotel exports: the old one with a millisecond column, and Fish Commander's."""

from __future__ import annotations

import numpy as np

from maloc.data._time import NS
from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["NAME", "TITLE", "matches", "read"]

NAME = "thelma"
TITLE = "Thelma Biotel CSV (Unix Timestamp (UTC), ID, Data, Protocol, SNR, Receiver)"
_OLD = {"unix_timestamp_utc", "tbr_serial_number", "millisecond", "codetype", "id"}
_NEW = {"unix_timestamp_utc", "id", "protocol", "receiver"}


def matches(table: Table) -> bool:
    """Say whether the header is one of Thelma's two."""
    simple = {plain(c) for c in table.columns}
    return simple >= _OLD or simple >= _NEW


def read(table: Table, how: How) -> Detections:
    """Read a Thelma export; the tag id is code space and number, such as "R64K-345".

    Times come from the Unix column (and `Millisecond`, an integer count: 5 = .005 s); the date
    column must agree with it. No zone is needed.

    Raises
    ------
    InputError
        If a value cannot be read, or date and Unix time of a row disagree.
    """
    simple = [plain(c) for c in table.columns]
    old = set(simple) >= _OLD
    at = {name: simple.index(name) for name in (_OLD if old else _NEW)}
    code, who = ("codetype", "tbr_serial_number") if old else ("protocol", "receiver")
    table = _build.clean(table, [at["unix_timestamp_utc"], at["id"], at[code], at[who]])
    time, known = _clock.seconds(table, at["unix_timestamp_utc"])
    _clock.refuse_outside(table, time, known, at["unix_timestamp_utc"])
    if old:
        time = time + _milliseconds(table, at["millisecond"], time)
    _check_dates(table, simple, time)
    space = Ids.of(table.text(at[code])).to(lambda name: name.partition("-")[0])
    tag = space.join(Ids.of(table.text(at["id"])))
    names = {"sensor": "data", "snr": "signal_to_noise_ratio" if old else "snr"}
    wanted = {role: simple.index(c) for role, c in names.items() if c in simple}
    extra = _build.extras(table, wanted, missing=("-",))
    receiver, format = Ids.of(table.text(at[who])), f"Thelma CSV ({'old' if old else 'new'})"
    dates = [k for k, c in enumerate(simple) if c.startswith("date_and_time")]
    used = [*at.values(), *wanted.values(), *dates]
    return _build.detections(table, format, time, receiver, tag, extra, used)


def _milliseconds(table: Table, k: int, time: np.ndarray) -> np.ndarray:
    ms = table.numbers(k)
    bad = np.flatnonzero(~((ms >= 0) & (ms < 1000) & (ms % 1 == 0)))
    if len(bad):
        raise table.error(
            "not a whole number of milliseconds in 0..999", int(bad[0]), table.columns[k]
        )
    if (time % NS).any():
        i = int(np.flatnonzero(time % NS)[0])
        raise table.error("the Unix time has a fraction and so has Millisecond", i)
    return ms.astype(np.int64) * 1_000_000


def _check_dates(table: Table, simple: list[str], time: np.ndarray) -> None:
    k = next((k for k, c in enumerate(simple) if c.startswith("date_and_time")), None)
    if k is None:
        return
    date, known = _clock.stamps(table, k, "UTC")
    off = np.flatnonzero(known & (np.abs(date - time) > NS))
    if len(off):
        raise table.error(
            "date and Unix time differ", int(off[0]), table.columns[k], "is the date local time?"
        )
