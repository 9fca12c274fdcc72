"""Tables of the water's state: temperature and salinity, or sound speed, in time or by depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maloc.data import _arrays
from maloc.data._time import NS
from maloc.readers import _clock
from maloc.readers._columns import locate
from maloc.readers._text import Table, from_frame, read_table

__all__ = ["MediumTable", "read_medium"]

COLUMNS = {
    "time": "time timestamp datetime date_time time_utc datetime_utc",
    "depth": "depth depth_m z",
    "temperature": "temperature temp temperature_c t",
    "salinity": "salinity sal salinity_psu psal",
    "sound_speed": "sound_speed soundspeed sound_velocity ss",
    "temperature_sd": "temperature_sd",
    "salinity_sd": "salinity_sd",
    "sound_speed_sd": "sound_speed_sd",
}


class MediumTable(NamedTuple):
    """A table of the water's state, N rows as in the file.

    Attributes
    ----------
    time : array (N,) or None
        s since 1970 UTC.
    values : dict of array (N,)
        Any of depth (m), temperature (deg C), salinity, sound_speed (m/s), and their
        temperature_sd, salinity_sd, sound_speed_sd.
    table : Table
        Where they came from, to say where something is wrong.
    """

    time: np.ndarray | None
    values: dict[str, np.ndarray]
    table: Table

    @property
    def by_depth(self) -> bool:
        """Whether it is a profile: without times, or several depths at one time."""
        if "depth" not in self.values:
            return False
        if self.time is None:
            return True
        pairs = np.unique(np.column_stack([self.time, self.values["depth"]]), axis=0)
        return len(pairs) > len(np.unique(self.time))

    def error(self, problem: str, i: int | None = None, column: str | None = None, mend=None):
        """Return an InputError that names the file and the line of row `i`."""
        return self.table.error(problem, i, column, mend)


def read_medium(data: Any) -> MediumTable:
    """Read a table of the water's state.

    Parameters
    ----------
    data : path of a CSV or Parquet file, or a dataframe

    Raises
    ------
    InputError
        If a column that is needed lacks, or a value is missing or no number.
    """
    is_file = isinstance(data, str | Path)
    table = read_table(data) if is_file else from_frame("dataframe", _arrays.frame(data))
    roles = locate(table, COLUMNS)
    if not len(table):
        raise table.error("no rows, only a header")
    if not {"time", "depth"} & roles.keys():
        raise table.error(
            "no column 'time' and no column 'depth'",
            mend="give time for water that changes in time, depth for a profile, or both",
        )
    if "sound_speed" not in roles and "temperature" not in roles:
        raise table.error(
            "no column 'temperature'", mend="give temperature and salinity, or sound_speed"
        )
    values = {}
    for name in roles.keys() - {"time"}:
        values[name] = table.numbers(roles[name])
        lacking = np.flatnonzero(np.isnan(values[name]))
        if len(lacking):
            column = table.columns[roles[name]]
            raise table.error("a value is missing", int(lacking[0]), column)
        if name.endswith("_sd") and (values[name] < 0).any():
            i = int(np.argmax(values[name] < 0))
            raise table.error("an sd is negative", i, table.columns[roles[name]])
    time = None
    if "time" in roles:
        ns, known = _clock.stamps(table, roles["time"], "UTC", coarse=True)
        if not known.all():
            raise table.error("a time is missing", int(np.argmin(known)), "time")
        time = ns / NS
    return MediumTable(time, values, table)
