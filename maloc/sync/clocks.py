"""ClockSync: every receiver's clock against one common time, and what to do with it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import InputError
from maloc.sync._locate import SURE, TWICE, UNSURE, locate, offset_sd
from maloc.sync._prepare import seconds

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

    from maloc.data.arrivals import ArrivalTimes

__all__ = ["ClockJumps", "ClockSync", "SyncResiduals"]

NS = 1_000_000_000


@dataclass(frozen=True, repr=False, eq=False)
class SyncResiduals:
    """Every sync detection and how it fits, arrays (N,) in the order of the detections' table.

    Parameters
    ----------
    row : int
        Row of the detections' table.
    ping : int
        Sync ping, numbered from 1 in time order; 0 = in none.
    sync_tag, receiver : str
    time : int64
        Recorded time, ns since 1970.
    distance : float
        From the sync tag to the receiver, at the fitted places, m.
    offset : float
        Recorded less common time, s; NaN = in no ping of the fit.
    residual : float
        Arrival less expected arrival on the common clock, s; NaN = in no ping of the fit.
    p_direct : float
        Posterior probability that the arrival came by the direct path; NaN = not in the fit.
    why : str
        Why it was left out or does not count; "" = used.
    """

    row: np.ndarray
    ping: np.ndarray
    sync_tag: np.ndarray
    receiver: np.ndarray
    time: np.ndarray
    distance: np.ndarray
    offset: np.ndarray
    residual: np.ndarray
    p_direct: np.ndarray
    why: np.ndarray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def used(self) -> np.ndarray:
        """Whether an arrival counts (N,)."""
        return np.asarray(self.why == "")

    def __repr__(self) -> str:
        return f"SyncResiduals: {len(self)} sync detections, {int(self.used.sum())} used"


@dataclass(frozen=True, eq=False)
class ClockJumps:
    """Jumps of clocks, arrays (J,).

    Parameters
    ----------
    receiver : str
    time : float
        Common time, s from the origin: midway between the sync detections around it.
    low, high : float
        Between which it lies for sure, s: two sync detections of the receiver.
    size, size_sd : float
        By how much the clock stepped forward, s.
    """

    receiver: np.ndarray
    time: np.ndarray
    low: np.ndarray
    high: np.ndarray
    size: np.ndarray
    size_sd: np.ndarray

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, repr=False, eq=False)
class ClockSync:
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

    receivers: Receivers
    reference: str
    origin: int
    knots: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    values_sd: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    jumps: ClockJumps
    speeds: np.ndarray
    speeds_sd: np.ndarray
    span: np.ndarray
    sigma: float
    reflected: float
    delay: np.ndarray
    delay_sd: np.ndarray
    position_sd: np.ndarray
    shift: np.ndarray
    residuals: SyncResiduals
    value_draws: np.ndarray
    slope_draws: np.ndarray
    jump_draws: np.ndarray
    notes: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        shape = (len(self.receivers.names), len(self.knots))
        for name in ("values", "slopes", "values_sd"):
            if getattr(self, name).shape != shape:
                raise InputError(f"ClockSync.{name} must have shape {shape}")
        if self.reference not in self.receivers.names:
            raise InputError(f"reference '{self.reference}' is not among the receivers")

    @property
    def spacing(self) -> float:
        """Distance between knots, s."""
        return float(self.knots[1] - self.knots[0])

    @property
    def synced(self) -> np.ndarray:
        """Whether each receiver of `receivers.names` is synchronised (R,)."""
        return np.asarray(np.isfinite(self.values).all(axis=1))

    @property
    def sound_speed(self) -> float:
        """Sound speed, m/s, its mean where it varies."""
        return float(1 / np.mean(1 / self.speeds))

    @property
    def sound_speed_sd(self) -> float:
        """Standard error of the sound speed, m/s; 0 = it was given."""
        return float(self.speeds_sd.mean())

    @property
    def residual_sd(self) -> float:
        """Standard deviation of the residuals that count, s."""
        used = self.residuals.used
        return float(self.residuals.residual[used].std()) if used.any() else float("nan")

    @property
    def residual_mad(self) -> float:
        """1.4826 times the median absolute deviation of the residuals that count, s."""
        r = self.residuals.residual[self.residuals.used]
        return float(1.4826 * np.median(np.abs(r - np.median(r)))) if len(r) else float("nan")

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
        time = np.atleast_1d(np.asarray(time, np.int64))
        at = locate(self, np.broadcast_to(np.asarray(receiver, dtype=str), time.shape), time)
        return np.where(at.status == SURE, seconds(time, self.origin) - at.common, np.nan)

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
        from maloc.sync._anchor import anchored

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
        at = locate(self, detections.receiver, detections.time)
        known = at.status == SURE
        span = np.nan_to_num(self.span)[np.maximum(at.clock, 0)]
        away = np.maximum(span[:, 0] - at.common, at.common - span[:, 1])
        outside = known & (away > self.spacing)
        report = detections.report
        minutes = f"{self.spacing / 60:.0f} min"
        for rows, level, what in (
            (at.clock < 0, "warning", "set aside: their receivers' clocks are not synchronised"),
            (
                at.status == UNSURE,
                "warning",
                "set aside: a jump of their receiver's clock lies between its sync detections "
                "before and after",
            ),
            (
                at.status == TWICE,
                "warning",
                "set aside: their receiver's clock jumped back and showed these times twice",
            ),
            (
                outside,
                "warning",
                f"set aside: more than {minutes} before the first or after the last sync "
                "detection of their receiver",
            ),
            (
                known & (away > 0) & ~outside,
                "info",
                "before the first or after the last sync detection of their receiver, clock "
                f"carried on straight by at most {minutes}",
            ),
        ):
            if n := int(rows.sum()):
                who = ", ".join(map(str, np.unique(detections.receiver[rows])))
                report = report.add(Note(level, f"{n} detections {what} ({who})", n))
        keep = known & ~outside
        offset = seconds(detections.time, self.origin) - at.common
        # the offset, not the time, goes through a float: nanoseconds survive
        time = detections.time - np.round(offset * NS).astype(np.int64)
        sd = offset_sd(self, np.maximum(at.clock, 0), at.segment, at.common)
        extra = {**detections.extra, "clock_sd": sd}
        kept = dataclasses.replace(detections, time=time, extra=extra, report=report)
        return kept.select(mask=keep)

    def jump_text(self, j: int) -> str:
        """Return a sentence on jump `j`."""
        q = self.jumps
        start = np.datetime64(self.origin, "ns")
        low, high = (
            str(start + np.timedelta64(round(float(t[j]) * NS), "ns"))[:19] for t in (q.low, q.high)
        )
        return (
            f"the clock of receiver {q.receiver[j]} jumps by {q.size[j]:+.4g} s between {low} and "
            f"{high} (common time); it is followed across"
        )

    def residuals_frame(self) -> pl.DataFrame:
        """Return the residuals as a polars DataFrame, one row a sync detection."""
        import polars as pl

        r = self.residuals
        return pl.DataFrame(
            {
                "ping": r.ping,
                "sync_tag": r.sync_tag.astype(str).tolist(),
                "receiver": r.receiver.astype(str).tolist(),
                "time": pl.Series(r.time).cast(pl.Datetime("ns", "UTC")),
                "distance": r.distance,
                "offset": pl.Series(r.offset).fill_nan(None),
                "residual": pl.Series(r.residual).fill_nan(None),
                "p_direct": pl.Series(r.p_direct).fill_nan(None),
                "used": r.used,
                "why": r.why.astype(str).tolist(),
            }
        )

    def jumps_frame(self) -> pl.DataFrame:
        """Return the jumps as a polars DataFrame: receiver, time, low, high (UTC), size, sd (s)."""
        import polars as pl

        q = self.jumps
        ns = {
            name: pl.Series(self.origin + np.round(getattr(q, name) * NS).astype(np.int64)).cast(
                pl.Datetime("ns", "UTC")
            )
            for name in ("time", "low", "high")
        }
        return pl.DataFrame(
            {"receiver": q.receiver.astype(str).tolist(), **ns, "size": q.size, "sd": q.size_sd},
            schema_overrides={"receiver": pl.String},
        )

    def links_frame(self) -> pl.DataFrame:
        """Return how each link (a sync tag heard by a receiver) fits, a row a link.

        Columns: sync_tag, receiver, distance (m), detections, in_fit, used, median and sd of the
        residuals used (s).
        """
        import polars as pl

        used = pl.col("residual").filter(pl.col("used"))
        return (
            self.residuals_frame()
            .group_by("sync_tag", "receiver")
            .agg(
                pl.col("distance").mean(),
                pl.len().alias("detections"),
                pl.col("p_direct").count().alias("in_fit"),
                pl.col("used").sum(),
                used.median().alias("median"),
                used.std().alias("sd"),
            )
            .sort("sync_tag", "receiver")
        )

    def summary(self) -> str:
        """Return the fit in a page of text."""
        from maloc.sync._text import summary

        return summary(self)

    def to_netcdf(self, path: str | Path) -> None:
        """Write everything to a NetCDF file (h5netcdf)."""
        from maloc.sync._files import to_netcdf

        to_netcdf(self, path)

    @staticmethod
    def from_netcdf(path: str | Path) -> ClockSync:
        """Read what `to_netcdf` wrote.

        Raises
        ------
        InputError
            If the file is not one.
        """
        from maloc.sync._files import from_netcdf

        return from_netcdf(path)

    def write(self, folder: str | Path, detections: Detections | None = None) -> list[Path]:
        """Write the files of `maloc sync` into an existing folder; returns their paths.

        sync.nc, receivers_fitted.csv, residuals.csv, links.csv, jumps.csv, figures and, when the
        detections are given, detections_synced.parquet.
        """
        from maloc.sync._files import write

        return write(self, folder, detections)

    def __repr__(self) -> str:
        n, total = int(self.synced.sum()), len(self.synced)
        return (
            f"ClockSync: {n} of {total} receivers on the clock of {self.reference}, "
            f"{int(self.residuals.used.sum())} sync arrivals, residual sd "
            f"{1e3 * self.residual_sd:.2f} ms, sound speed {self.sound_speed:.1f} m/s"
        )
