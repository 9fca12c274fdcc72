"""The prior of the clocks and of the sound speed: walks in time, and how fast each one walks."""

from __future__ import annotations

import numpy as np

__all__ = ["ClockPrior", "SpeedPrior", "Q_START"]

START_SD = 1.0, 5e-5  # prior of the first knot about the coarse offset: s, s/s
Q_START, Q_RANGE = 1e-15, (1e-20, 1e-9)  # intensity of the walk, s^2/s^3
_STEP = np.array([[1.0, 1.0], [0.0, 1.0]])  # [offset, slope] one knot on
_NOISE_INVERSE = np.linalg.inv(np.array([[1 / 3, 0.5], [0.5, 1.0]]))
MEMORY = 86_400.0  # s; deviations of the sound speed forget each other in a day
V_START, V_RANGE = 3e-4, (1e-5, 1e-2)  # sd of the relative deviation of the slowness


class ClockPrior:
    """Precision of the knots of C clocks, each an integrated random walk from a coarse start.

    From one knot to the next, h seconds on, the state [offset, h slope] gains noise of covariance
    q h^3 [[1/3, 1/2], [1/2, 1]]. Clock c has columns 2 c and 2 c + 1 of a knot's block.

    Parameters
    ----------
    start : array (C, 2)
        Coarse state at the first knot, s.
    spacing : float
        Distance between knots h, s.
    held : bool
        Hold the curves at the start.
    """

    def __init__(self, start: np.ndarray, spacing: float, held: bool = False) -> None:
        self.start, self.spacing = start, spacing
        self.first = np.array([1 / START_SD[0] ** 2, 1 / (START_SD[1] * spacing) ** 2])
        self.held = 1e24 if held else 0.0  # s^-2
        column = 2 * np.arange(len(start))[:, None, None]
        self.rows = column + np.array([[0, 0], [1, 1]])
        self.columns = column + np.array([[0, 1], [0, 1]])

    def add(
        self, diag: np.ndarray, off: np.ndarray, rhs: np.ndarray, state: np.ndarray, q: np.ndarray
    ) -> None:
        """Add the prior to the normal equations, in place.

        Parameters
        ----------
        diag, off : array (K, n, n), array (K - 1, n, n)
            Blocks of the normal matrix, n >= 2 C.
        rhs : array (K, n)
            Right-hand side, to which the downhill direction of the prior at `state` is added.
        state : array (K, C, 2)
        q : array (C,)
            Intensities, s^2/s^3.
        """
        n_knots, n_clocks = state.shape[:2]
        i, j = self.rows, self.columns
        precision = _NOISE_INVERSE / (q * self.spacing**3)[:, None, None]
        cross = _STEP.T @ precision
        diag[:-1, i, j] += cross @ _STEP
        diag[1:, i, j] += precision
        off[:, i, j] -= cross
        diag[0, i, j] += np.diag(self.first)
        diag[:, i, j] += self.held * np.eye(2)
        pull = np.einsum("cab,kcb->kca", precision, _innovation(state))
        down = np.zeros((n_knots, n_clocks, 2))
        down[1:] -= pull
        down[:-1] += pull @ _STEP
        down[0] -= self.first * (state[0] - self.start)
        rhs[:, : 2 * n_clocks] += down.reshape(n_knots, -1) * (self.held == 0)

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


class SpeedPrior:
    """Gauss-Markov prior of the relative deviation of the slowness at the knots.

    Parameters
    ----------
    spacing : float
        Distance between knots, s.
    """

    def __init__(self, spacing: float) -> None:
        self.keep = float(np.exp(-spacing / MEMORY))
        self.new = 1 - self.keep**2

    def add(
        self, diag: np.ndarray, off: np.ndarray, rhs: np.ndarray, v: np.ndarray, sd: float
    ) -> None:
        """Add the prior to the last column of every block, in place; `v` (K,), `sd` of it."""
        a, p = self.keep, 1 / (sd**2 * self.new)
        diag[:-1, -1, -1] += a * a * p
        diag[1:, -1, -1] += p
        off[:, -1, -1] -= a * p
        diag[0, -1, -1] += 1 / sd**2
        pull = p * (v[1:] - a * v[:-1])
        rhs[1:, -1] -= pull
        rhs[:-1, -1] += a * pull
        rhs[0, -1] -= v[0] / sd**2

    def sd(self, v: np.ndarray, var: np.ndarray, cross: np.ndarray, sd: float) -> float:
        """Return the new sd, as `ClockPrior.intensity` does.

        Parameters
        ----------
        v, var : array (K,)
        cross : array (K - 1,)
            Covariance with the next knot.
        sd : float
            At present.
        """
        a = self.keep
        spread = (var[1:] + a * a * var[:-1] - 2 * a * cross) / self.new
        squares = v[0] ** 2 + ((v[1:] - a * v[:-1]) ** 2).sum() / self.new
        known = max(len(v) - (var[0] + spread.sum()) / sd**2, 0.3)
        new = np.sqrt((squares + V_START**2) / (known + 1))
        return float(np.clip(np.clip(new, sd / 3, sd * 3), *V_RANGE))


def _innovation(state: np.ndarray) -> np.ndarray:
    """Change of state not foreseen from the knot before (K - 1, C, 2)."""
    return state[1:] - state[:-1] @ _STEP.T
