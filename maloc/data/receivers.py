"""Receivers: where each one was and from when to when it listened, one element a deployment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc._package import moved
from maloc.data import _arrays
from maloc.data._time import OPEN_END, OPEN_START, iso
from maloc.data.report import ReadReport
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Receivers", "collinear", "serial"]


@dataclass(frozen=True, repr=False, eq=False)
class Receivers:
    """A table of deployments, validated once and read-only.

    Parameters
    ----------
    receiver : array (D,) of str
        Serial or name; several deployments of one receiver are several elements.
    x, y : array (D,) of float64
        Metres in a projected or local frame, finite.
    depth : array (D,) of float64, optional
        Metres, positive down; NaN = unknown.
    sync_tag : array (D,) of str, optional
        Id of the co-located sync tag, "" = none.
    start, end : array (D,) of int64, optional
        ns since 1970 UTC; listens from `start` up to, not including, `end`. The smallest and the
        largest int64 stand for "always".
    crs : str, optional
        Frame of x, y when it is known, such as "EPSG:32617".
    report : ReadReport
        What was read, and the notes made on the way.
    position_sd : array (D,) of float64, optional
        Standard deviation of the error of x, and of y, m; 0 = exact. None = nothing is known of
        it, and places are taken as they are.

    Raises
    ------
    InputError
        If lengths differ, a coordinate or an sd is not finite, an sd is negative, a deployment
        ends before it starts, or two deployments of one receiver overlap.
    """

    receiver: np.ndarray
    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    sync_tag: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    start: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    end: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    crs: str | None = None
    report: ReadReport = field(default_factory=ReadReport)
    position_sd: np.ndarray | None = None

    def __post_init__(self) -> None:
        receiver = _arrays.text(self.receiver, "receiver")
        n = len(receiver)

        def given(value: Any, default: Any, dtype: Any) -> Any:
            return np.full(n, default, dtype) if value is None else value

        start = _arrays.times(given(self.start, OPEN_START, np.int64), "start", n)
        end = _arrays.times(given(self.end, OPEN_END, np.int64), "end", n)
        checked = {
            "receiver": receiver,
            "x": _arrays.floats(self.x, "x", (n,), finite=True),
            "y": _arrays.floats(self.y, "y", (n,), finite=True),
            "depth": _arrays.floats(given(self.depth, np.nan, np.float64), "depth", (n,)),
            "sync_tag": _arrays.text(given(self.sync_tag, "", "U1"), "sync_tag", n),
            "start": start,
            "end": end,
        }
        if self.position_sd is not None:
            sd = _arrays.floats(self.position_sd, "position_sd", (n,), finite=True)
            if (sd < 0).any():
                raise InputError(f"position_sd {sd.min():g} m is negative")
            checked["position_sd"] = sd
        if (receiver == "").any():
            raise InputError("a receiver has no name")
        if problem := deployment_problem(receiver, start, end):
            raise InputError(problem[1])
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __reduce__(self):
        args = (self.receiver, self.x, self.y, self.depth, self.sync_tag, self.start, self.end)
        return Receivers, (*args, self.crs, self.report, self.position_sd)

    def __len__(self) -> int:
        return len(self.receiver)

    @property
    def names(self) -> tuple[str, ...]:
        """Receivers, each once, in the order of the table."""
        return tuple(dict.fromkeys(map(str, self.receiver)))

    @property
    def labels(self) -> tuple[str, ...]:
        """One unique name a deployment: the receiver, with #1, #2, ... where there are several."""
        seen: dict[str, int] = {}
        many = {r for r in self.names if (self.receiver == r).sum() > 1}
        out = []
        for r in map(str, self.receiver):
            seen[r] = seen.get(r, 0) + 1
            out.append(f"{r}#{seen[r]}" if r in many else r)
        return tuple(out)

    @property
    def xy(self) -> np.ndarray:
        """Positions (D, 2) in metres."""
        return np.column_stack([self.x, self.y])

    def subset(self, indices: Sequence[int] | np.ndarray) -> Receivers:
        """Return the deployments at these indices (or where a boolean mask is true), in order."""
        i = np.asarray(indices)
        i = i if i.dtype == bool else i.astype(np.int64)
        fields = ["receiver", "x", "y", "depth", "sync_tag", "start", "end"]
        fields += [] if self.position_sd is None else ["position_sd"]
        return replace(self, **{f: getattr(self, f)[i] for f in fields})

    def deployment_of(self, receiver: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return which deployment heard each detection.

        Parameters
        ----------
        receiver : array (N,) of str
            Receiver of each detection.
        time : array (N,) of int64
            ns since 1970 UTC.

        Returns
        -------
        array (N,) of int64
            Index of the deployment; -1 where the receiver is not in the table or was not deployed.
        """
        receiver, time = np.asarray(receiver, dtype=str), np.asarray(time, dtype=np.int64)
        receiver = self.canonical(receiver)
        out = np.full(len(receiver), -1, np.int64)
        for d in range(len(self)):
            mine = (receiver == self.receiver[d]) & (time >= self.start[d])
            out[mine & ((time < self.end[d]) | (self.end[d] == OPEN_END))] = d
        return out

    def knows(self, name: str) -> bool:
        """Say whether a receiver is in the table, by its name or by the serial number in it."""
        return str(self.canonical(np.asarray([name], dtype=str))[0]) in self.names

    def canonical(self, receiver: np.ndarray) -> np.ndarray:
        """Return names (N,) as the table has them: "VR2W-301001" and "301001" are one receiver."""
        names, table = np.unique(receiver), set(self.names)
        by_serial: dict[str, list[str]] = {}
        for n in self.names:
            by_serial.setdefault(serial(n), []).append(n)
        other = {}
        for n in map(str, names):
            same = by_serial.get(serial(n), [])
            if n not in table and len(same) == 1:
                other[n] = same[0]
        if not other:
            return receiver
        width = max(map(len, [*names, *other.values()]))
        out = receiver.astype(f"<U{width}")
        for old, new in other.items():
            out[receiver == old] = new
        return out

    def lonlat(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return longitude and latitude (degrees, WGS 84) of points of this frame.

        Raises
        ------
        InputError
            If the frame is not known (`crs` is None).
        """
        if self.crs is None:
            raise InputError("the receivers' frame is local", mend="give crs= to know lon and lat")
        from pyproj import Transformer

        to_degrees = Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True)
        lon, lat = to_degrees.transform(np.asarray(x, float), np.asarray(y, float))
        return np.asarray(lon), np.asarray(lat)

    @classmethod
    def from_frame(cls, data: Any, crs: str | None = None) -> Receivers:
        """Go with the next release: `maloc.read_receivers` takes a dataframe too."""
        name = "Receivers.from_frame"
        return moved.call(name, "maloc.readers", "read_receivers", data, crs=crs)

    def to_frame(self) -> pl.DataFrame:
        """Return a polars DataFrame: receiver, x, y, depth, sync_tag, start, end (null = open), sd.

        sd only where `position_sd` is known.
        """
        import polars as pl

        def times(values: np.ndarray, name: str, opened: int) -> pl.Series:
            out = [None if v == opened else v for v in values.tolist()]
            return pl.Series(name, out, dtype=pl.Int64).cast(pl.Datetime("ns", "UTC"))

        depth = pl.Series("depth", self.depth).fill_nan(None)
        return pl.DataFrame(
            [
                pl.Series("receiver", self.receiver.tolist(), dtype=pl.String),
                pl.Series("x", self.x),
                pl.Series("y", self.y),
                depth,
                pl.Series("sync_tag", [s or None for s in self.sync_tag.tolist()], dtype=pl.String),
                times(self.start, "start", OPEN_START),
                times(self.end, "end", OPEN_END),
                *([] if self.position_sd is None else [pl.Series("sd", self.position_sd)]),
            ]
        )

    def __repr__(self) -> str:
        n, names = len(self), len(self.names)
        if not n:
            return "Receivers: none"
        moved = f" in {n} deployments" if n != names else ""
        tags = int((self.sync_tag != "").sum())
        span = f"{np.ptp(self.x):.0f} x {np.ptp(self.y):.0f} m"
        frame = self.crs or "local frame"
        flag = self.report.flag
        return f"Receivers: {names}{moved}, {span}, {frame}, {tags} with a sync tag{flag}"


