"""The soft box against quadrature, its own convolution, and draws."""

import numpy as np
import pytest
from scipy import integrate, stats

from maloc._jax import jax, jnp
from maloc.world.statespace import SoftBox


@pytest.mark.parametrize("edge", [0.05, 0.5, 4.0])
def test_density_is_a_uniform_convolved_with_a_logistic(edge):
    box = SoftBox(jnp.array([-1.0]), jnp.array([2.0]), edge)
    for x in (-1.5, -1.0, 0.3, 2.0, 2.7):
        wanted = np.diff(stats.logistic.cdf([(x - 2.0) / edge, (x + 1.0) / edge]))[0] / 3.0
        np.testing.assert_allclose(box.log_prob(jnp.array([x])), np.log(wanted), rtol=1e-9)


def test_two_axes_integrate_to_one():
    box = SoftBox(jnp.array([-1.0, 0.0]), jnp.array([2.0, 5.0]), 0.3)
    density = jax.jit(lambda x, y: jnp.exp(box.log_prob(jnp.stack([x, y]))))
    found = integrate.dblquad(lambda y, x: float(density(x, y)), -6, 7, -5, 10, epsabs=1e-4)
    assert found[0] == pytest.approx(1.0, abs=1e-4)


def test_draws():
    """Their mean, variance and distribution function."""
    box = SoftBox(jnp.array([-1.0, 10.0]), jnp.array([2.0, 11.0]), 0.2)
    draws = np.asarray(box.sample(jax.random.key(0), (40_000,)))
    np.testing.assert_allclose(draws.mean(0), box.mean, atol=0.03)
    np.testing.assert_allclose(draws.var(0), box.variance, rtol=0.03)
    grid = np.linspace(-3, 4, 2001)
    log_density = box.log_prob(jnp.stack([jnp.asarray(grid), jnp.full(2001, 10.5)], axis=1))
    cdf = integrate.cumulative_trapezoid(np.exp(log_density), grid, initial=0)
    seen = np.searchsorted(np.sort(draws[:, 0]), grid) / len(draws)
    assert np.abs(seen - cdf / cdf[-1]).max() < 1.63 / np.sqrt(len(draws))  # Kolmogorov, 1 %


def test_far_outside_is_finite():
    box = SoftBox(jnp.zeros(2), jnp.ones(2), 1e-3)
    value, slope = jax.value_and_grad(box.log_prob)(jnp.array([900.0, -900.0]))
    assert np.isfinite(value)
    np.testing.assert_allclose(slope, [-1e3, 1e3], rtol=1e-9)
