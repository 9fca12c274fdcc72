"""Moments of known true time, as files hold them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from maloc.data._time import NS
from maloc.data.report import ReadReport
from maloc.errors import InputError

__all__ = ["Anchors", "read_anchors"]

_COLUMNS = {
    "receiver": "receiver receiver_id receiver_sn serial serial_number hydro",
    "recorded": "recorded recorded_utc recorded_time receiver_time device_time",
    "true": "true true_utc true_time gps_time pc_time",
}


class Anchors(NamedTuple):
    """Moments at which the true time is known, in the order of `ClockSync.anchored`.

    Attributes
    ----------
    receiver : array (N,) of str
    recorded : array (N,) of int64
        What the receiver's clock showed, ns since 1970.
    true : array (N,) of int64
        True time then, ns since 1970.
    report : ReadReport
        What was noted while reading.
    """

    receiver: np.ndarray
    recorded: np.ndarray
    true: np.ndarray
    report: ReadReport


def read_anchors(path: str | Path) -> Anchors:
    """Read moments of known true time.

    Parameters
    ----------
    path : str or Path
        A table with columns receiver, recorded and true (ISO 8601; UTC where no zone is named).
        Or what receivers logged (VUE's events, a Fathom/VDAT log): its comparisons of a receiver's
        clock with a computer's.

    Raises
    ------
    InputError
        If the file is neither, a value is missing or no time, or there are no moments in it.
    """
    from maloc.readers import _clock, read_events, vdat, vue_events
    from maloc.readers._columns import locate
    from maloc.readers._files import load
    from maloc.readers._text import table_of

    file = load(path)
    table = None if vdat.sniff(file.data) else table_of(file)
    if table is None or vue_events.matches(table):
        events = read_events(path, tz="UTC")
        found = events.references
        true = found.time + np.rint(found.behind * NS).astype(np.int64)
        anchors = Anchors(found.receiver, found.time, true, events.report)
    else:
        roles = locate(table, _COLUMNS)
        if missing := [role for role in _COLUMNS if role not in roles]:
            raise table.error(
                f"no column '{missing[0]}'; header: {', '.join(table.columns)}",
                mend="give receiver, recorded and true, or a file of receiver events",
            )
        name = table.text(roles["receiver"])
        times = {role: _clock.stamps(table, roles[role]) for role in ("recorded", "true")}
        known = {"receiver": name.is_not_null().to_numpy(), **{r: t[1] for r, t in times.items()}}
        for role, there in known.items():
            if not there.all():
                row = int(np.argmin(there))
                raise table.error("a value is missing", row, table.columns[roles[role]])
        receiver = np.asarray(name.to_list(), str)
        report = ReadReport("anchors", (str(path),), len(receiver))
        anchors = Anchors(receiver, times["recorded"][0], times["true"][0], report)
    if not len(anchors.receiver):
        raise InputError("no moment of known true time", file=path)
    return anchors
