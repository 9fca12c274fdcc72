"""The prior of the clocks: integrated random walks, and how fast each one walks."""

from __future__ import annotations

import numpy as np

__all__ = ["ClockPrior", "Q_START"]

START_SD = 1.0, 5e-5  # prior of the first knot about the coarse offset: s, s/s
Q_START, Q_RANGE = 1e-15, (1e-20, 1e-9)  # intensity of the walk, s^2/s^3
_STEP = np.array([[1.0, 1.0], [0.0, 1.0]])  # [offset, slope] one knot on
_NOISE_INVERSE = np.linalg.inv(np.array([[1 / 3, 0.5], [0.5, 1.0]]))


class ClockPrior:
    """Precision of the knots of C clocks, each an integrated random walk from a coarse start.

    From one knot to the next, h seconds on, the state [offset, h slope] gains noise of covariance
    q h^3 [[1/3, 1/2], [1/2, 1]].

    Parameters
    ----------
    start : array (C, 2)
        Coarse state at the first knot, s.
    spacing : float
        Distance between knots h, s.
    """

    def __init__(self, start: np.ndarray, spacing: float) -> None:
        self.start, self.spacing = start, spacing
        self.first = np.array([1 / START_SD[0] ** 2, 1 / (START_SD[1] * spacing) ** 2])

    def add(
        self, diag: np.ndarray, off: np.ndarray, rhs: np.ndarray, state: np.ndarray, q: np.ndarray
    ) -> None:
        """Add the prior to the normal equations, in place.

        Parameters
        ----------
        diag, off : array (K, 2 C, 2 C), array (K - 1, 2 C, 2 C)
            Blocks of the normal matrix.
        rhs : array (K, C, 2)
            Right-hand side, to which the downhill direction of the prior at `state` is added.
        state : array (K, C, 2)
        q : array (C,)
            Intensities, s^2/s^3.
        """
        n_knots, n_clocks = state.shape[:2]
        each = np.arange(n_clocks)
        precision = _NOISE_INVERSE / (q * self.spacing**3)[:, None, None]
        cross = _STEP.T @ precision
        d = diag.reshape(n_knots, n_clocks, 2, n_clocks, 2)
        o = off.reshape(n_knots - 1, n_clocks, 2, n_clocks, 2)
        d[:-1, each, :, each, :] += (cross @ _STEP)[:, None]
        d[1:, each, :, each, :] += precision[:, None]
        o[:, each, :, each, :] -= cross[:, None]
        d[0, each, :, each, :] += np.diag(self.first)
        pull = np.einsum("cab,kcb->kca", precision, _innovation(state))
        rhs[1:] -= pull
        rhs[:-1] += pull @ _STEP
        rhs[0] -= self.first * (state[0] - self.start)

    def intensity(
        self, state: np.ndarray, cov: np.ndarray, cross: np.ndarray, q: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Return new intensities (C,) and the number of innovations that the data determine.

        MacKay's fixed point (1992, Neural Computation 4:415), shrunk to the geometric mean of all
        clocks by one pseudo-innovation of two components.

        Parameters
        ----------
        state : array (K, C, 2)
        cov, cross : array (K, C, 2, 2), array (K - 1, C, 2, 2)
            Posterior covariance of each clock at a knot, and with the next knot.
        q : array (C,)
            Present intensities.
        """
        ahead = _STEP @ cross
        spread = cov[1:] + _STEP @ cov[:-1] @ _STEP.T - ahead - ahead.swapaxes(-1, -2)
        v = _innovation(state)
        squares = np.einsum("kca,ab,kcb->c", v, _NOISE_INVERSE, v) / self.spacing**3
        trace = np.einsum("ab,kcba->c", _NOISE_INVERSE, spread) / self.spacing**3
        known = np.maximum(2.0 * len(v) - trace / q, 0.3)
        pool = np.exp(np.log(q).mean())
        new = np.clip((squares + 2 * pool) / (known + 2), q / 30, q * 30)
        return np.clip(new, *Q_RANGE), float(known.sum())


def _innovation(state: np.ndarray) -> np.ndarray:
    """Change of state not foreseen from the knot before (K - 1, C, 2)."""
    return state[1:] - state[:-1] @ _STEP.T
