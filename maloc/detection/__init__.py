"""Who hears a ping, and who does not: detection as a function of distance."""

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
