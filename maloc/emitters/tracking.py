"""Tracks of several emitters from positions that say not whose they are.

Prediction, update and the association of positions with tracks (GNN or JPDA) are Stone Soup's;
confirmation by M hits in N steps and deletion are counted here. An optional part:
``pip install "maloc[tracking]"``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np

from maloc.errors import InputError

__all__ = ["Tracker", "Tracks"]

_ZERO = datetime(2000, 1, 1)  # Stone Soup's clock is a calendar's


class Tracks(NamedTuple):
    """The confirmed tracks at one step.

    Attributes
    ----------
    number : array (K,) of int
        Which track; numbers are never used again.
    position, velocity : array (K, 2)
        Metres, m/s.
    covariance : array (K, 4, 4)
        Of x, y and their velocities.
    """

    number: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray


@dataclass(eq=False)
class _Track:
    """A Stone Soup track, and whether it was hit in its latest steps."""

    number: int
    path: Any
    hits: deque = field(default_factory=lambda: deque([True]))
    confirmed: bool = False


class Tracker:
    """Multi-target tracker of constant velocity.

    Parameters
    ----------
    velocity_sd : float
        Standard deviation of a new track's velocity an axis, m/s.
    acceleration : float
        White noise acceleration: its power spectral density's root, m/s^1.5.
    confirm : (int, int)
        (M, N): a track is confirmed when positions hit it in M of N successive steps; a new one
        is dropped as soon as M of its first N are out of reach.
    delete : (int, int)
        (M, N): a confirmed track is deleted when M of its latest N steps missed it.
    association : {"gnn", "jpda"}
        Global nearest neighbour, or joint probabilistic data association.
    gate : float
        Mahalanobis distance beyond which a position is not a track's.
    p_detect, false_density : float
        Of JPDA: chance that an emitter yields a position, and false positions a m^2.

    Raises
    ------
    InputError
        If a number makes no sense, or Stone Soup is not installed.
    """

    def __init__(
        self,
        velocity_sd: float,
        acceleration: float = 1.0,
        *,
        confirm: tuple[int, int] = (4, 6),
        delete: tuple[int, int] = (5, 5),
        association: str = "gnn",
        gate: float = 4.0,
        p_detect: float = 0.8,
        false_density: float = 1e-9,
    ) -> None:
        for name, (m, n) in (("confirm", confirm), ("delete", delete)):
            if not 1 <= m <= n:
                raise InputError(f"{name} {m} of {n} steps is impossible")
        if not (velocity_sd > 0 and acceleration > 0 and gate > 0 and false_density > 0):
            raise InputError("velocity_sd, acceleration, gate, false_density must be positive")
        if association not in ("gnn", "jpda") or not 0 < p_detect < 1:
            raise InputError("association is gnn or jpda, p_detect a chance between 0 and 1")
        self.confirm, self.delete, self.velocity_sd = confirm, delete, velocity_sd
        from maloc.emitters import _stonesoup as soup

        self._soup = soup
        self._predictor = self._soup.predictor(acceleration)
        self._associator, self._updater = self._soup.associator(
            association, self._predictor, gate, p_detect, false_density
        )
        self._tracks: list[_Track] = []
        self._next = 0
        self._latest = -np.inf

    def step(self, time: float, position: np.ndarray, covariance: np.ndarray) -> Tracks:
        """Take the positions of one step.

        Parameters
        ----------
        time : float
            s, later than the step before.
        position : array (K, 2)
            Metres.
        covariance : array (K, 2, 2)
            m^2.

        Returns
        -------
        Tracks
            The confirmed tracks, after this step.

        Raises
        ------
        InputError
            If shapes do not agree, or the time is not later than the last.
        """
        position, covariance = np.asarray(position, float), np.asarray(covariance, float)
        k = len(position)
        if position.shape != (k, 2) or covariance.shape != (k, 2, 2):
            raise InputError(f"positions {position.shape} and covariances {covariance.shape}")
        if not time > self._latest:
            raise InputError(f"a step at {time:g} s is not later than the last, {self._latest:g} s")
        self._latest = float(time)
        when = _ZERO + timedelta(seconds=self._latest)
        free = [self._soup.detection(x, c, when) for x, c in zip(position, covariance, strict=True)]
        for confirmed in (True, False):  # confirmed tracks choose first
            mine = [t for t in self._tracks if t.confirmed == confirmed]
            free = self._extend(mine, free, when)
        self._tracks = [t for t in self._tracks if self._lives(t)]
        for one in free:
            path = self._soup.start(one, self.velocity_sd)
            self._tracks.append(_Track(self._next, path))
            self._next += 1
        return self._confirmed()

    def predict(self, time: float) -> Tracks:
        """The confirmed tracks as they should be at a time (s) after the latest step."""
        when = _ZERO + timedelta(seconds=float(time))
        mine = [t for t in self._tracks if t.confirmed]
        return _tracks(mine, [self._predictor.predict(t.path, timestamp=when) for t in mine])

    def _extend(self, tracks: list[_Track], free: list, when: datetime) -> list:
        """Associate and update; return the positions that no track took."""
        if not tracks:
            return free
        chosen = self._associator.associate([t.path for t in tracks], free, when)
        taken = set()
        for track in tracks:
            state, hit, used = self._soup.update(self._updater, chosen[track.path])
            track.path.append(state)
            track.hits.append(hit)
            taken |= used
        return [one for one in free if id(one) not in taken]

    def _lives(self, track: _Track) -> bool:
        m, n = self.confirm
        keep = max(n, self.delete[1])
        while len(track.hits) > keep:
            track.hits.popleft()
        latest = list(track.hits)
        if not track.confirmed:
            track.confirmed = sum(latest[-n:]) >= m
            return track.confirmed or sum(latest) + n - len(latest) >= m
        return self.delete[1] - sum(latest[-self.delete[1] :]) < self.delete[0]

    def _confirmed(self) -> Tracks:
        mine = [t for t in self._tracks if t.confirmed]
        return _tracks(mine, [t.path for t in mine])


def _tracks(tracks: list[_Track], states: list[Any]) -> Tracks:
    order = [0, 2, 1, 3]  # Stone Soup's x, vx, y, vy
    mean = np.array([np.ravel(s.state_vector) for s in states], float).reshape(-1, 4)[:, order]
    covariance = np.array([s.covar for s in states], float).reshape(-1, 4, 4)
    number = np.array([t.number for t in tracks], int)
    return Tracks(number, mean[:, :2], mean[:, 2:], covariance[:, order][:, :, order])
