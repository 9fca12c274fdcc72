"""Tables of a synchronisation: residuals, jumps, links."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from maloc.data._time import NS

if TYPE_CHECKING:
    import polars as pl

    from maloc.sync._clocks import Clocks

__all__ = ["jump_text", "jumps_frame", "links_frame", "residuals_frame"]


def jump_text(sync: Clocks, j: int) -> str:
    """Return a sentence on jump `j`."""
    q = sync.jumps
    start = np.datetime64(sync.origin, "ns")
    low, high = (
        str(start + np.timedelta64(round(float(t[j]) * NS), "ns"))[:19] for t in (q.low, q.high)
    )
    return (
        f"the clock of receiver {q.receiver[j]} jumps by {q.size[j]:+.4g} s between {low} and "
        f"{high} (common time); it is followed across"
    )


def residuals_frame(sync: Clocks) -> pl.DataFrame:
    """See `ClockSync.residuals_frame`."""
    import polars as pl

    r = sync.residuals
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


def jumps_frame(sync: Clocks) -> pl.DataFrame:
    """See `ClockSync.jumps_frame`."""
    import polars as pl

    q = sync.jumps
    ns = {
        name: pl.Series(sync.origin + np.round(getattr(q, name) * NS).astype(np.int64)).cast(
            pl.Datetime("ns", "UTC")
        )
        for name in ("time", "low", "high")
    }
    return pl.DataFrame(
        {"receiver": q.receiver.astype(str).tolist(), **ns, "size": q.size, "sd": q.size_sd},
        schema_overrides={"receiver": pl.String},
    )


def links_frame(sync: Clocks) -> pl.DataFrame:
    """See `ClockSync.links_frame`."""
    import polars as pl

    used = pl.col("residual").filter(pl.col("used"))
    return (
        residuals_frame(sync)
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


def receivers_frame(sync: Clocks) -> pl.DataFrame:
    """Return the fitted receivers' table with shifts from the given one and standard errors."""
    import polars as pl

    extra = {
        "shift_x": sync.shift[:, 0],
        "shift_y": sync.shift[:, 1],
        "sd_x": sync.position_sd[:, 0],
        "sd_y": sync.position_sd[:, 1],
    }
    return sync.receivers.to_frame().with_columns(pl.Series(k, v) for k, v in extra.items())
