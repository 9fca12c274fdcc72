"""Block-tridiagonal algebra on LAPACK's band storage; knows no fish.

A chain of T states of d numbers has a precision matrix with d x d blocks on and beside the
diagonal. It is kept as a lower band matrix (2 d, T d), ``band[i - j, j] = H[i, j]``, and factored
as L L'.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, get_lapack_funcs

__all__ = ["ChainFactor"]


class ChainFactor:
    """Cholesky factor of a block-tridiagonal precision.

    Parameters
    ----------
    band : (2 d, T d) array
        Lower band of a positive definite matrix.
    d : int
        Block size.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """

    def __init__(self, band, d: int) -> None:
        band = np.asarray(band)
        if not np.isfinite(band).all():
            raise np.linalg.LinAlgError("the precision is not finite")
        self.lower = cholesky_banded(band, lower=True, check_finite=False)
        self.d = d
        self.length = band.shape[1] // d

    @property
    def log_det(self) -> float:
        """Log determinant of the precision."""
        return 2.0 * float(np.log(self.lower[0]).sum())

    @property
    def log_diagonal(self) -> np.ndarray:
        """Log diagonal of L, (T, d)."""
        return np.log(self.lower[0]).reshape(self.length, self.d)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """H^-1 rhs for rhs (T, d) or (..., T, d)."""
        flat = rhs.reshape(-1, self.length * self.d).T
        out = cho_solve_banded((self.lower, True), flat, check_finite=False)
        return out.T.reshape(rhs.shape)

    def unwhiten(self, z: np.ndarray) -> np.ndarray:
        """L^-T z for z (..., T, d): draws of N(0, H^-1) where z is standard normal."""
        flat = z.reshape(-1, self.length * self.d).T
        (tbtrs,) = get_lapack_funcs(("tbtrs",), (self.lower, flat))
        out, info = tbtrs(self.lower, flat, uplo="L", trans="T")
        if info:
            raise np.linalg.LinAlgError("singular factor")
        return out.T.reshape(z.shape)

    def _blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Diagonal (T, d, d) and sub-diagonal (T - 1, d, d) blocks of L."""
        d, length = self.d, self.length
        diagonal, below = np.zeros((length, d, d)), np.zeros((length - 1, d, d))
        columns = self.lower.reshape(2 * d, length, d)
        for j in range(d):
            for i in range(j, d):
                diagonal[:, i, j] = columns[i - j, :, j]
            for i in range(d):
                if d + i - j < 2 * d:
                    below[:, i, j] = columns[d + i - j, :-1, j]
        return diagonal, below

    def covariances(self) -> np.ndarray:
        """Diagonal blocks of H^-1, (T, d, d), by the block Takahashi recursion: O(T d^3)."""
        diagonal, below = self._blocks()
        inverse = np.linalg.inv(diagonal)
        own = np.einsum("kji,kjl->kil", inverse, inverse)
        carry = below @ inverse[:-1]
        out = own.copy()
        for k in range(self.length - 2, -1, -1):
            out[k] += carry[k].T @ out[k + 1] @ carry[k]
        return out

    def window(self, width: int) -> np.ndarray:
        """L^-T cut to ``width`` states ahead: W (T, width, d, d), x_t = sum_w W[t, w] z_{t + w}."""
        diagonal, below = self._blocks()
        length, d = self.length, self.d
        inverse_t = np.linalg.inv(diagonal).transpose(0, 2, 1)
        step = np.zeros((length, d, d))
        step[:-1] = -inverse_t[:-1] @ below.transpose(0, 2, 1)
        out = np.zeros((length, width, d, d))
        ahead = np.tile(np.eye(d), (length, 1, 1))
        for w in range(min(width, length)):
            out[: length - w, w] = ahead[: length - w] @ inverse_t[w:]
            ahead[: length - w - 1] = ahead[: length - w - 1] @ step[w : length - 1]
        return out
