"""Small simulated studies for the gallery; each is made once, however many figures want it."""

from functools import cache

import jax
import numpy as np

import maloc
from maloc.simulate import simulate


@cache
def study():
    """One animal in a canal of twelve receivers, six of them with a sync tag; clocks drift."""
    return simulate(np.random.default_rng(1), "canal", n_pings=60)


@cache
def clocks():
    """Return the receivers' clocks, from the sync tags."""
    return maloc.sync.fit(study().detections, study().receivers)


@cache
def long_study():
    """The same array for six hours: clocks have time to drift."""
    slow = maloc.Schedule("random", 300.0, 420.0)
    return simulate(np.random.default_rng(2), "canal", n_pings=60, schedule=slow, drift_ppm=20.0)


@cache
def long_clocks():
    """Return the clocks of those six hours."""
    return maloc.sync.fit(long_study().detections, long_study().receivers)


@cache
def arrivals():
    """Return the animal's arrival times on one clock, pings that nobody heard left out."""
    detections = clocks().apply(study().detections)
    interval = maloc.Schedule("random", 20.6, 36.6)
    return maloc.toa_matrix(detections, study().receivers, tag=study().toa.tag, schedule=interval)


@cache
def fit():
    """Return the track by the Laplace approximation."""
    return maloc.infer.laplace(maloc.models.toa_track, arrivals())


@cache
def sampled():
    """Return the same track by NUTS, two short chains."""
    key = jax.random.key(0)
    return maloc.infer.nuts(
        key, maloc.models.toa_track, arrivals(), draws=200, warmup=200, progress=False
    )


def truth():
    """Return the animal's true positions (P, 2), m."""
    return np.column_stack([study().truth.x, study().truth.y])
