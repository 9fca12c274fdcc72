"""Figures: one function a figure, each takes optional axes and returns them.

matplotlib is imported by the first figure that is drawn, not before.

Comes in: results and tables.
Goes out: Axes.
Start reading: `_map.py`, `_diagnostics.py`. Results are imported here and never import a figure.
"""

from typing import TYPE_CHECKING, Any

__all__ = [
    "audibility",
    "clocks",
    "diagnostics",
    "draw_map",
    "gdop",
    "halves",
    "heard",
    "intervals",
    "localizations",
    "parameters",
    "paths",
    "points",
    "residuals",
    "spread",
    "sync_latency",
    "sync_map",
    "sync_matrix",
    "sync_residuals",
    "trace",
    "track",
]

_HOME = {
    "audibility": "_localizations",
    "clocks": "_sync",
    "diagnostics": "_diagnostics",
    "draw_map": "_map",
    "gdop": "_gdop",
    "halves": "_halves",
    "heard": "_diagnostics",
    "intervals": "_diagnostics",
    "localizations": "_localizations",
    "parameters": "_diagnostics",
    "paths": "_residuals",
    "points": "_points",
    "residuals": "_residuals",
    "spread": "_diagnostics",
    "sync_latency": "_sync_links",
    "sync_map": "_sync_links",
    "sync_matrix": "_sync_links",
    "sync_residuals": "_sync",
    "trace": "_diagnostics",
    "track": "_track",
}

if TYPE_CHECKING:
    from maloc.plots._diagnostics import (
        diagnostics,
        heard,
        intervals,
        parameters,
        spread,
        trace,
    )
    from maloc.plots._gdop import gdop
    from maloc.plots._halves import halves
    from maloc.plots._localizations import audibility, localizations
    from maloc.plots._map import draw_map
    from maloc.plots._points import points
    from maloc.plots._residuals import paths, residuals
    from maloc.plots._sync import clocks, sync_residuals
    from maloc.plots._sync_links import sync_latency, sync_map, sync_matrix
    from maloc.plots._track import track
else:

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first asked for (PEP 562)."""
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
