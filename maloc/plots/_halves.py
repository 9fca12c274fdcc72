"""How far two tracks by halves of the receivers are apart, in their own standard deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from maloc.plots._style import CYCLE, PALE, legend_above, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from maloc.evaluate import Halves

__all__ = ["halves"]


def halves(found: Halves, *, ax: Any = None) -> Axes:
    """Difference of two tracks over its stated standard deviation, by axis and ping.

    Parameters
    ----------
    found : Halves
        What `maloc.evaluate.halves` gives.
    ax : Axes, optional
        Axes to draw on; new ones where None.

    Returns
    -------
    Axes
        Nineteen of twenty points lie in the band where the standard deviations are right.
    """
    ax = new_axes(ax, (7.0, 3.5))
    ax.axhspan(-1.96, 1.96, color=PALE, alpha=0.35, lw=0, zorder=1)
    rows = found.rows
    for axis, colour in zip("xy", CYCLE, strict=False):
        z = rows[f"z_{axis}"].to_numpy()
        name = f"{axis}: mean chi-square {found.scores[f'chi2_{axis}']:.2f}"
        ax.scatter(rows["ping"], z, s=9, lw=0, color=colour, alpha=0.8, zorder=3, label=name)
    if len(rows) and np.abs(rows.select("z_x", "z_y").to_numpy()).max() > 10:
        ax.set_yscale("symlog", linthresh=4)
        ax.yaxis.set_major_formatter("{x:g}")
    tidy(ax, "ping", "difference / sd", "Halves of the receivers")
    return legend_above(ax)
