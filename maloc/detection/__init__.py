"""Who hears a ping, and who does not: detection as a function of distance.

Comes in: distances, covariates, parameters.
Goes out: log likelihoods of who heard a ping; and, of tags at known places, a fitted curve
    (`rangetest.py`).
Start reading: `hearing.py`, `curve.py`. Knows no data set.
The mathematics: docs/architecture.md, "Heard and not heard".
"""

from maloc.detection.hearing import (
    CAP,
    KINDS,
    Encounters,
    encounters,
    linear_shift,
    log_probabilities,
    squared_distance,
)

__all__ = [
    "CAP",
    "Encounters",
    "KINDS",
    "encounters",
    "linear_shift",
    "log_probabilities",
    "squared_distance",
]
