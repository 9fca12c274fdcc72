"""Positions found by others: a vendor's, a GPS's, another program's, to compare tracks with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import _arrays
from maloc.data._time import NS, duration, iso
from maloc.data.report import Note, ReadReport
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Positions"]


@dataclass(frozen=True, repr=False, eq=False)
class Positions:
    """A table of positions, one a row.

    Parameters
    ----------
    time : array (N,) of int64
        ns since 1970 UTC.
    tag : array (N,) of str
        Tag or animal.
    x, y : array (N,) of float64
        Metres in the frame of the file (`crs` where it is known); NaN where it has degrees only.
    longitude, latitude : array (N,) of float64, optional
        Degrees, WGS 84; NaN = unknown.
    extra : mapping of str to array (N,)
        Further columns: hpe, hpem (m), depth (m), n, heard, used, sd_x, sd_y (m), outlier, ...
    crs : str, optional
        Frame of x, y.
    report : ReadReport
        What was read, and the notes made on the way.
    """

    time: np.ndarray
    tag: np.ndarray
    x: np.ndarray
    y: np.ndarray
    longitude: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    latitude: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    crs: str | None = None
    report: ReadReport = field(default_factory=ReadReport)

    def __post_init__(self) -> None:
        time = _arrays.times(self.time, "time")
        n = len(time)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "tag", _arrays.text(self.tag, "tag", n))
        for name in ("x", "y", "longitude", "latitude"):
            given = getattr(self, name)
            values = np.full(n, np.nan) if given is None else given
            object.__setattr__(self, name, _arrays.floats(values, name, (n,)))
        for name, values in self.extra.items():
            if np.shape(values) != (n,):
                raise InputError(f"extra '{name}' must have shape ({n},), got {np.shape(values)}")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def xy(self) -> np.ndarray:
        """Positions (N, 2), m."""
        return np.column_stack([self.x, self.y])

    def in_frame(self, crs: str) -> Positions:
        """Return the positions in a projected frame, from their longitude and latitude.

        Where the file had metres of its own too, such as a VPS's, how far its frame lies from this
        one is noted: the shift, and what is left of the differences after it.

        Raises
        ------
        InputError
            If there is no longitude and latitude.
        """
        from pyproj import Transformer

        known = np.isfinite(self.longitude) & np.isfinite(self.latitude)
        if not known.any():
            raise InputError("positions without longitude and latitude cannot be projected")
        to_metres = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        x, y = np.full((2, len(self)), np.nan)
        x[known], y[known] = to_metres.transform(self.longitude[known], self.latitude[known])
        both = np.isfinite(x) & np.isfinite(self.x)
        report = self.report
        if both.any():
            apart = np.column_stack([x - self.x, y - self.y])[both]
            shift = apart.mean(0)
            left = np.hypot(*(apart - shift).T).max()
            text = (
                f"the file's own metres lie {shift[0]:.1f}, {shift[1]:.1f} m from {crs}; up to "
                f"{left:.2f} m are left after that shift"
            )
            report = report.add(Note("info", text, int(both.sum())))
        return replace(self, x=x, y=y, crs=crs, report=report)

    def at(self, time: np.ndarray, within: float = 60.0) -> np.ndarray:
        """Return positions between these ones, straight from one to the next.

        Parameters
        ----------
        time : array (M,) of int64
            ns since 1970 UTC.
        within : float
            Longest gap that is bridged, s.

        Returns
        -------
        array (M, 2)
            m; NaN outside, and in longer gaps.
        """
        rows = np.flatnonzero(np.isfinite(self.x) & np.isfinite(self.y))
        rows = rows[np.argsort(self.time[rows], kind="stable")]
        t, when = self.time[rows], np.asarray(time, np.int64)
        out = np.full((len(when), 2), np.nan)
        if len(t) < 2:
            return out
        i = np.clip(np.searchsorted(t, when, side="right"), 1, len(t) - 1)
        inside = (when >= t[0]) & (when <= t[-1]) & (t[i] - t[i - 1] <= within * NS)
        share = (when - t[i - 1]) / np.maximum(t[i] - t[i - 1], 1)
        xy = self.xy[rows]
        found = xy[i - 1] + share[:, None] * (xy[i] - xy[i - 1])
        out[inside] = found[inside]
        return out

    def to_frame(self) -> pl.DataFrame:
        """Return a polars DataFrame: time (UTC), tag, x, y, longitude, latitude, extra columns."""
        import polars as pl

        time = pl.Series("time", self.time).cast(pl.Datetime("ns", "UTC"))
        columns = [time, pl.Series("tag", self.tag.tolist(), dtype=pl.String)]
        for name in ("x", "y", "longitude", "latitude"):
            columns.append(pl.Series(name, getattr(self, name)).fill_nan(None))
        for name, values in self.extra.items():
            columns.append(pl.Series(name, values.tolist() if values.dtype == object else values))
        return pl.DataFrame(columns)

    def __repr__(self) -> str:
        if not len(self):
            return "Positions: none"
        first, last = int(self.time.min()), int(self.time.max())
        tags = len(np.unique(self.tag))
        return (
            f"Positions: {len(self)} of {tags} tag{'s' * (tags != 1)}, {iso(first)} to "
            f"{iso(last)} UTC ({duration((last - first) / NS)}){self.report.flag}"
        )
