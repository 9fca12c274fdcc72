"""The few sizes that arrays are padded to, so that one compilation serves many data sets."""

from __future__ import annotations

__all__ = ["bucket"]


def bucket(n: int) -> int:
    """Smallest padded length >= n: 16, 24, 32, 48, 64, 96, ... (steps of 1.33 to 1.5)."""
    size = 16
    while size < n:
        size = size * 3 // 2 if (size & (size - 1)) == 0 else size * 4 // 3
    return size
