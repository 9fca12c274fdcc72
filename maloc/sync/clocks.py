"""ClockSync: every receiver's clock against one common time, and what to do with it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from maloc._package import moved
from maloc.data import Detections
from maloc.data._time import NS
from maloc.sync import _files, _tables, _text
from maloc.sync._anchor import anchored
from maloc.sync._apply import apply
from maloc.sync._clocks import Clocks
from maloc.sync._locate import SURE, locate, offset_of, offset_sd
from maloc.sync._records import ClockJumps, SyncResiduals

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

    from maloc.data.arrivals import ArrivalTimes

__all__ = ["ClockJumps", "ClockSync", "SyncResiduals"]


@dataclass(frozen=True, repr=False, eq=False)
class ClockSync(Clocks):
    """Clocks of all receivers against the common time, which is the clock of `reference`.

    The offset of a receiver is what its clock shows minus the common time: a cubic Hermite curve
    between knots plus the jumps before. Beyond its own sync detections it goes on straight.

    Parameters
    ----------
    receivers : Receivers
        With the fitted places.
    reference : str
        Receiver whose clock is the common time (but for its jumps, and unless anchored).
    origin : int
        ns since 1970 of second 0 of the common time.
    knots : array (K,)
        Common time, s from `origin`, equally spaced.
    values, slopes : array (R, K)
        Offset without jumps (s) and its slope (s/s) at the knots, one row a receiver in the order
        of `receivers.names`; NaN = not synchronised.
    values_sd : array (R, K)
        Standard error of `values`, s.
    noise : array (R,)
        Intensity of each clock's integrated random walk, s^2/s^3.
    covariance : array (M, 4, 4)
        Of offset and slope times spacing at both ends of each interval between knots, s^2, jumps
        included: the K - 1 intervals of the first receiver, one with a jump once for each side of
        it, then those of the next.
    jumps : ClockJumps
    speeds, speeds_sd : array (K,)
        Sound speed at the knots, m/s; sd 0 = it was given.
    span : array (R, 2)
        First and last sync detection used of each receiver, common time, s; NaN as above.
    sigma : float
        Error sd of direct arrivals, s.
    reflected : float
        Share of sync arrivals that came late.
    delay, delay_sd : array (D,)
        How late each deployment hears its own sync tag, s; 0 = it never did.
    position_sd : array (D, 2)
        Standard error of the fitted x, y of each deployment, m; 0 = held.
    shift : array (D, 2)
        Fitted minus given x, y, m.
    residuals : SyncResiduals
    value_draws, slope_draws : array (S, R, K)
        Posterior draws of `values` and `slopes`.
    jump_draws : array (S, J)
        Of the jumps' sizes, s.
    notes : tuple of Note
    """

    def offset(self, receiver: object, time: object) -> np.ndarray:
        """Return what to subtract from recorded times to get the common time.

        Parameters
        ----------
        receiver : str or array (N,) of str
        time : int or array (N,) of int64
            Recorded, ns since 1970.

        Returns
        -------
        array (N,)
            Offset, s; NaN where the receiver is not synchronised, or a jump of its clock leaves it
            open (it shows some times twice, or none is known on which side a time lies).
        """
        return offset_of(self, receiver, time)

    def offset_sd(self, receiver: object, time: object) -> np.ndarray:
        """Return the standard error of `offset`, s: it grows in silences and beyond the data.

        Parameters
        ----------
        receiver, time
            As in `offset`.
        """
        time = np.atleast_1d(np.asarray(time, np.int64))
        at = locate(self, np.broadcast_to(np.asarray(receiver, dtype=str), time.shape), time)
        sd = offset_sd(self, np.maximum(at.clock, 0), at.segment, at.common)
        return np.where(at.status == SURE, sd, np.nan)

    def clock_sd(self, toa: ArrivalTimes) -> np.ndarray:
        """Return how sure the clocks were when they heard a tag's pings.

        Parameters
        ----------
        toa : ArrivalTimes
            P pings, R deployments, on the common clock.

        Returns
        -------
        array (P, R)
            Standard error of the offset, s; 0 for receivers that were not synchronised.
        """
        names = {name: i for i, name in enumerate(self.receivers.names)}
        clock = [names.get(str(r), -1) for r in toa.receivers.receiver]
        time = toa.first + ((toa.origin or 0) - self.origin) / NS
        columns = []
        for i in clock:
            if i < 0 or not self.synced[i]:
                columns.append(0 * time)
                continue
            own = np.sort(self.jumps.time[self.jumps.receiver == self.receivers.names[i]])
            segment = np.searchsorted(own, time)
            columns.append(offset_sd(self, np.full(len(time), i), segment, time))
        return np.stack(columns, axis=1)

    def draws(self) -> list[ClockSync]:
        """Return posterior draws of all clocks.

        Clocks err alike from ping to ping, so that a track's mean error is not told by
        `clock_sd`: fit with each of some draws instead, and pool.
        """
        each = zip(self.value_draws, self.slope_draws, self.jump_draws, strict=True)
        return [
            dataclasses.replace(
                self, values=values, slopes=slopes, jumps=dataclasses.replace(self.jumps, size=size)
            )
            for values, slopes, size in each
        ]

    def anchored(self, receiver: object, recorded: object, true: object) -> ClockSync:
        """Put the common time right by moments at which the true time is known.

        A line is fitted to common less true time (a constant to moments within an hour), so that
        neither the relations of the clocks to each other nor positions change.

        Parameters
        ----------
        receiver : str or array (N,) of str
        recorded : array (N,) of int64
            What the receiver's clock showed, ns since 1970: at its initialisation, at its offload,
            or when a boat with a GPS clock was beside it.
        true : array (N,) of int64
            True time then, ns since 1970.

        Returns
        -------
        ClockSync

        Raises
        ------
        InputError
            If none of the moments can be placed on the common clock.
        """
        return anchored(self, receiver, recorded, true)

    def apply(self, detections: Detections) -> Detections:
        """Put detections on the common clock.

        A detection whose receiver is not synchronised, or that lies further than one knot spacing
        before or after the receiver's sync detections, is set aside: left out, counted and noted.
        So is one of which a jump of the clock leaves open when it was.

        Parameters
        ----------
        detections : Detections

        Returns
        -------
        Detections
            Times in int64 ns on the common clock, in the order of the input; the extra column
            `clock_sd` is the standard error of each, s.
        """
        return apply(self, detections)

    def residuals_frame(self) -> pl.DataFrame:
        """Return the residuals as a polars DataFrame, one row a sync detection."""
        return _tables.residuals_frame(self)

    def jumps_frame(self) -> pl.DataFrame:
        """Return the jumps as a polars DataFrame: receiver, time, low, high (UTC), size, sd (s)."""
        return _tables.jumps_frame(self)

    def links_frame(self) -> pl.DataFrame:
        """Return how each link (a sync tag heard by a receiver) fits, a row a link.

        Columns: sync_tag, receiver, distance (m), detections, in_fit, used, median and sd of the
        residuals used (s).
        """
        return _tables.links_frame(self)

    def summary(self) -> str:
        """Return the fit in a page of text."""
        return _text.summary(self)

    def to_netcdf(self, path: str | Path) -> None:
        """Write everything to a NetCDF file (h5netcdf)."""
        _files.to_netcdf(self, path)

    @staticmethod
    def from_netcdf(path: str | Path) -> ClockSync:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        InputError
            If the file is not one.
        """
        return ClockSync(**_files.from_netcdf(path))

    def write(self, folder: str | Path, detections: Detections | None = None) -> list[Path]:
        """Go with the next release: `maloc.runs.sync.write_sync` does this."""
        name = "ClockSync.write"
        return moved.call(name, "maloc.runs.sync", "write_sync", self, folder, detections)

    def __repr__(self) -> str:
        n, total = int(self.synced.sum()), len(self.synced)
        return (
            f"ClockSync: {n} of {total} receivers on the clock of {self.reference}, "
            f"{int(self.residuals.used.sum())} sync arrivals, residual sd "
            f"{1e3 * self.residual_sd:.2f} ms, sound speed {self.sound_speed:.1f} m/s"
        )
