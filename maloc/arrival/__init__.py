"""How arrival times err: densities of the arrival's residual around the predicted arrival.

Comes in: arrivals, predicted arrivals, scales, in one unit.
Goes out: distributions, each knowing what the engine asks of it (`error.py`).
Start reading: `laws.py`, then `ddetect.py`. Imports nothing of maloc but JAX.
The mathematics: docs/architecture.md, "ddetect".
"""

from maloc.arrival.laws import (
    ArrivalError,
    DDetect,
    Gaussian,
    GaussianStudent,
    GeneralizedNormal,
    Multipath,
    Student,
)

__all__ = [
    "ArrivalError",
    "DDetect",
    "Gaussian",
    "GaussianStudent",
    "GeneralizedNormal",
    "Multipath",
    "Student",
]
