"""Arrival laws against SciPy, quadrature, mpmath and Bayes by hand."""

import functools
import itertools
import math
from typing import Any

import mpmath
import numpy as np
import numpyro
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from maloc._jax import jax, jnp
from maloc.arrival import (
    ArrivalError,
    DDetect,
    Gaussian,
    GaussianStudent,
    GeneralizedNormal,
    Multipath,
    Student,
)
from tests import oracles

PHI, SIGMA = 120.0, 2.0
FALSE_ALARM = 1e-6  # of each random check; every seed is fixed, so it fails for good or never

GAUSSIAN = Gaussian(3.0, SIGMA)
STUDENT = Student(3.0, SIGMA, 3.0)
LETTER = DDetect(3.0, SIGMA, PHI, 0.3)  # kaltoa's ddetect to the letter
ROBUST = DDetect(3.0, SIGMA, PHI, 0.3, background=0.02)
ODD = DDetect(3.0, SIGMA, PHI, 0.3, beta=7.0)
MIXTURE = GaussianStudent(3.0, SIGMA, 25.0, 0.15)
WATER = Multipath(3.0, SIGMA, 8.0, 0.3, 0.6, 12.0, 0.02, PHI)
GENNORM = GeneralizedNormal(3.0, 5.0, 32.0)
ERRORS = {
    "gaussian": GAUSSIAN,
    "student": STUDENT,
    "ddetect": LETTER,
    "background": ROBUST,
    "odd": ODD,
    "mixture": MIXTURE,
    "multipath": WATER,
}
LAWS = {**ERRORS, "gennorm": GENNORM}
SCIPY: dict[str, Any] = {
    "gaussian": stats.norm(3.0, SIGMA),
    "student": stats.t(3.0, 3.0, SIGMA),
    "gennorm": stats.gennorm(32.0, 3.0, 5.0),
}


def case(table, long=()):
    """Every law of the table; those named in ``long`` in the long run only."""
    laws = [
        pytest.param(law, marks=[pytest.mark.extended] if name in long else [], id=name)
        for name, law in table.items()
    ]
    return pytest.mark.parametrize("law", laws)


@functools.cache
def compiled(name):
    return jax.jit(lambda law, value: getattr(law, name)(value))


def at(law, name, value):
    """A method of a law at values of any shape; few shapes are compiled, for each law's class."""
    value = np.asarray(value, dtype=float)
    room = next(n for n in (64, 4096, 8192, 40960) if value.size <= n)
    flat = np.full(room, float(law.loc))
    flat[: value.size] = value.ravel()
    return np.asarray(compiled(name)(law, flat))[: value.size].reshape(value.shape)


@jax.jit
def moments(law):
    return law.mean, law.variance


def derivative(of):
    return jax.jit(lambda law, value: jax.vmap(jax.grad(lambda v: of(law, v)))(value))


slope_of_cdf = derivative(lambda law, value: law.cdf(value))
slope_of_log_prob = derivative(lambda law, value: law.log_prob(value))
bend_of_log_prob = derivative(lambda law, value: jax.grad(law.log_prob)(value))


VALUES = np.r_[np.linspace(-60, 60, 41), -1e5, 1e5]


def awkward(law=LETTER):
    """Residuals where a mixture's formulas break first."""
    middle = [-30.0, -6.0, -1.0, -1e-9, 0.0, 1e-9, 1.0, 6.0, 11.0]
    late = [PHI / 2 - 1, PHI / 2, PHI / 2 + 1e-12, PHI - 1, PHI, PHI + 0.5, PHI + 9, 2 * PHI]
    far = [-1e3 * PHI, 1e3 * PHI, -10 * PHI, 10 * PHI]
    return jnp.asarray(np.array(middle + late + far) + float(law.loc))


