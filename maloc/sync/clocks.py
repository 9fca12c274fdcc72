"""ClockSync: every receiver's clock against one common time, and what to do with it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from maloc.data import Detections, Note, Receivers
from maloc.errors import InputError
from maloc.sync._curve import evaluate, to_common
from maloc.sync._prepare import seconds

if TYPE_CHECKING:
    from pathlib import Path

    import polars as pl

    from maloc.data.arrivals import ArrivalTimes

__all__ = ["ClockSync", "SyncResiduals"]

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


@dataclass(frozen=True, repr=False, eq=False)
class ClockSync:
    """Clocks of all receivers against the common time, which is the clock of `reference`.

    The offset of a receiver is what its clock shows minus the common time. Between knots it is a
    cubic Hermite curve; beyond its own sync detections it goes on straight.

    Parameters
    ----------
    receivers : Receivers
        With the fitted places.
    reference : str
        Receiver whose clock is the common time.
    sound_speed, sound_speed_sd : float
        m/s; sd 0 = it was given.
    origin : int
        ns since 1970 of second 0 (nominal: on the reference's clock).
    knots : array (K,)
        Common time, s from `origin`, equally spaced.
    values, slopes : array (R, K)
        Offset (s) and its slope (s/s) at the knots, one row a receiver in the order of
        `receivers.names`; NaN = not synchronised.
    values_sd : array (R, K)
        Standard error of the offset, s.
    span : array (R, 2)
        First and last sync detection used of each receiver, common time, s; NaN as above.
    jumped : array (R,) of bool
        The clock jumped, and only its longest stretch is synchronised.
    sigma : float
        Error sd of direct arrivals, s.
    reflected : float
        Share of sync arrivals that came late.
    position_sd : array (D, 2)
        Standard error of the fitted x, y of each deployment, m; 0 = held.
    shift : array (D, 2)
        Fitted minus given x, y, m.
    residuals : SyncResiduals
    notes : tuple of Note
    """

    receivers: Receivers
    reference: str
    sound_speed: float
    sound_speed_sd: float
    origin: int
    knots: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    values_sd: np.ndarray
    span: np.ndarray
    jumped: np.ndarray
    sigma: float
    reflected: float
    position_sd: np.ndarray
    shift: np.ndarray
    residuals: SyncResiduals
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
    def residual_sd(self) -> float:
        """Standard deviation of the residuals that count, s."""
        used = self.residuals.used
        return float(self.residuals.residual[used].std()) if used.any() else float("nan")

    @property
    def residual_mad(self) -> float:
        """1.4826 times the median absolute deviation of the residuals that count, s."""
        r = self.residuals.residual[self.residuals.used]
        return float(1.4826 * np.median(np.abs(r - np.median(r)))) if len(r) else float("nan")

    def _state(self) -> np.ndarray:
        state = np.stack([self.values.T, self.slopes.T * self.spacing], axis=-1)
        return np.nan_to_num(state)

    def _index(self, receiver: object) -> np.ndarray:
        names = {name: i for i, name in enumerate(self.receivers.names)}
        return np.array([names.get(str(r), -1) for r in np.atleast_1d(np.asarray(receiver))], int)

    def _common(self, receiver: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Clock index (N,), -1 = not synchronised, and common time (N,), s from the origin."""
        names, inverse = np.unique(np.asarray(receiver, dtype=str), return_inverse=True)
        clock = self._index(names)[inverse] if len(names) else np.zeros(0, int)
        clock = np.where((clock >= 0) & self.synced[clock], clock, -1)
        recorded = seconds(time, self.origin)
        state, first = self._state(), float(self.knots[0])
        return clock, to_common(state, first, self.spacing, np.maximum(clock, 0), recorded)

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
            Offset, s; NaN where the receiver is not synchronised.
        """
        time = np.atleast_1d(np.asarray(time, np.int64))
        name = np.broadcast_to(np.asarray(receiver, dtype=str), time.shape)
        clock, common = self._common(name, time)
        state, first = self._state(), float(self.knots[0])
        value = evaluate(state, first, self.spacing, np.maximum(clock, 0), common)
        return np.where(clock >= 0, value, np.nan)

    def clock_sd(self, toa: ArrivalTimes) -> np.ndarray:
        """Return how sure the clocks were when they heard a tag's pings.

        Parameters
        ----------
        toa : ArrivalTimes
            P pings, R deployments, on the common clock.

        Returns
        -------
        array (P, R)
            Standard error of the offset, s, linear between knots; 0 for receivers that were not
            synchronised.
        """
        clock = self._index(toa.receivers.receiver)
        time = toa.first + ((toa.origin or 0) - self.origin) / NS
        known = np.nan_to_num(self.values_sd)
        columns = [np.interp(time, self.knots, known[i]) if i >= 0 else 0 * time for i in clock]
        return np.stack(columns, axis=1)

    def apply(self, detections: Detections) -> Detections:
        """Put detections on the common clock.

        A detection whose receiver is not synchronised, or that lies further than one knot spacing
        before or after the receiver's sync detections, is set aside: left out, counted and noted.
        Clocks that jumped are not carried on at all.

        Parameters
        ----------
        detections : Detections

        Returns
        -------
        Detections
            Times in int64 ns on the common clock, in the order of the input.
        """
        clock, common = self._common(detections.receiver, detections.time)
        span = np.nan_to_num(self.span)[np.maximum(clock, 0)]
        away = np.maximum(span[:, 0] - common, common - span[:, 1])
        farthest = np.where(self.jumped[np.maximum(clock, 0)], 0.0, self.spacing)
        outside = (clock >= 0) & (away > farthest)
        beyond = (clock >= 0) & (away > 0) & ~outside
        report = detections.report
        for rows, level, what in (
            (clock < 0, "warning", "set aside: their receivers' clocks are not synchronised"),
            (
                outside,
                "warning",
                f"set aside: more than {self.spacing / 60:.0f} min before the first or after the "
                "last sync detection of their receiver, or beyond a jump of its clock",
            ),
            (
                beyond,
                "info",
                "before the first or after the last sync detection of their receiver, clock "
                f"carried on straight by at most {self.spacing / 60:.0f} min",
            ),
        ):
            if n := int(rows.sum()):
                who = ", ".join(map(str, np.unique(detections.receiver[rows])))
                report = report.add(Note(level, f"{n} detections {what} ({who})", n))
        keep = (clock >= 0) & ~outside
        offset = seconds(detections.time, self.origin) - common
        # the offset, not the time, goes through a float: nanoseconds survive
        time = detections.time - np.round(offset * NS).astype(np.int64)
        kept = dataclasses.replace(detections, time=time, report=report)
        return kept.select(mask=keep)

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
                "residual": pl.Series(r.residual).fill_nan(None),
                "p_direct": pl.Series(r.p_direct).fill_nan(None),
                "used": r.used,
                "why": r.why.astype(str).tolist(),
            }
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

        sync.nc, receivers_fitted.csv, residuals.csv, links.csv, residuals.png, clocks.png and,
        when the detections are given, detections_synced.parquet.
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
