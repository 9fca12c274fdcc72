"""Symmetric positive definite block-tridiagonal systems, with NumPy: the algebra of the clocks.

A chain of K blocks of size n has diagonal blocks ``D`` (K, n, n) and upper off-diagonal blocks
``O`` (K - 1, n, n), ``O[k]`` standing in row k and column k + 1. Everything is O(K n^3).

Pivots are kept as inverses of their Cholesky factors: all that follows is then small matrix
products, for which BLAS starts no threads (triangular solves of this size spend ten times their
work on starting them).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

__all__ = ["BlockFactor", "draw", "factor", "selected_inverse", "solve"]


class BlockFactor(NamedTuple):
    """Block Cholesky factor: the matrix is R^T R with R upper block-bidiagonal.

    Attributes
    ----------
    inverse : array (K, n, n)
        Inverses of the lower Cholesky factors of the pivots.
    upper : array (K - 1, n, n)
        Off-diagonal blocks of R.
    """

    inverse: np.ndarray
    upper: np.ndarray


def factor(diagonal: np.ndarray, off: np.ndarray) -> BlockFactor:
    """Factor the matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive definite.
    """
    potrf, trtri = get_lapack_funcs(("potrf", "trtri"), (diagonal,))
    inverse, upper = np.empty_like(diagonal), np.empty_like(off)
    pivot = diagonal[0]
    for k in range(len(diagonal)):
        lower, bad = potrf(pivot, lower=1, clean=1)
        if bad:
            raise np.linalg.LinAlgError(f"block {k} is not positive definite")
        inverse[k] = trtri(lower, lower=1)[0]
        if k < len(off):
            upper[k] = inverse[k] @ off[k]
            pivot = diagonal[k + 1] - upper[k].T @ upper[k]
    return BlockFactor(inverse, upper)


def solve(f: BlockFactor, b: np.ndarray) -> np.ndarray:
    """Solve for right-hand sides `b` (K, n, m); returns (K, n, m)."""
    x = np.empty_like(b)
    for k in range(len(b)):
        x[k] = f.inverse[k] @ (b[k] - f.upper[k - 1].T @ x[k - 1] if k else b[k])
    last = len(b) - 1
    for k in range(last, -1, -1):
        x[k] = f.inverse[k].T @ (x[k] - f.upper[k] @ x[k + 1] if k < last else x[k])
    return x


def selected_inverse(f: BlockFactor) -> tuple[np.ndarray, np.ndarray]:
    """Blocks (k, k) and (k, k + 1) of the inverse, by the recursion of Takahashi et al. (1973).

    Returns
    -------
    diagonal : array (K, n, n)
    off : array (K - 1, n, n)
    """
    diagonal, off = np.empty_like(f.inverse), np.empty_like(f.upper)
    for k in range(len(diagonal) - 1, -1, -1):
        diagonal[k] = f.inverse[k].T @ f.inverse[k]
        if k < len(off):
            gain = f.inverse[k].T @ f.upper[k]
            off[k] = -gain @ diagonal[k + 1]
            diagonal[k] -= off[k] @ gain.T
    return diagonal, off


def draw(f: BlockFactor, z: np.ndarray) -> np.ndarray:
    """Turn standard normal numbers `z` (K, n, m) into m draws with the inverse as covariance."""
    x = np.empty_like(z)
    last = len(z) - 1
    for k in range(last, -1, -1):
        x[k] = f.inverse[k].T @ (z[k] - f.upper[k] @ x[k + 1] if k < last else z[k])
    return x
