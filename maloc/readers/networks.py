"""Detection extracts of the networks: OTN (three generations of names), GLATOS, ETN.

Whole seconds as a rule: enough for who heard what, not for positions by arrival times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import polars as pl

from maloc.data.detections import Detections
from maloc.readers import _build, _clock
from maloc.readers._build import Ids
from maloc.readers._columns import plain
from maloc.readers._how import How
from maloc.readers._text import Table

__all__ = ["ETN", "GLATOS", "OTN", "Network"]


class Network(NamedTuple):
    """An extract's format: what its columns are called, in order of preference.

    Parameters
    ----------
    NAME, TITLE : str
        Short name and name for messages.
    time, device, receiver, tag : str
        Names of columns, space-separated; `device`: the time before clock correction.
    codespace : str
        Column with the code space, where `tag` is a number alone.
    extra : dict
        Column by the name under which it is carried along.
    also : str
        A column that must be there too, for recognition.
    """

    NAME: str
    TITLE: str
    time: str
    device: str
    receiver: str
    tag: str
    codespace: str
    extra: dict[str, str]
    also: str

    def _roles(self, table: Table) -> dict[str, int]:
        simple = [plain(c) for c in table.columns]
        out = {}
        for role in ("time", "device", "receiver", "tag", "codespace"):
            for name in getattr(self, role).split():
                if name in simple and role not in out:
                    out[role] = simple.index(name)
        return out

    def matches(self, table: Table) -> bool:
        """Say whether the header is this network's."""
        simple = {plain(c) for c in table.columns}
        there = bool(simple & set(self.also.split()))
        return there and {"time", "receiver", "tag"} <= self._roles(table).keys()

    def read(self, table: Table, how: How) -> Detections:
        """Read an extract; rows of releases are no detections and are set aside.

        Raises
        ------
        InputError
            If a time cannot be read, or is local and its zone is not said.
        """
        roles = self._roles(table)
        simple = [plain(c) for c in table.columns]
        table = _without_releases(table, roles, simple)
        k = roles["time"]
        if how.clock in ("device", "linear") and "device" in roles:
            k = roles["device"]
            text = f"'{table.columns[k]}', not corrected, used as asked"
            table = _build.merge_notes(table, table.note("info", text, len(table)))
        table = _build.clean(table, [k, roles["receiver"], roles["tag"]])
        time, _ = _clock.stamps(table, k, self._zone(table, simple, k, how))
        tag = Ids.of(table.text(roles["tag"]))
        if "codespace" in roles:
            space = Ids.of(table.text(roles["codespace"]).fill_null(""))
            tag = space.join(tag, "\n").to(with_codespace)
        wanted = {
            name: simple.index(c)
            for name, columns in self.extra.items()
            for c in columns.split()
            if c in simple
        }
        extra = _build.extras(table, wanted)
        receiver = Ids.of(table.text(roles["receiver"]))
        used = [*roles.values(), *wanted.values()]
        return _build.detections(table, self.TITLE, time, receiver, tag, extra, used)

    def _zone(self, table: Table, simple: list[str], k: int, how: How) -> str | None:
        if simple[k].endswith("utc"):
            return "UTC"
        if "timezone" in simple and len(table):
            said = table.text(simple.index("timezone")).unique().to_list()
            if len(said) == 1 and str(said[0]).upper() in ("UTC", "GMT", "Z"):
                return "UTC"
            if said != [None]:
                if how.tz is None:
                    names = ", ".join(map(str, said))
                    raise table.error(
                        f"the column 'timezone' says {names}",
                        mend="say the zone of the times with --tz (tz= in Python)",
                    )
                return how.tz
        return how.tz or ("UTC" if self.NAME == "etn" else None)


def with_codespace(joined: str) -> str:
    """Return "A69-1602-12345" for "A69-1602", newline, "12345"; a whole id stays as it is."""
    space, _, number = joined.partition("\n")
    return f"{space}-{number}" if space and "-" not in number else number


def _without_releases(table: Table, roles: dict[str, int], simple: list[str]) -> Table:
    gone = np.zeros(len(table), bool)
    for k in (roles["receiver"], *(simple.index(c) for c in ("station",) if c in simple)):
        text = table.text(k)
        if text.dtype == pl.String:
            gone |= (text.str.to_lowercase() == "release").fill_null(False).to_numpy()
    if not gone.any():
        return table
    count = int(gone.sum())
    text = f"{count} release{'s' * (count != 1)} set aside, no detections"
    return table.rows(~gone, table.note("info", text, count, int(table.line[gone][0])))


OTN = Network(
    "otn",
    "OTN detection extract",
    "datecollectedutc datecollected",
    "uncorrecteddatecollectedutc",
    "receiver",
    "tagname",
    "codespace",
    {
        "animal": "catalognumber",
        "station": "station",
        "sensor": "sensorvalue",
        "sensor_unit": "sensorunit",
        "sensor_raw": "sensorraw",
        "longitude": "decimallongitude longitude",
        "latitude": "decimallatitude latitude",
    },
    "collectioncode unqdetecid",
)
GLATOS = Network(
    "glatos",
    "GLATOS detection export",
    "detection_timestamp_utc",
    "",
    "receiver_sn",
    "transmitter_id",
    "transmitter_codespace",
    {
        "animal": "animal_id",
        "station": "station",
        "sensor": "sensor_value",
        "sensor_unit": "sensor_unit",
        "longitude": "deploy_long",
        "latitude": "deploy_lat",
    },
    "glatos_array",
)
ETN = Network(
    "etn",
    "ETN detection extract",
    "date_time",
    "",
    "receiver_id",
    "acoustic_tag_id",
    "",
    {
        "animal": "animal_id",
        "station": "station_name",
        "sensor": "sensor_value parameter",
        "sensor_unit": "sensor_unit",
        "snr": "snr signal_to_noise_ratio",
        "longitude": "deploy_longitude",
        "latitude": "deploy_latitude",
    },
    "acoustic_tag_id",
)
