"""Fits that several tests look at from different sides."""

import pytest

import maloc.infer
from maloc._jax import jax
from maloc.models import toa_track
from tests.infer import cases


@pytest.fixture(scope="session")
def toa():
    """Thirteen pings, the fifth heard by nobody; emission times and positions."""
    return cases.toa()


@pytest.fixture(scope="session")
def laplace_fit(toa):
    return maloc.infer.laplace(toa_track, toa[0])


@pytest.fixture(scope="session")
def sampled_fit(laplace_fit):
    return maloc.infer.nuts(jax.random.key(1), laplace_fit, draws=200, warmup=150, progress=False)


@pytest.fixture(scope="session")
def fixes_fit():
    return maloc.infer.laplace(cases.fixes, *cases.fixes_data())