# -- densities -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCIPY)
def test_density_cdf_and_quantiles_equal_scipys(name):
    law, want = LAWS[name], SCIPY[name]
    q = np.array([1e-10, 1e-4, 0.03, 0.2, 0.5, 0.7, 0.99, 1 - 1e-6])
    value = want.ppf(q)
    np.testing.assert_allclose(
        at(law, "log_prob", value), want.logpdf(value), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(at(law, "cdf", value), want.cdf(value), rtol=1e-11)
    np.testing.assert_allclose(at(law, "icdf", q), value, rtol=1e-8)
    assert moments(law) == pytest.approx((want.mean(), want.var()), rel=1e-12)


def test_gaussian_student_is_the_sum_of_scipys():
    """Density, shares of the parts, moments."""
    parts = 0.85 * stats.norm.pdf(VALUES, 3.0, SIGMA), 0.15 * stats.t.pdf(VALUES, 3.0, 3.0, 25.0)
    np.testing.assert_allclose(at(MIXTURE, "log_prob", VALUES), np.log(sum(parts)), rtol=1e-12)
    np.testing.assert_allclose(at(MIXTURE, "p_direct", VALUES), parts[0] / sum(parts), rtol=1e-12)
    assert moments(MIXTURE) == pytest.approx((3.0, 0.85 * SIGMA**2 + 0.15 * 3 * 25.0**2))
    assert float(MIXTURE.widened(50.0).scale) == 50


@pytest.mark.parametrize("beta", [0.7, 1.0, 2.0, 3.3, 8.0, 32.0, 200.0])
def test_generalized_normal_over_shapes(beta):
    fixed = GeneralizedNormal(-2.0, 0.4, beta)
    law = GeneralizedNormal(-2.0, 0.4, jnp.asarray(beta))
    want: Any = stats.gennorm(beta, -2.0, 0.4)
    value = np.r_[-2.0, want.ppf([1e-6, 0.01, 0.3, 0.5 + 1e-12, 0.8, 1 - 1e-6])]
    np.testing.assert_allclose(
        at(law, "log_prob", value), want.logpdf(value), rtol=1e-11, atol=1e-11
    )
    np.testing.assert_allclose(at(law, "cdf", value), want.cdf(value), rtol=1e-9)
    np.testing.assert_allclose(at(law, "icdf", want.cdf(value)), value, rtol=1e-9)
    np.testing.assert_allclose(moments(law), [-2.0, want.var()], rtol=1e-12)
    rtol = 1e-9 if beta >= 1 else 1e-7  # 1 / 2 + 1e-12 is not the centre for a cusp
    np.testing.assert_allclose(slope_of_cdf(law, value), want.pdf(value), rtol=rtol)
    far = np.array([-1e3, 1e3]) * 0.4 - 2.0
    assert np.all(np.isfinite(slope_of_log_prob(law, far)))
    if beta < 64:  # |1e3|^beta is a double
        np.testing.assert_allclose(at(law, "log_prob", far), want.logpdf(far), rtol=1e-12)
    np.testing.assert_allclose(
        at(law, "log_prob", value), at(fixed, "log_prob", value), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("w", [0.0, 1e-12, 0.3, 1 - 1e-9, 1.0])
@pytest.mark.parametrize("background", [0.0, 1e-4, 0.02])
def test_ddetect_is_the_formula(w, background):
    law = DDetect(3.0, SIGMA, PHI, w, background=background)
    for value, got in zip(awkward(), at(law, "log_prob", awkward()), strict=True):
        want = oracles.ddetect_log_density(float(value) - 3.0, SIGMA, PHI, w, 32, background)
        if want < -1e65:  # all late, no background and 1000 phi out: the power is cut
            assert got < -1e65
        else:
            assert float(got) == pytest.approx(want, rel=1e-11, abs=1e-12)


@given(
    sigma=st.floats(0.01, 30),
    phi=st.floats(1, 2000),
    w=st.floats(0, 1),
    background=st.sampled_from([0.0, 1e-4]),
)
def test_ddetect_integrates_to_one(sigma, phi, w, background):
    law = DDetect(0.0, sigma, phi, w, background=background)
    wild = 10 * phi
    edges = np.r_[-np.geomspace(1e5, 1, 9) * wild, phi / 2, np.geomspace(1, 1e5, 9) * wild]
    near = [-9 * sigma, -3 * sigma, 0, 3 * sigma, 9 * sigma]
    edges = np.unique(np.r_[edges, near, -0.2 * phi, 0.1 * phi, 0.9 * phi, 1.2 * phi])
    nodes, weights = np.polynomial.legendre.leggauss(80)
    half = np.diff(edges)[:, None] / 2
    points = edges[:-1, None] + half * (nodes[None] + 1)
    density = np.exp(at(law, "log_prob", points))
    assert np.sum(density * weights[None] * half) == pytest.approx(1.0, abs=1e-7)


@case({k: v for k, v in LAWS.items() if k not in ("gaussian", "student")})
def test_cdf_is_the_integral_of_the_density(law):
    values = np.array(
        [-40.0, -1.0, 0.0, 2.5, 3.0, 4.0, 8.2, 20.0, 60.0, 110.0, 121.0, 124.0, 300.0]
    )

    def density(value):
        return np.exp(at(law, "log_prob", value))

    height = at(law, "cdf", values)
    for i, (low, high) in enumerate(itertools.pairwise(values)):
        area, _ = integrate.quad(density, low, high, epsabs=1e-11, epsrel=1e-11, limit=200)
        assert height[i + 1] - height[i] == pytest.approx(area, abs=1e-9)
    np.testing.assert_allclose(at(law, "cdf", [-1e9, 1e9]), [0, 1], atol=1e-9)


@case(LAWS, long=["odd", "mixture"])
def test_icdf_inverts_the_cdf(law):
    q = jnp.asarray([1e-8, 1e-3, 0.1, 0.35, 0.5, 0.69, 0.71, 0.9, 0.999])
    value = at(law, "icdf", q)
    np.testing.assert_allclose(at(law, "cdf", value), q, rtol=1e-9)
    slope = jax.jit(jax.vmap(jax.grad(law.icdf)))(q)
    np.testing.assert_allclose(slope * np.exp(at(law, "log_prob", value)), 1, rtol=1e-6)
    if law in (GENNORM, LETTER):
        ends = at(law, "icdf", [0.0, 1.0, -0.1, 1.1, math.nan])
        assert ends[:2].tolist() == [-math.inf, math.inf] and np.isnan(ends[2:]).all()


def test_icdf_moves_with_the_parameters():
    @jax.jit
    def at(w):
        return DDetect(0.0, SIGMA, PHI, w).icdf(0.8)

    step = 1e-5
    want = (at(0.3 + step) - at(0.3 - step)) / (2 * step)
    assert float(jax.grad(at)(0.3)) == pytest.approx(float(want), rel=1e-5)


@case(
    {"ddetect": LETTER, "background": ROBUST, "odd": ODD, "gennorm": GENNORM, "multipath": WATER},
    long=["odd", "ddetect"],
)
def test_mean_and_variance_by_quadrature(law):
    # by quantiles, so that the tails are where they are
    nodes, weights = np.polynomial.legendre.leggauss(400)
    edges = np.array([1e-15, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.2, 0.5])
    edges = np.r_[edges, 1 - edges[-2::-1]]
    q = edges[:-1, None] + np.diff(edges)[:, None] * (nodes[None] + 1) / 2
    w = np.diff(edges)[:, None] * weights[None] / 2
    value = at(law, "icdf", q)
    mean = np.sum(w * value)
    got, variance = map(float, moments(law))
    assert got == pytest.approx(mean, rel=1e-5)
    rel = 1e-3 if law in (ROBUST, WATER) else 1e-5  # the background has cubic tails
    assert variance == pytest.approx(np.sum(w * (value - mean) ** 2), rel=rel)


# -- gradients -----------------------------------------------------------------------------------


@functools.partial(jax.jit, static_argnums=5)
@functools.partial(jax.vmap, in_axes=(0, None, None, None, None, None))
def all_slopes(value, loc, sigma, phi, w, background):
    def score(*at):
        return DDetect(*at[1:], background=background).log_prob(at[0])

    return jax.value_and_grad(score, argnums=(0, 1, 2, 3, 4))(value, loc, sigma, phi, w)


@pytest.mark.parametrize("w", [0.0, 1e-300, 0.3, 1 - 1e-16, 1.0])
@pytest.mark.parametrize("background", [0.0, 1e-4])
def test_ddetect_gradients_are_finite_everywhere(w, background):
    score, slopes = all_slopes(awkward(), 3.0, SIGMA, PHI, w, background)
    assert np.all(np.isfinite(score))
    assert all(np.all(np.isfinite(slope)) for slope in slopes)


@case({**LAWS, "late": DDetect(3.0, SIGMA, PHI, 1.0), "never": DDetect(3.0, SIGMA, PHI, 0.0)})
def test_gradient_and_second_derivative_finite(law):
    value = awkward(law)
    assert np.all(np.isfinite(slope_of_log_prob(law, value)))
    assert np.all(np.isfinite(bend_of_log_prob(law, value)))


@pytest.mark.parametrize("background", [0.0, 0.02])
def test_ddetect_gradients_are_right(background):
    def exact(value, sigma, phi, w):
        return oracles.ddetect_log_density(value, sigma, phi, w, 32, background, as_float=False)

    _, slopes = all_slopes(awkward(), 0.0, SIGMA, PHI, 0.3, background)
    slopes = np.delete(np.array(slopes), 1, axis=0)  # with respect to loc: minus that to value
    for value, got in list(zip(np.asarray(awkward()), slopes.T, strict=True))[4:-4]:
        point = (float(value), SIGMA, PHI, 0.3)
        want = [
            float(mpmath.diff(exact, point, tuple(int(i == k) for i in range(4)))) for k in range(4)
        ]
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-9)


# -- what the engine asks ------------------------------------------------------------------------


@case(ERRORS)
def test_curvature_is_the_second_derivative_or_the_floor(law):
    value = jnp.asarray(np.r_[np.linspace(-60, 190, 1501), np.asarray(awkward(law))])
    second = np.asarray(bend_of_log_prob(law, value))
    curvature = at(law, "curvature", value)
    floor = 0.1 * at(law, "direct_curvature", value)
    assert np.all(curvature >= 0) and np.all(np.isfinite(curvature))
    np.testing.assert_allclose(curvature, np.maximum(-second, floor), rtol=1e-6, atol=1e-9)
    assert np.any(-second > floor)
    higher = jax.jit(lambda law, value: law.curvature(value, floor=0.5))(law, value)
    assert np.all(higher >= (5 - 1e-12) * floor)


@case(ERRORS)
def test_robust_curvature_is_never_below_the_true_one(law):
    value = jnp.asarray(np.linspace(-60, 190, 3001))
    second = np.asarray(bend_of_log_prob(law, value))
    robust = at(law, "robust_curvature", value)
    assert np.all(robust >= 0)
    assert np.all(robust >= -second * (1 - 1e-9) - 1e-12)


@case({"gaussian": GAUSSIAN, "student": STUDENT, "mixture": MIXTURE})
def test_robust_curvature_majorises_globally(law):
    grid = np.linspace(-80, 80, 401)
    starts = np.array([-50.0, -4.0, 3.0, 9.0])
    top, bends = at(law, "log_prob", starts), at(law, "robust_curvature", starts)
    slopes = np.asarray(slope_of_log_prob(law, starts))
    for i, start in enumerate(starts):
        bound = top[i] + slopes[i] * (grid - start) - 0.5 * bends[i] * (grid - start) ** 2
        assert np.all(at(law, "log_prob", grid) - bound > -1e-9)


@pytest.mark.parametrize("law", [LETTER, ROBUST, ODD])
def test_em_surrogate_of_ddetect_majorises(law):
    """Jensen: shares times the parts' log densities bound the whole; theirs is the curvature."""
    start = jnp.asarray(3.0 + 5.1)
    shares = law._shares(start)
    assert float(sum(shares)) == pytest.approx(1)
    step = 1e-4

    def surrogate(value):
        error = value - 3.0
        late = abs((error - PHI / 2) / (PHI / 2)) ** law.beta
        return -shares[0] * error**2 / (2 * SIGMA**2) - shares[1] * late

    bend = -(surrogate(start + step) - 2 * surrogate(start) + surrogate(start - step)) / step**2
    assert float(at(law, "robust_curvature", start)) == pytest.approx(float(bend), rel=1e-3)


def test_wild_arrivals_pull_at_nothing():
    wild = jnp.asarray([-5 * PHI, 3 * PHI, 50 * PHI])
    law = DDetect(0.0, SIGMA, PHI, 0.3, background=1e-4)
    assert np.all(at(law, "robust_curvature", wild) < 1e-4 / SIGMA**2)
    assert np.all(at(law, "p_direct", wild) == 0)


@pytest.mark.parametrize("background", [0.0, 0.02])
def test_p_direct_is_bayes_by_hand(background):
    law = DDetect(3.0, SIGMA, PHI, 0.3, background=background)
    value = np.asarray([-20.0, 0.0, 3.0, 9.0, 11.0, 14.0, 60.0, 123.0])
    direct = (1 - background) * 0.7 * stats.norm.pdf(value, 3.0, SIGMA)
    late = (1 - background) * 0.3 * stats.gennorm.pdf(value, 32, 3.0 + PHI / 2, PHI / 2)
    wild = background * stats.t.pdf(value, 3, 3.0 + PHI / 2, 10 * PHI)
    np.testing.assert_allclose(
        at(law, "p_direct", value), direct / (direct + late + wild), rtol=1e-9
    )


def test_p_direct_at_the_ends():
    value = awkward()
    assert np.all(at(DDetect(3.0, SIGMA, PHI, 0.0), "p_direct", value) == 1)
    assert np.all(at(DDetect(3.0, SIGMA, PHI, 1.0), "p_direct", value) == 0)
    assert at(GAUSSIAN, "p_direct", np.zeros(4)).tolist() == [1.0] * 4


@case(ERRORS)
def test_widened(law):
    assert float(law.widened(50.0).sigma) == 50
    assert float(law.widened(0.0).sigma) == SIGMA
    value = awkward(law)
    np.testing.assert_array_equal(
        at(law.widened(0.0), "log_prob", value), at(law, "log_prob", value)
    )
    assert type(law.widened(50.0)) is type(law)


class Laplace(ArrivalError):
    """A law of a user's own: nothing but a density."""

    arg_constraints = {"loc": numpyro.distributions.constraints.real}

    def __init__(self, loc=0.0, *, validate_args=None):
        self.loc = loc
        super().__init__(batch_shape=jnp.shape(loc), validate_args=validate_args)

    def log_prob(self, value):
        return -jnp.sqrt(1 + (value - self.loc) ** 2)


def test_a_users_own_law_has_the_defaults():
    law = Laplace(1.0)
    value = jnp.asarray([-5.0, 1.0, 2.0])
    want = (1 + (np.asarray(value) - 1) ** 2) ** -1.5
    np.testing.assert_allclose(at(law, "curvature", value), want, rtol=1e-12)
    np.testing.assert_allclose(at(law, "robust_curvature", value), want, rtol=1e-12)
    assert law.widened(3.0) is law
    assert float(law.mean) == 1


# -- draws ---------------------------------------------------------------------------------------


@case(LAWS, long=["odd", "ddetect"])
def test_draws_follow_the_distribution(law):
    n = 40_000
    drawn = np.asarray(jax.jit(lambda key: law.sample(key, (n,)))(jax.random.key(11)))
    assert stats.kstest(drawn, lambda v: at(law, "cdf", v)).pvalue > FALSE_ALARM
    if law not in (STUDENT, ROBUST, MIXTURE, WATER):  # no fourth moment there
        limit = stats.norm.isf(FALSE_ALARM / 2)
        mean, variance = map(float, moments(law))
        assert abs(drawn.mean() - mean) < limit * math.sqrt(variance / n)
        spread = np.mean((drawn - drawn.mean()) ** 4) - variance**2
        assert abs(drawn.var() - variance) < limit * math.sqrt(spread / n)


def test_wild_draws_are_independent_of_the_direct_ones():
    """With everything wild or direct, both parts' draws come from keys of their own."""
    key = jax.random.key(3)

    @jax.jit
    def both():
        direct = DDetect(0.0, 1.0, 1.0, 0.0, background=1e-12).sample(key, (4000,))
        return direct, DDetect(0.0, 1.0, 1.0, 0.0, background=1 - 1e-12).sample(key, (4000,))

    direct, wild = (np.asarray(x) for x in both())
    assert abs(np.corrcoef(stats.rankdata(direct), stats.rankdata(wild))[0, 1]) < 5 / 4000**0.5


# -- NumPyro's habits ----------------------------------------------------------------------------


@case(LAWS)
def test_shapes_expand_mask_and_pytree(law):
    value = jnp.asarray([1.0, 4.0, 9.0])
    want = at(law, "log_prob", value)
    wide = law.expand((3,))
    assert wide.batch_shape == (3,)
    np.testing.assert_allclose(jax.jit(wide.log_prob)(value), want)
    assert jax.eval_shape(wide.sample, jax.random.key(0)).shape == (3,)
    masked = jax.jit(lambda law, value: law.mask(value > 2).log_prob(value))(wide, value)
    np.testing.assert_allclose(masked, want * (value > 2))
    leaves, tree = jax.tree_util.tree_flatten(law)
    again = jax.tree_util.tree_unflatten(tree, leaves)
    np.testing.assert_array_equal(at(again, "log_prob", value), want)
    np.testing.assert_allclose(law.log_prob(value[:1]), want[:1], rtol=1e-12)  # without jit


@pytest.mark.parametrize("make", [Gaussian, Student, DDetect, GeneralizedNormal, Multipath])
def test_batches_and_vmap_over_instances_agree(make):
    loc = jnp.asarray([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    scale = jnp.asarray([[1.5], [2.5]])
    law = make(loc, scale)
    value = loc + jnp.asarray([[0.1, -2.0, 3.0]])
    assert law.batch_shape == law.mean.shape == law.variance.shape == (2, 3)
    one = jax.jit(lambda loc, scale, value: make(loc, scale).log_prob(value))
    singly = [[one(loc[i, j], scale[i, 0], value[i, j]) for j in range(3)] for i in (0, 1)]
    np.testing.assert_allclose(jax.jit(law.log_prob)(value), np.array(singly), rtol=1e-13)
    laws = jax.vmap(make)(loc, jnp.broadcast_to(scale, (2, 3)))
    mapped = jax.jit(jax.vmap(lambda d, v: d.log_prob(v)))(laws, value)
    np.testing.assert_allclose(mapped, np.array(singly), rtol=1e-13)
    quantiles = jax.jit(law.icdf)(jnp.full((2, 3), 0.7))
    np.testing.assert_allclose(quantiles - loc, quantiles[:, :1] - loc[:, :1] + 0 * loc, rtol=1e-9)
    with jax.numpy_rank_promotion("allow"):
        shapes = jax.eval_shape(lambda key: law.sample(key, (5,)), jax.random.key(0))
        assert shapes.shape == (5, 2, 3)
    if issubclass(make, ArrivalError):
        for curvature in (law.curvature, law.robust_curvature, law.direct_curvature):
            assert jax.eval_shape(curvature, value).shape == (2, 3)
        assert jax.eval_shape(law.p_direct, jnp.asarray(0.0)).shape == (2, 3)


def test_validation():
    for bad in ({"sigma": -1.0}, {"w": 1.5}, {"phi": 0.0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            DDetect(0.0, **bad, validate_args=True)
    with pytest.raises(ValueError, match="beta"):
        DDetect(beta=0.5)
    with pytest.raises(ValueError, match="background"):
        DDetect(background=1.0)
    with pytest.raises(ValueError, match="alpha"):
        GeneralizedNormal(alpha=-1.0, validate_args=True)
    law = DDetect(0.0, 1.0, 10.0, 0.1, validate_args=True)
    assert np.isfinite(law.log_prob(3.0))


def test_student_moments_where_there_are_none():
    assert np.isnan(Student(0.0, 1.0, 1.0).mean)
    assert np.isnan(Student(0.0, 1.0, 0.5).variance)
    assert np.isinf(Student(0.0, 1.0, 2.0).variance)
