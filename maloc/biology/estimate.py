"""Mean and interval of anything that was worked out draw by draw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maloc.errors import InputError

__all__ = ["Estimate", "summarise"]


class Estimate(NamedTuple):
    """Posterior of a quantity, from its draws.

    Attributes
    ----------
    mean, sd, low, high : arrays (...)
        ``low`` and ``high`` bound the central interval.
    draws : (D, ...) array
        One value a whole-track draw, for anything else.
    """

    mean: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    draws: np.ndarray


def summarise(draws: np.ndarray, level: float = 0.95) -> Estimate:
    """Summarise draws (D, ...) by mean, sd and the central interval of probability ``level``.

    Raises
    ------
    InputError
        If ``level`` is not between 0 and 1, or there are fewer than two draws.
    """
    draws = np.asarray(draws, float)
    if not 0 < level < 1:
        raise InputError(f"level {level:g} is no probability between 0 and 1")
    if len(draws) < 2:
        raise InputError("an interval needs two draws or more")
    tail = 0.5 * (1 - level)
    low, high = np.quantile(draws, [tail, 1 - tail], axis=0)
    return Estimate(draws.mean(axis=0), draws.std(axis=0, ddof=1), low, high, draws)
