"""How arrival times err: densities of the arrival's residual around the predicted arrival."""

from maloc.arrival.laws import (
    ArrivalError,
    DDetect,
    Gaussian,
    GaussianStudent,
    GeneralizedNormal,
    Student,
)

__all__ = ["ArrivalError", "DDetect", "Gaussian", "GaussianStudent", "GeneralizedNormal", "Student"]