def serial(name: str) -> str:
    """Return the serial number in a maker's name (VR2W-301001, WHS4K-1900132), others unchanged."""
    return name.rsplit("-", 1)[-1] if re.match(r"(VR|HR|WHS)\d[^-]*-", name) else name


def deployment_problem(
    receiver: np.ndarray, start: np.ndarray, end: np.ndarray
) -> tuple[int, str] | None:
    """Return (index, sentence) of the first impossible deployment, None when all is well."""
    for i in np.flatnonzero(end <= start):
        when = f"ends ({iso(int(end[i]), 0)}) before it starts ({iso(int(start[i]), 0)})"
        return int(i), f"deployment of receiver {receiver[i]} {when}"
    order = np.lexsort((start, receiver))
    a, b = order[:-1], order[1:]
    for j in np.flatnonzero((receiver[a] == receiver[b]) & (start[b] < end[a])):
        return int(b[j]), (
            f"two deployments of receiver {receiver[b[j]]} overlap: one ends "
            f"{iso(int(end[a[j]]), 0)}, the next starts {iso(int(start[b[j]]), 0)}"
        )
    return None


def collinear(receivers: Receivers, tolerance: float = 1.0) -> bool:
    """Say whether all receivers stand on one line, so that every position has a mirror image.

    Parameters
    ----------
    receivers : Receivers
        At least one deployment.
    tolerance : float
        Largest distance from the best line that still counts as on it, m.

    Returns
    -------
    bool
        True also for fewer than three distinct places.
    """
    xy = receivers.xy
    if len(xy) < 3:
        return True
    centred = xy - xy.mean(0)
    across = np.linalg.svd(centred, full_matrices=False)[2][1]
    return bool(np.abs(centred @ across).max() <= tolerance)
