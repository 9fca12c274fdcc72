"""Offsets between two receivers' clocks window by window, as kaltoa's permute_clock_drift has them.

Every offset within limits is tried at once, by convolutions in the Fourier domain: the one at which
the sync pings of both receivers lie on each other best is taken. `maloc.sync.fit` aligns clocks by
itself; this shows how two of them ran apart, and where they jumped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.stats import gennorm, norm, siegelslopes

from maloc.data import Detections, Receivers
from maloc.data._time import NS
from maloc.errors import InputError
from maloc.sync._prepare import collect

if TYPE_CHECKING:
    import polars as pl

__all__ = ["WindowOffsets", "window_offsets"]

LEAST = 3  # pings that lie on each other make an offset
OUTSIDE = float(norm.ppf(0.99))  # robust sds from the line, of an outlier
BACKGROUND = 1e-4  # density of a detection of no emission, 1/s


@dataclass(frozen=True, eq=False)
class WindowOffsets:
    """Offsets of a receiver's clock from another's, arrays (W,).

    Parameters
    ----------
    controller, target : str
    time : int64
        Middle of each window on the controller's clock, ns since 1970.
    measured : float
        Target's clock less the controller's, s; NaN = fewer than three pings lay on each other.
    offset : float
        `measured`, with what is missing or far from the others' line put on that line, s.
    matches : int
        Pings that lie on each other at `measured`.
    """

    controller: str
    target: str
    time: np.ndarray
    measured: np.ndarray
    offset: np.ndarray
    matches: np.ndarray

    @property
    def filled(self) -> np.ndarray:
        """Whether an offset is not the measured one (W,)."""
        return self.offset != self.measured

    def to_frame(self) -> pl.DataFrame:
        """Return a polars DataFrame, a row a window."""
        import polars as pl

        return pl.DataFrame(
            {
                "controller": [self.controller] * len(self.time),
                "target": [self.target] * len(self.time),
                "time": pl.Series(self.time).cast(pl.Datetime("ns", "UTC")),
                "measured": pl.Series(self.measured).fill_nan(None),
                "offset": self.offset,
                "filled": self.filled,
                "matches": self.matches,
            }
        )

    def __repr__(self) -> str:
        return (
            f"WindowOffsets: {self.target} on the clock of {self.controller}, {len(self.time)} "
            f"windows, {int(np.isfinite(self.measured).sum())} measured, "
            f"{int(self.filled.sum())} put on the line"
        )


def window_offsets(
    detections: Detections,
    receivers: Receivers,
    pair: Sequence[object],
    *,
    method: Literal["xcorr", "likelihood"] = "xcorr",
    window: float = 3600.0,
    resolution: float = 0.1,
    largest: float = 300.0,
    around: Any = 0.0,
    sigma: float | None = None,
    phi: float = 1000.0 / 1500.0,
    w: float = 0.2,
    sound_speed: float = 1500.0,
    fill: bool = True,
) -> WindowOffsets:
    """Find the offset between two clocks in each window of a record.

    Parameters
    ----------
    detections : Detections
        Raw, of any tags; all sync tags that both receivers heard count.
    receivers : Receivers
        With `sync_tag`.
    pair : (controller, target)
        Names of receivers; a pair of a `SyncOrder`.
    method : {"xcorr", "likelihood"}
        Cross-correlation of Gaussian kernels, which pings that one of them missed do not disturb;
        or the likelihood that each detection is a direct or a reflected one (`maloc.arrival.
        DDetect`) of one of the controller's, better where many are reflected.
    window : float
        Length of a window, s.
    resolution : float
        Of the offsets tried, s.
    largest : float
        Offsets are tried within this of `around`, s.
    around : float or array (W,)
        Middle of the offsets tried, s: of all windows, or of each.
    sigma : float, optional
        Standard deviation of the kernel, or of direct detections, s; five times the resolution, or
        the resolution.
    phi, w : float
        Largest lateness (s) and share of reflected detections.
    sound_speed : float
        m/s.
    fill : bool
        Put windows without an offset, and offsets outside the central 98 % about a robust line
        (Siegel's repeated medians), on that line. A clock that jumps is no line.

    Returns
    -------
    WindowOffsets

    Raises
    ------
    InputError
        If a receiver is not in the table, they heard no sync tag in common, an argument is not
        positive, or the method is unknown.

    References
    ----------
    permute_clock_drift of the R package kaltoa; Siegel (1982) Biometrika 69: 242-244.
    """
    if method not in ("xcorr", "likelihood"):
        raise InputError(f"method '{method}' is neither xcorr nor likelihood")
    sizes = {"window": window, "resolution": resolution, "largest": largest, "phi": phi}
    for name, value in sizes.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} must be positive, got {value}")
    names = [str(p) for p in pair]
    for name in names:
        if name not in receivers.names:
            raise InputError(f"receiver '{name}' is not in the receivers' table")
    origin = int(detections.time.min()) // NS * NS if len(detections) else 0
    data, _ = collect(detections, receivers, origin)
    way = np.linalg.norm(receivers.xy[data.place] - receivers.xy[data.source], axis=1)
    emission = data.recorded - way / sound_speed
    heard = [data.clock == receivers.names.index(name) for name in names]
    tags = np.intersect1d(data.tag[heard[0]], data.tag[heard[1]])
    sent, got = ([np.sort(emission[h & (data.tag == t)]) for t in tags] for h in heard)
    if not len(tags):
        raise InputError(f"receivers {names[0]} and {names[1]} heard no sync tag in common")
    first, last = min(t[0] for t in sent), max(t[-1] for t in sent)
    begin = first + window * np.arange(max(1, int(np.ceil((last - first) / window))))
    centre = np.broadcast_to(np.asarray(around, float), begin.shape)

    kernel = sigma or (5 * resolution if method == "xcorr" else resolution)
    law = (lambda t: norm.pdf(t, 0, np.sqrt(2) * kernel)) if method == "xcorr" else (
        lambda t: (1 - w) * norm.pdf(t, 0, kernel) + w * gennorm.pdf(t, 32, phi / 2, phi / 2)
    )  # fmt: skip
    trial = _Trial(law, resolution, window, largest, phi + 8 * kernel, method == "likelihood")
    measured, matches = np.full(len(begin), np.nan), np.zeros(len(begin), int)
    reach = max(3 * kernel, 2 * resolution)
    for k, (start, middle) in enumerate(zip(begin, centre, strict=True)):
        a = [t[slice(*np.searchsorted(t, [start, start + window]))] - start for t in sent]
        low, high = start + middle - largest, start + middle + window + largest
        b = [t[slice(*np.searchsorted(t, [low, high]))] - low for t in got]
        best = trial(a, b)
        apart = [(y[:, None] - x).ravel() for x, y in zip(a, b, strict=True)]
        near = np.concatenate([d[np.abs(d - best) <= reach] for d in apart])
        matches[k] = len(near)
        if len(near) >= LEAST:
            measured[k] = middle - largest + float(np.median(near))
    time = origin + np.round((begin + window / 2) * NS).astype(np.int64)
    offset = _on_line(begin, measured, resolution) if fill else measured.copy()
    return WindowOffsets(names[0], names[1], time, measured, offset, matches)


class _Trial:
    """Scores of all offsets of one window at once."""

    def __init__(self, law, step: float, window: float, largest: float, reach: float, log: bool):
        self.step, self.log = step, log
        self.n_offsets = int(2 * largest / step) + 1
        cells = int((window + 2 * largest + 2 * reach) / step) + 2
        self.n = 2 ** int(np.ceil(np.log2(cells)))
        lag = np.fft.fftfreq(self.n, 1 / (self.n * step))  # s, wrapped
        self.law = np.fft.rfft(law(lag))

    def __call__(self, sent: list[np.ndarray], got: list[np.ndarray]) -> float:
        """Best offset (s) of lists, one a tag, of emission times (s) on both clocks."""
        score = np.zeros(self.n)
        for a, b in zip(sent, got, strict=True):
            if len(a) and len(b):
                spread = np.fft.irfft(self._counted(a) * self.law, self.n)
                if self.log:
                    spread = np.log(BACKGROUND + np.maximum(spread, 0.0))
                score += np.fft.irfft(np.conj(np.fft.rfft(spread)) * self._counted(b), self.n)
        return self.step * int(score[: self.n_offsets].argmax())

    def _counted(self, time: np.ndarray) -> np.ndarray:
        cell = np.rint(time / self.step).astype(int)
        return np.fft.rfft(np.bincount(cell, minlength=self.n)[: self.n].astype(float))


def _on_line(time: np.ndarray, measured: np.ndarray, least: float) -> np.ndarray:
    """Offsets with what is missing or an outlier put on a robust line."""
    known = np.isfinite(measured)
    if known.sum() < 3:
        return measured.copy()
    slope, intercept = siegelslopes(measured[known], time[known])
    ahead = intercept + slope * time
    off = np.abs(measured - ahead)
    spread = 1.4826 * np.median(off[known])
    bad = ~known | (off > np.maximum(OUTSIDE * spread, least))
    return np.where(bad, ahead, measured)
