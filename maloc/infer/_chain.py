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

    def neighbours(self, covariances: np.ndarray) -> np.ndarray:
        """Sub-diagonal blocks of H^-1, (T - 1, d, d): state t + 1 with state t.

        ``covariances`` are the diagonal ones; H^-1 L is upper triangular, so a column of L tells.
        """
        diagonal, below = self._blocks()
        return -covariances[1:] @ below @ np.linalg.inv(diagonal[:-1])

    def doubled(self, most: int = 16, tol: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
        """L^-T as a product of few shifts: root (T, d, d) and powers (J, T, d, d).

        With y = root z, x = L^-T z solves x_t = y_t + M_t x_(t+1); the J-th power carries M over
        2^j states, and x follows from y by y_t += powers[j, t] y_(t + 2^j), j = 0, 1, ... (the
        geometric series (I + N) (I + N^2) (I + N^4) ...). Powers end where none moves a state by
        more than ``tol`` of its own width, at 3, 6, 9, ... of them (8, 64, 512 states ahead), so
        that few shapes are compiled.
        """
        diagonal, below = self._blocks()
        root = np.linalg.inv(diagonal).transpose(0, 2, 1)
        power = np.zeros((self.length, self.d, self.d))
        power[:-1] = -root[:-1] @ below.transpose(0, 2, 1)
        powers: list[np.ndarray] = []
        while len(powers) < most:
            reach = 2 ** len(powers)
            if len(powers) % 3 == 0 and powers:
                ahead = np.zeros_like(root)
                ahead[:-reach] = root[reach:]
                moved = diagonal.transpose(0, 2, 1) @ power @ ahead
                if np.abs(moved).max(initial=0.0) < tol:
                    break
            powers.append(power)
            further = np.zeros_like(power)
            if reach < self.length:
                further[:-reach] = power[:-reach] @ power[reach:]
            power = further
        return root, np.stack(powers)
