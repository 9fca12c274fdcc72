"""Missed pings summed out: the thinned-renewal likelihood of the gaps between heard pings."""

from maloc.schedule.renewal.likelihood import (
    Gap,
    Gaps,
    draw_missed,
    gap_log_likelihood,
    gap_nodes,
    interval_law,
    missed_mean,
    missed_pmf,
    pack_gaps,
)

__all__ = [
    "Gap",
    "Gaps",
    "draw_missed",
    "gap_log_likelihood",
    "gap_nodes",
    "interval_law",
    "missed_mean",
    "missed_pmf",
    "pack_gaps",
]
