"""Scenes of emitters that move, and what receivers make of them: missed, false, known or not.

A step of a scene is a scan: every emitter calls once, each receiver hears it or does not, and
hears something false besides. The four scenes are those of a published example on tracking by
time differences of arrival (radio: 100 ns are 30 m), whose layout is only drawn there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from maloc.emitters.sensing import Sensing
from maloc.errors import InputError

__all__ = ["SCENES", "Scan", "Scene", "simulate"]

LIGHT = 299_792_458.0  # m/s
_RADIUS, _HALF = 5000.0, 5000.0  # m: receivers stand on a circle, emitters start in a box


class Scan(NamedTuple):
    """What was measured in one step.

    Attributes
    ----------
    value : array (N,)
        Arrival times from the step's own instant, or time differences, s.
    column : array (N,) of int
        Receiver; of a time difference the later of the pair (the other is receiver 0).
    emitter : array (N,) of int
        Who it was, -1 = false. The identity that known-identity scenes tell, else truth alone.
    """

    value: np.ndarray
    column: np.ndarray
    emitter: np.ndarray


@dataclass(frozen=True)
class Scene:
    """What is simulated.

    Parameters
    ----------
    n_receivers, n_emitters : int
        Receivers stand evenly on a circle of 5 km; emitters start anywhere in the square around
        it and keep their velocity.
    kind : {"toa", "tdoa"}
        Arrival times, or their differences from receiver 0.
    known : bool
        Receivers know who calls.
    n_false : int
        False measurements of every receiver (pair) in a step.
    p_detect : float
        Probability that a true one is there.
    sigma : float
        Standard deviation of a measurement, s.
    n_steps : int
    interval : float
        Between steps, s.
    velocity_sd : float
        Standard deviation of an emitter's velocity an axis, m/s.

    Raises
    ------
    InputError
        If a number makes no sense.
    """

    n_receivers: int = 4
    n_emitters: int = 4
    kind: str = "toa"
    known: bool = False
    n_false: int = 1
    p_detect: float = 0.95
    sigma: float = 100e-9
    n_steps: int = 60
    interval: float = 1.0
    velocity_sd: float = 500.0**0.5

    def __post_init__(self) -> None:
        if self.kind not in ("toa", "tdoa"):
            raise InputError(f"a scene of '{self.kind}' is neither toa nor tdoa")
        if self.n_receivers < 3:
            raise InputError(f"{self.n_receivers} receivers: positions need at least 3")
        if self.n_emitters < 0 or self.n_steps < 1 or not self.interval > 0:
            raise InputError("a scene needs steps, some time apart, and no fewer than 0 emitters")
        _ = self.sensing

    @property
    def sensing(self) -> Sensing:
        """What the receivers are, and what is known of them."""
        angle = 2 * np.pi * np.arange(self.n_receivers) / self.n_receivers
        xy = _RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return Sensing(
            xy,
            speed=LIGHT,
            sigma=self.sigma,
            p_detect=self.p_detect,
            n_false=self.n_false,
            reference=0 if self.kind == "tdoa" else None,
            low=(-2 * _HALF, -2 * _HALF),
            high=(2 * _HALF, 2 * _HALF),
            expected=max(self.n_emitters, 1),
        )

    def replace(self, **changes: object) -> Scene:
        """Return a copy with some fields changed, checked again."""
        return replace(self, **changes)  # pyright: ignore[reportArgumentType]


SCENES = {
    "single": Scene(3, 1, "tdoa", True, 0, 1.0),
    "known": Scene(3, 4, "tdoa", True, 0, 1.0),
    "toa": Scene(4, 4, "toa", False, 1, 0.95),
    "tdoa": Scene(4, 4, "tdoa", False, 2, 0.95),
}


def simulate(rng: np.random.Generator, scene: Scene) -> tuple[list[Scan], np.ndarray]:
    """Draw a scene.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    scene : Scene

    Returns
    -------
    scans : list of Scan
        One a step.
    truth : array (n_steps, n_emitters, 2)
        Where the emitters were at each step, m.
    """
    sensing, k = scene.sensing, scene.n_emitters
    start = rng.uniform(-_HALF, _HALF, (k, 2))
    velocity = scene.velocity_sd * rng.standard_normal((k, 2))
    time = scene.interval * np.arange(scene.n_steps)
    truth = start + time[:, None, None] * velocity
    return [_scan(rng, sensing, xy) for xy in truth], truth


def _scan(rng: np.random.Generator, sensing: Sensing, xy: np.ndarray) -> Scan:
    distance = np.linalg.norm(xy[:, None] - sensing.receivers, axis=2)
    listening = np.arange(len(sensing.receivers))
    if sensing.reference is not None:
        distance = distance - distance[:, [sensing.reference]]
        listening = np.delete(listening, sensing.reference)
    heard = rng.random(distance.shape) < sensing.p_detect
    value = distance / sensing.speed + sensing.sigma * rng.standard_normal(distance.shape)
    emitter, column = np.nonzero(heard[:, listening])
    true = value[emitter, listening[column]]
    first, last = sensing.window
    wrong = np.repeat(listening, int(sensing.n_false))
    false = rng.uniform(first[wrong], last[wrong])
    order = rng.permutation(len(true) + len(false))
    return Scan(
        np.concatenate([true, false])[order],
        np.concatenate([listening[column], wrong])[order],
        np.concatenate([emitter, np.full(len(false), -1)])[order],
    )
