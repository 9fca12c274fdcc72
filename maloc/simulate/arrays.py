"""Where receivers stand: three arrays to simulate on, with a name, coordinates and the water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Array", "canal", "grid", "line"]

# A bend of an invented canal 54 m wide: its banks (m), and twelve receivers 1.5 m off them.
_CANAL_WATER = (
    *((31.9, 208.5), (73.0, 130.1), (166.0, 61.8)),
    *((134.0, 18.2), (31.0, 93.9), (-15.9, 183.5)),
)
_CANAL_RECEIVERS = (
    *((33.4, 202.4), (51.5, 168.0), (69.5, 133.5), (99.1, 109.0), (130.5, 86.0), (160.2, 64.2)),
    *((-4.0, 164.0), (14.0, 129.6), (32.0, 95.2), (65.0, 70.8), (101.8, 43.8), (125.7, 26.2)),
)


@dataclass(frozen=True, eq=False)
class Array:
    """Receivers in a local frame.

    Parameters
    ----------
    name : tuple of str, length R
        Names of the receivers.
    xy : array (R, 2)
        Positions, m.
    water : array (V, 2), optional
        Corners, m, of the polygon that the animal stays in; None = open water.
    """

    name: tuple[str, ...]
    xy: np.ndarray
    water: np.ndarray | None = None


def _names(letter: str, n: int) -> tuple[str, ...]:
    return tuple(f"{letter}{i + 1:02d}" for i in range(n))


def grid(n: int = 16, spacing: float = 100.0) -> Array:
    """`n` receivers on a square grid in open water, row by row, `spacing` m apart."""
    side = int(np.ceil(np.sqrt(n)))
    k = np.arange(n)
    return Array(_names("G", n), spacing * np.stack([k % side, k // side], 1).astype(float))


def line(n: int = 8, spacing: float = 150.0) -> Array:
    """`n` receivers on one straight line, `spacing` m apart: a gate across a river or a bay."""
    return Array(_names("L", n), np.stack([spacing * np.arange(n), np.zeros(n)], 1))


def canal() -> Array:
    """Twelve receivers along both banks of a bend in a canal, with the canal's polygon."""
    xy = np.array(_CANAL_RECEIVERS)
    return Array(_names("C", len(xy)), xy, np.array(_CANAL_WATER))
