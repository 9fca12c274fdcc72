"""Plain NumPyro models, one a file; ``maloc.models.toa_track`` is the function itself."""

from __future__ import annotations

from maloc.models.toa_track import toa_track

__all__ = ["toa_track"]
