"""Algebra of a chain's precision with a border: few effects that every state may feel.

With A the path's band, B (m, T d) the border and C (m, m) its corner, the precision is
[[A, B'], [B, C]]; its determinant is that of A times that of S = C - B A^-1 B'.
"""

from __future__ import annotations

import numpy as np

from maloc.infer._chain import ChainFactor

__all__ = ["Arrow"]

_LEAST = 1e-9


class Arrow:
    """Factored precision of a path and m inner parameters.

    Parameters
    ----------
    factor : ChainFactor
        Of A.
    mixed : (m, T, d) array
        B.
    block : (m, m) array
        C.
    """

    def __init__(self, factor: ChainFactor, mixed: np.ndarray, block: np.ndarray) -> None:
        self.factor = factor
        self.log_det, self.follow, self.covariance = factor.log_det, mixed, np.zeros((0, 0))
        if not len(mixed):
            return
        self.follow = -factor.solve(mixed)  # d path / d inner, (m, T, d)
        flat = self.follow.reshape(len(mixed), -1)
        schur = block + flat @ mixed.reshape(len(mixed), -1).T
        values, vectors = np.linalg.eigh(0.5 * (schur + schur.T))
        values = np.maximum(values, _LEAST)
        self.log_det += float(np.log(values).sum())
        self.covariance = (vectors / values) @ vectors.T  # of the inner parameters, S^-1

    def solve(self, path: np.ndarray, inner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Precision^-1 (path, inner) for path (n, T, d) and inner (n, m)."""
        if not len(path):
            return path, inner
        alone = self.factor.solve(path)
        if not len(self.covariance):
            return alone, inner
        n, m = len(path), len(self.covariance)
        # B A^-1 path = -follow' path
        pull = inner + path.reshape(n, -1) @ self.follow.reshape(m, -1).T
        own = pull @ self.covariance
        return alone + np.einsum("nm,mtd->ntd", own, self.follow), own
