"""Resource selection with positions known, uncertain, and too uncertain."""

import numpy as np
import pytest

from maloc.biology import resource_selection
from maloc.errors import FitError, InputError

SIDE, WAVE = 400.0, 50.0
BETA = 1.5


def habitat(xy):
    """One covariate: stripes and patches of 25 m."""
    k = 2 * np.pi / WAVE
    return (np.sin(k * xy[..., 0]) * np.sin(k * xy[..., 1]))[..., None]


def places(rng, n):
    return rng.uniform(0, SIDE, (n, 2))


def chosen(rng, n, beta=BETA):
    """Positions with density proportional to exp(beta h), by rejection."""
    xy = places(rng, 20 * n)
    keep = rng.random(len(xy)) < np.exp(beta * (habitat(xy)[:, 0] - 1))
    return xy[keep][:n]


@pytest.fixture(scope="module")
def known():
    rng = np.random.default_rng(0)
    return rng, chosen(rng, 600), places(rng, 20_000)


def test_known_positions(known):
    _, xy, available = known
    found = resource_selection(xy[None], habitat, available)
    assert abs(found.coefficient[0] - BETA) < 3 * found.sd[0]
    assert found.low[0] < BETA < found.high[0]
    # curvature by differences of the likelihood, written out anew
    value = [
        (b * habitat(xy)).sum() - len(xy) * np.log(np.exp(b * habitat(available)).mean())
        for b in found.coefficient[0] + 1e-3 * np.array([-1, 0, 1])
    ]
    sd = 1 / np.sqrt((2 * value[1] - value[0] - value[2]) / 1e-6)
    np.testing.assert_allclose(found.sd[0], sd, rtol=1e-3)
    np.testing.assert_allclose(found.log_likelihood, value[1], rtol=1e-9)
    assert value[1] > max(value[0], value[2])


def test_uncertain_positions_are_integrated_over(known):
    """Errors of 10 m among patches of 25 m: pooled draws and means are biased, this is not."""
    rng, xy, available = known
    seen = xy + rng.normal(0, 10.0, xy.shape)
    draws = seen + rng.normal(0, 10.0, (400, *xy.shape))  # posterior under a flat prior
    found = resource_selection(draws, habitat, available)
    mean = resource_selection(seen[None], habitat, available)
    pooled = np.mean(
        [resource_selection(d[None], habitat, available).coefficient[0] for d in draws[:10]]
    )
    assert abs(found.coefficient[0] - BETA) < 3 * found.sd[0]
    assert pooled < mean.coefficient[0] < BETA - 3 * mean.sd[0]
    assert found.sd[0] > 1.5 * mean.sd[0]  # and it knows that it knows less


def test_two_covariates_and_units():
    """Coefficients do not depend on the covariates' units, nor on what is added to them."""
    rng = np.random.default_rng(1)
    xy, available = chosen(rng, 300), places(rng, 5000)

    def both(p):
        return np.concatenate([habitat(p), 1000.0 + 30.0 * p[..., :1]], axis=-1)

    found = resource_selection(xy[None], both, available)
    alone = resource_selection(xy[None], habitat, available)
    np.testing.assert_allclose(found.coefficient[0], alone.coefficient[0], rtol=0.05)
    assert abs(found.coefficient[1]) < 4 * found.sd[1]


def test_refused(known):
    _, xy, available = known
    with pytest.raises(InputError, match=r"\(D, n, 2\)"):
        resource_selection(xy, habitat, available)
    with pytest.raises(InputError, match="same everywhere"):
        resource_selection(xy[None], lambda p: np.ones((*p.shape[:-1], 1)), available)
    with pytest.raises(InputError, match="finite"):
        resource_selection(xy[None], lambda p: np.full((*p.shape[:-1], 1), np.nan), available)
    with pytest.raises(FitError, match="too little"):
        resource_selection(np.full((1, 30, 2), 12.5), habitat, np.array([[12.5, 12.5], [0.0, 0.0]]))
