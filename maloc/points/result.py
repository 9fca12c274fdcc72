"""Positions of single pings, with what is known of their error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.data import _arrays
from maloc.errors import InputError

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Points"]


@dataclass(frozen=True, repr=False, eq=False)
class Points:
    """One position a ping (d = 2: x, y; d = 3: x, y, depth), each from that ping's arrivals alone.

    Parameters
    ----------
    position : array (P, d)
        Metres, in the receivers' frame; NaN where there is none (`why` says why).
    covariance : array (P, d, d)
        m^2, of the position's error; inf where the arrivals leave a direction open, NaN where
        there is no position.
    emission : array (P,)
        When the ping was sent, s from the data set's origin; NaN where unknown.
    n_used : array (P,) of int64
        Number of arrivals that the position rests on.
    inlier : array (P, R) bool
        Arrivals that agree with the position and, where there is one, with the alternative too.
        None where d + 1 agree (as any d + 1 do) and others do not.
    ambiguous : array (P,) bool
        True where the arrivals do not settle the place: `alternative` fits as well and nothing
        told the two apart, or no more than d + 1 of several arrivals agree.
    alternative : array (P, d)
        The second place that fits, m; NaN where there is none. Kept also where the ambiguity
        was resolved.
    residual_rms : array (P,)
        Root mean square of the used arrivals' residuals, m; NaN where there is no position.
    method : str
        How the positions were found.
    why : array (P,) of str
        Why there is no position; "" where there is one.
    ping : array (P,) of int64, optional
        Ids as in the arrival times; 1..P when not given.
    time : array (P,), optional
        First arrival, s from the data set's origin; NaN when not given.
    tag : str
        Full tag id.
    origin : int, optional
        ns since 1970 UTC of second 0.
    sigma : float
        Standard deviation of an arrival's error, m, that was used or estimated; NaN where the
        arrivals had one each.
    other : Points, optional
        All about the alternatives: their covariances, emissions and so on; None where the method
        does not say.
    extra : dict of str to array (P, ...)
        What one method knows and others do not, such as an effective sample size.

    Raises
    ------
    InputError
        If shapes do not agree.
    """

    position: np.ndarray
    covariance: np.ndarray
    emission: np.ndarray
    n_used: np.ndarray
    inlier: np.ndarray
    ambiguous: np.ndarray
    alternative: np.ndarray
    residual_rms: np.ndarray
    method: str
    why: np.ndarray
    ping: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    time: np.ndarray = None  # pyright: ignore[reportAssignmentType]
    tag: str = ""
    origin: int | None = None
    sigma: float = float("nan")
    other: Points | None = None
    extra: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        position = np.asarray(self.position, float)
        if position.ndim != 2 or position.shape[1] not in (2, 3):
            raise InputError(f"position must be (P, 2) or (P, 3), got shape {position.shape}")
        n, d = position.shape
        inlier = np.asarray(self.inlier, bool)
        if inlier.ndim != 2 or len(inlier) != n:
            raise InputError(f"inlier must be ({n}, R), got shape {inlier.shape}")
        ambiguous = np.asarray(self.ambiguous, bool)
        if ambiguous.shape != (n,):
            raise InputError(f"ambiguous must be ({n},), got shape {ambiguous.shape}")
        ping = np.arange(1, n + 1) if self.ping is None else self.ping
        time = np.full(n, np.nan) if self.time is None else self.time
        extra = {k: np.asarray(v) for k, v in self.extra.items()}
        if wrong := [k for k, v in extra.items() if v.shape[:1] != (n,)]:
            raise InputError(f"extra '{wrong[0]}' must have {n} rows")
        covariance = np.asarray(self.covariance, float)
        if covariance.shape != (n, d, d):
            raise InputError(f"covariance must be ({n}, {d}, {d}), got shape {covariance.shape}")
        checked = {
            "position": position,
            "covariance": covariance,
            "emission": _arrays.floats(self.emission, "emission", (n,)),
            "n_used": _arrays.integers(self.n_used, "n_used", (n,)),
            "inlier": inlier,
            "ambiguous": ambiguous,
            "alternative": _arrays.floats(self.alternative, "alternative", (n, d)),
            "residual_rms": _arrays.floats(self.residual_rms, "residual_rms", (n,)),
            "why": _arrays.text(self.why, "why", n),
            "ping": _arrays.integers(ping, "ping", (n,)),
            "time": _arrays.floats(time, "time", (n,)),
            "extra": extra,
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def located(self) -> np.ndarray:
        """Whether each ping has a position, (P,) bool."""
        return np.asarray(np.isfinite(self.position).all(axis=1))

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of each coordinate, (P, d) m."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def replace(self, **changes: Any) -> Points:
        """Return a copy with some fields changed, checked again."""
        return replace(self, **changes)

    def to_frame(self) -> pl.DataFrame:
        """Return one row a ping as a polars DataFrame; numbers that are not known are null."""
        import polars as pl

        names = ["x", "y", "depth"][: self.position.shape[1]]
        columns: dict[str, Any] = {"ping": self.ping, "time": self.emission}
        columns |= {n: self.position[:, i] for i, n in enumerate(names)}
        columns |= {f"sd_{n}": self.sd[:, i] for i, n in enumerate(names)}
        columns |= {
            "cov_xy": self.covariance[:, 0, 1],
            "n_used": self.n_used,
            "residual_rms": self.residual_rms,
            "ambiguous": self.ambiguous,
        }
        columns |= {f"alternative_{n}": self.alternative[:, i] for i, n in enumerate(names)}
        columns |= {k: v for k, v in self.extra.items() if v.ndim == 1}
        return pl.DataFrame(columns | {"why": self.why}).with_columns(
            pl.col(pl.Float64).fill_nan(None)
        )

    def __repr__(self) -> str:
        name = f" of {self.tag}" if self.tag else ""
        twice = int((self.ambiguous & self.located).sum())
        return (
            f"Points{name} ({self.method}): {int(self.located.sum())} of {len(self)} pings "
            f"located, {twice} ambiguous"
        )
