"""Detections: who heard which tag when, exactly as the receivers' clocks had it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc._package import moved
from maloc.data import _arrays
from maloc.data._tags import match_tag
from maloc.data._time import NS, duration, iso
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Detections"]


@dataclass(frozen=True, repr=False, eq=False)
class Detections:
    """A table of detections, validated once and read-only.

    Parameters
    ----------
    time : array (N,) of int64
        ns since 1970 UTC on the receiver's own clock, in the order of the input.
    receiver : array (N,) of str
        Serial or name of the receiver.
    tag : array (N,) of str
        Full tag id, code space kept ("A69-1602-15266").
    extra : mapping of str to array (N,)
        Further columns: signal, noise, snr, sensor, sensor_unit, depth, station, ...
    report : ReadReport
        What was read, and the notes made on the way.

    Raises
    ------
    InputError
        If lengths differ, times are not whole nanoseconds, or an id is missing.
    """

    time: np.ndarray
    receiver: np.ndarray
    tag: np.ndarray
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    report: ReadReport = field(default_factory=ReadReport)

    def __post_init__(self) -> None:
        time = _arrays.times(self.time, "time")
        n = len(time)
        extra = {}
        for name, values in dict(self.extra).items():
            column = np.array(values)
            if column.shape != (n,):
                raise InputError(f"extra '{name}' must have shape ({n},), got {column.shape}")
            column.setflags(write=False)
            extra[str(name)] = column
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "receiver", _arrays.text(self.receiver, "receiver", n))
        object.__setattr__(self, "tag", _arrays.text(self.tag, "tag", n))
        object.__setattr__(self, "extra", extra)

    def __reduce__(self):
        return Detections, (self.time, self.receiver, self.tag, dict(self.extra), self.report)

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def tags(self) -> tuple[str, ...]:
        """Tag ids present, sorted."""
        return tuple(map(str, np.unique(self.tag)))

    @cached_property
    def receivers(self) -> tuple[str, ...]:
        """Receivers present, sorted."""
        return tuple(map(str, np.unique(self.receiver)))

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last time, ns since 1970; None when there are no detections."""
        return (int(self.time.min()), int(self.time.max())) if len(self) else None

    def select(
        self,
        tag: object = None,
        receiver: str | Sequence[str] | None = None,
        mask: np.ndarray | None = None,
    ) -> Detections:
        """Return the detections of one tag, of some receivers, or where `mask` (N,) is true.

        Raises
        ------
        InputError
            If the tag is unknown or ambiguous (see `find_tag`).
        """
        keep = np.ones(len(self), bool) if mask is None else np.asarray(mask)
        if tag is not None:
            keep = keep & (self.tag == self.find_tag(tag))
        if receiver is not None:
            keep = keep & np.isin(self.receiver, np.atleast_1d(np.asarray(receiver, dtype=str)))
        return self.take(keep)

    def take(self, rows: np.ndarray) -> Detections:
        """Return the detections at these indices, in their order, or where a mask is true."""
        extra = {k: v[rows] for k, v in self.extra.items()}
        return Detections(self.time[rows], self.receiver[rows], self.tag[rows], extra, self.report)

    def find_tag(self, short: object) -> str:
        """Return the full id of a tag from a unique ending of it ("15266").

        Raises
        ------
        InputError
            If the ending is ambiguous (candidates named) or unknown (tags listed).
        """
        return match_tag(self.tags, short)

    @classmethod
    def from_frame(cls, data: Any, report: ReadReport | None = None) -> Detections:
        """Build from a dataframe with columns time (datetime or ns), receiver, tag, and others.

        Times as text, and other layouts, are for `maloc.read_detections`, which takes dataframes.

        Raises
        ------
        InputError
            If the columns fit no known layout, or an id or a time is missing.
        """
        import polars as pl

        df = _arrays.frame(data)
        whole = {"time", "receiver", "tag"} <= set(df.columns)
        if not whole or df["time"].dtype == pl.String:
            name = "Detections.from_frame of another layout"
            return moved.call(name, "maloc.readers", "read_detections", df)
        for name in ("time", "receiver", "tag"):
            if df[name].null_count():
                raise InputError(f"{df[name].null_count()} missing values", column=name)
        time = df["time"]
        if isinstance(time.dtype, pl.Datetime):
            if time.dtype.time_zone:
                time = time.dt.convert_time_zone("UTC")
            time = time.dt.cast_time_unit("ns").to_physical()
        extra = {c: df[c].to_numpy() for c in df.columns if c not in ("time", "receiver", "tag")}
        report = report or ReadReport("dataframe", rows=len(df))
        who, which = (np.asarray(df[c].cast(pl.String).to_list(), str) for c in ("receiver", "tag"))
        return cls(time.to_numpy(), who, which, extra, report)

    def to_frame(self) -> pl.DataFrame:
        """Return a polars DataFrame: time (UTC, ns), receiver, tag, and the extra columns."""
        import polars as pl

        time = pl.Series("time", self.time).cast(pl.Datetime("ns", "UTC"))
        head = {"receiver": self.receiver.tolist(), "tag": self.tag.tolist()}
        columns = [pl.Series(k, v, dtype=pl.String) for k, v in head.items()]
        columns += [
            pl.Series(k, v.tolist() if v.dtype == object else v) for k, v in self.extra.items()
        ]
        return pl.DataFrame([time, *columns])

    @staticmethod
    def concat(parts: Sequence[Detections], holders: str = "file") -> Detections:
        """Merge tables; detections present twice (same time, receiver and tag) are kept once.

        The number removed is noted in the report. Extra columns that a part lacks are missing
        (NaN or None) in its rows.

        Parameters
        ----------
        parts : sequence of Detections
            Earlier ones win.
        holders : str
            What the parts are, for the note.
        """
        parts = list(parts)
        if not parts:
            return Detections(np.empty(0, np.int64), np.empty(0, str), np.empty(0, str))
        if len(parts) == 1:
            return parts[0]
        time, receiver, tag = (
            np.concatenate([getattr(p, name) for p in parts])
            for name in ("time", "receiver", "tag")
        )
        extra = {
            name: _joined([(p.extra.get(name), len(p)) for p in parts])
            for name in dict.fromkeys(n for p in parts for n in p.extra)
        }
        first = _arrays.first_of_each(time, receiver, tag)
        report = ReadReport.merge(p.report for p in parts)
        if gone := int((~first).sum()):
            text = f"{gone} detections present in more than one {holders}, kept once"
            report = report.add(Note("info", text, gone))
            time, receiver, tag = time[first], receiver[first], tag[first]
            extra = {name: values[first] for name, values in extra.items()}
        report = ReadReport(report.format, report.files, len(time), report.notes)
        return Detections(time, receiver, tag, extra, report)

    def __repr__(self) -> str:
        tags, receivers = len(self.tags), len(self.receivers)
        if self.span is None:
            return "Detections: none"
        first, last = self.span
        return (
            f"Detections: {len(self)} of {tags} tag{'s' * (tags != 1)} by {receivers} "
            f"receiver{'s' * (receivers != 1)}, {iso(first)} to {iso(last)} UTC "
            f"({duration((last - first) / NS)}){self.report.flag}"
        )


def _joined(parts: list[tuple[np.ndarray | None, int]]) -> np.ndarray:
    """One column of several tables: numbers where all are, else objects; missing where absent."""
    there = [v for v, _ in parts if v is not None]
    if all(v.dtype.kind in "iufb" for v in there):
        whole = len(there) == len(parts) and all(v.dtype == there[0].dtype for v in there)
        kind = there[0].dtype if whole else np.dtype(float)
        return np.concatenate(
            [np.full(n, np.nan) if v is None else v.astype(kind) for v, n in parts]
        )
    return np.concatenate(
        [np.full(n, None, object) if v is None else v.astype(object) for v, n in parts]
    )
