"""The one place that imports Stone Soup, and speaks its words."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np

from maloc.errors import needs

try:
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDAwithEHM
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
    from stonesoup.updater.kalman import KalmanUpdater
    from stonesoup.updater.probability import PDAUpdater
except ImportError as problem:
    raise needs("tracking", "Stone Soup", "tracking", problem) from None

_AXES = (0, 2)  # x and y in its state x, vx, y, vy


def predictor(acceleration: float) -> Any:
    """Constant velocity in the plane, with white noise acceleration (m/s^1.5)."""
    axis = ConstantVelocity(acceleration**2)
    return KalmanPredictor(CombinedLinearGaussianTransitionModel([axis, axis]))


def associator(
    kind: str, predictor: Any, gate: float, p_detect: float, false_density: float
) -> tuple[Any, Any]:
    """The associator of this kind and its updater."""
    updater = KalmanUpdater(None)
    if kind == "gnn":
        hypotheses = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=gate)
        return GNNWith2DAssignment(hypotheses), updater
    within = 1 - np.exp(-(gate**2) / 2)  # of a normal law in the plane
    hypotheses = PDAHypothesiser(predictor, updater, false_density, p_detect, within)
    # each position updates by its own covariance, then the mixture is reduced
    return JPDAwithEHM(hypotheses), PDAUpdater(None, gm_method=True)


def detection(position: np.ndarray, covariance: np.ndarray, when: datetime) -> Any:
    """A measured position."""
    return Detection(
        position[:, None], timestamp=when, measurement_model=LinearGaussian(4, _AXES, covariance)
    )


def start(one: Any, velocity_sd: float) -> Any:
    """A new track at a measured position, its velocity N(0, velocity_sd^2)."""
    mean, covariance = np.zeros((4, 1)), velocity_sd**2 * np.eye(4)
    mean[list(_AXES)] = one.state_vector
    covariance[np.ix_(_AXES, _AXES)] = one.measurement_model.covar()
    return Track([GaussianState(mean, covariance, timestamp=one.timestamp)])


def update(updater: Any, chosen: Any) -> tuple[Any, bool, set[int]]:
    """State after an association, whether a position hit it, and which positions it took."""
    if not isinstance(updater, PDAUpdater):
        if not chosen:
            return chosen.prediction, False, set()
        return updater.update(chosen), True, {id(chosen.measurement)}
    missed = float(next((h.probability for h in chosen if not h), 0.0))
    took = {id(h.measurement) for h in chosen if h and h.probability > 0.5}
    if all(not h for h in chosen):
        return chosen[0].prediction, False, took
    return updater.update(chosen), missed < 0.5, took
