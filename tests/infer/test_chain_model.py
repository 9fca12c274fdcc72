"""A model seen as a chain: its band Hessian against the dense one, for our models and others'."""

from typing import Any

import jax.monitoring
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro import handlers
from numpyro.infer.util import potential_energy

import maloc.infer
from maloc._jax import jax, jnp
from maloc.errors import FitError
from maloc.infer._model import chain_model
from maloc.infer.mode import find_mode
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests.infer import cases
from tests.oracles import from_band

# every movement with every error, every schedule twice
OPTIONS = [
    ("ctcrw", "ddetect", "unknown", "given"),
    ("rw", "student", "stable", "given"),
    *[
        pytest.param(*options, marks=pytest.mark.extended)
        for options in (
            ("ctcrw", "gaussian", "random", "estimated"),
            ("ctcrw", "student", "unknown", "given"),
            ("rw", "ddetect", "random", "given"),
            ("rw", "gaussian", "unknown", "estimated"),
        )
    ],
]


def some_point(cm, args, seed=0, scale=1.0):
    """Any path and parameters: nothing is near a mode here."""
    rng = np.random.default_rng(seed)
    x = scale * rng.normal(size=(cm.length(args), cm.d))
    return x, 0.3 * rng.normal(size=cm.k)


def dense_hessian(cm, x, u, args):
    function = jax.jit(jax.hessian(lambda flat: -cm.log_joint(flat.reshape(x.shape), u, args)))
    return np.asarray(function(jnp.asarray(x.ravel())))


def assert_same(ours, wanted, tol=1e-9):
    """To ``tol`` of each entry's own scale, the geometric mean of its two diagonal entries."""
    scale = np.sqrt(np.abs(np.diag(wanted)) + 1e-12 * np.abs(wanted).max())
    np.testing.assert_array_less(np.abs(ours - wanted) / np.outer(scale, scale), tol)


@pytest.mark.parametrize(("movement", "error", "schedule", "speed"), OPTIONS)
def test_toa_track_band_is_the_hessian(movement, error, schedule, speed):
    times, _, position = cases.toa(kind=schedule)
    args = (to_model_data(times),)
    assert bool((~args[0].valid).any())  # some padding is in it
    options = {"movement": movement, "error": error, "sound_speed": speed}
    cm = chain_model(toa_track, options, args)
    assert cm.d == (5 if movement == "ctcrw" else 3)
    assert [site.name for site in cm.chain] == ["track", "emission"]
    x, u = some_point(cm, args, scale=2.0)
    x[:13, :2] += position
    x[:, -1] -= 60.0
    value, gradient, band = cm.exact(x, u, args, 0.0)
    wanted = dense_hessian(cm, x, u, args)
    assert_same(from_band(band), wanted)
    step = 1e-5 * np.random.default_rng(1).normal(size=x.shape)
    ends = [float(cm.exact(x + s * step, u, args, 0.0)[0]) for s in (1, -1)]
    slope = 2 * float(np.sum(gradient * step))
    np.testing.assert_allclose(ends[0] - ends[1], slope, rtol=1e-6)
    # the Gauss-Newton band: same value and gradient, always positive definite
    for robust in (False, True):
        value2, gradient2, band2 = cm.terms(x, u, args, 0.0, robust)
        np.testing.assert_allclose(value2, value, rtol=1e-12)
        np.testing.assert_allclose(gradient2, gradient, rtol=1e-9, atol=1e-9)
        if schedule != "random":  # whose soft walls are not part of an arrival law
            assert np.linalg.eigvalsh(from_band(band2)).min() > 0


@pytest.mark.parametrize("name", ["ranges_only", "fixes", "counts"])
def test_band_of_models_that_no_library_ships(name):
    model, args, path = {
        "ranges_only": (cases.ranges_only, cases.ranges_data(), None),
        "fixes": (cases.fixes, cases.fixes_data(), None),
        "counts": (cases.counts, (jnp.asarray([3.0, 0, 1, 4, 7, 5, 2, 0, 1]),), ("level",)),
    }[name]
    cm = chain_model(model, {}, args, path)
    x, u = some_point(cm, args)
    assert_same(from_band(cm.exact(x, u, args, 0.0)[2]), dense_hessian(cm, x, u, args))
    # probing says nothing of the order in which it is done: every block is there
    assert (cm.d, cm.k) == {"ranges_only": (3, 4), "fixes": (2, 2), "counts": (1, 2)}[name]


def test_gauss_newton_of_gaussian_arrivals():
    """Prior's Hessian plus J'J / sigma^2, J the Jacobian of the predicted arrivals."""
    times, _, position = cases.toa()
    args = (to_model_data(times, pad=False),)
    options = {"movement": "rw", "error": "gaussian", "sound_speed": "given"}
    cm = chain_model(toa_track, options, args)
    x, u = some_point(cm, args)
    x[:, :2] += np.delete(position, 4, axis=0)
    shape = x.shape

    def trace(flat):
        values, _ = cm.sites(flat.reshape(shape), u)
        return handlers.trace(handlers.substitute(toa_track, data=values)).get_trace(
            *args, **options
        )

    def predicted(flat):
        loc = trace(flat)["arrival"]["fn"].base_dist.loc
        return jnp.where(args[0].heard, loc, 0.0).ravel()

    def prior(flat):
        sites = trace(flat)
        return -sum(sites[n]["fn"].log_prob(sites[n]["value"]).sum() for n in ("track", "emission"))

    flat = jnp.asarray(x.ravel())
    jacobian = np.asarray(jax.jit(jax.jacobian(predicted))(flat))
    sigma = float(cm.sites(x, u)[0]["sigma"])
    wanted = np.asarray(jax.jit(jax.hessian(prior))(flat)) + jacobian.T @ jacobian / sigma**2
    for robust in (False, True):
        assert_same(from_band(cm.terms(x, u, args, 0.0, robust)[2]), wanted)


def test_cross_derivative():
    args = cases.ranges_data()
    cm = chain_model(cases.ranges_only, {}, args)
    x, u = some_point(cm, args)
    mixed, own = cm.cross(x, u, args)
    slope = jax.jit(jax.grad(lambda x, u: -cm.log_joint(x, u, args)))
    wanted = jax.jit(jax.jacobian(lambda u: slope(x, u)))(jnp.asarray(u))
    np.testing.assert_allclose(mixed, np.moveaxis(wanted, -1, 0), rtol=1e-8, atol=1e-8)
    wanted = jax.jit(jax.hessian(lambda u: -cm.log_joint(x, u, args)))(jnp.asarray(u))
    np.testing.assert_allclose(own, wanted, rtol=1e-7, atol=1e-6)


def test_joint_density_is_numpyro_s():
    """Log joint = NumPyro's own log density of unconstrained values."""
    args = cases.ranges_data()
    cm = chain_model(cases.ranges_only, {}, args)
    x, u = some_point(cm, args)
    values, _ = jax.jit(cm.sites)(x, u)
    free = {site.name: u[site.place].reshape(site.shape) for site in cm.globals}
    free |= {site.name: values[site.name] for site in cm.chain}
    seeded = handlers.seed(cases.ranges_only, 0)
    energy = jax.jit(lambda free: potential_energy(seeded, args, {}, free))(free)
    np.testing.assert_allclose(jax.jit(cm.log_joint)(x, u, args), -energy, rtol=1e-12)


def test_flat_and_sites_round_trip():
    args = cases.ranges_data()
    cm = chain_model(cases.ranges_only, {}, args)
    x, u = some_point(cm, args)
    values, log_det = jax.jit(cm.sites)(x, u)
    assert {k: v.shape for k, v in values.items()} == {
        "track": (11, 2),
        "bias": (11,),
        "sigma_step": (),
        "scale": (),
        "weights": (3,),
    }
    np.testing.assert_allclose(cm.flat_path(values), x)
    np.testing.assert_allclose(cm.flat_globals(values), u, rtol=1e-10)
    np.testing.assert_allclose(np.sum(values["weights"]), 1.0)
    # d natural / d unconstrained, by hand: both scales are exp(u)
    weights = next(s for s in cm.globals if s.name == "weights")
    inner = jax.jacobian(lambda v: weights.transform(v)[:2])(jnp.asarray(u[weights.place]))
    by_hand = u[0] + u[1] + np.linalg.slogdet(np.asarray(inner))[1]
    np.testing.assert_allclose(log_det, by_hand, rtol=1e-8)


class TestRefused:
    def test_no_chain(self):
        def model(y):
            numpyro.sample("y", dist.Normal(numpyro.sample("m", dist.Normal(0.0, 1.0)), 1.0), obs=y)

        with pytest.raises(FitError, match="no path site"):
            maloc.infer.laplace(model, jnp.zeros(3))

    def test_bounded_path(self):
        def model(y):
            law = dist.LogNormal(0.0, 1.0).expand(y.shape).to_event(1)
            level = numpyro.sample("level", law, infer={"is_chain": True})
            numpyro.sample("y", dist.Normal(level, 1.0), obs=y)

        with pytest.raises(FitError, match="'level' must be unbounded"):
            maloc.infer.laplace(model, jnp.zeros(3))

    def test_unequal_lengths(self):
        def model(y):
            for name, n in (("a", 3), ("b", 4)):
                law = dist.Normal(0.0, 1.0).expand((n,)).to_event(1)
                numpyro.sample(name, law, infer={"is_chain": True})
            numpyro.sample("y", dist.Normal(0.0, 1.0), obs=y)

        with pytest.raises(FitError, match=r"differ in length: \[3, 4\]"):
            maloc.infer.laplace(model, jnp.zeros(3))


COMPILED: list[str] = []


def _count_compilation(event: str, duration_secs: float, **_: object) -> None:
    if "backend_compile" in event:
        COMPILED.append(event)


jax.monitoring.register_event_duration_secs_listener(_count_compilation)


def test_a_second_data_set_of_one_shape_compiles_nothing():
    def own(dt, observed):  # a model of its own: nothing of it has been compiled before
        cases.fixes(dt, observed)

    COMPILED.clear()
    first = maloc.infer.laplace(own, *cases.fixes_data(0))
    assert COMPILED
    COMPILED.clear()
    second = maloc.infer.laplace(own, *cases.fixes_data(1))
    assert not COMPILED
    assert second.cm is first.cm
    maloc.infer.laplace(own, *cases.fixes_data(1, length=15))
    assert COMPILED  # another shape


def test_arrays_of_other_sizes_in_one_process_have_their_own_sites():
    """Parameters by receiver, a path as wide as there are animals: the shapes are the data's."""

    def model(seen, heard):
        level: Any = numpyro.sample("level", dist.Normal(0, 1).expand([heard.shape[1]]).to_event(1))
        first = numpyro.sample(
            "path",
            dist.Normal(0, 1).expand(seen.shape).to_event(1),
            infer={"is_chain": True},
        )
        numpyro.sample("seen", dist.Normal(first, 1), obs=seen)
        numpyro.sample("heard", dist.Normal(level[None], 1), obs=heard)

    rng = np.random.default_rng(2)
    for receivers, animals in ((3, 1), (4, 1), (4, 2), (3, 1)):
        args = (rng.normal(size=(6, animals)), rng.normal(size=(5, receivers)))
        cm = chain_model(model, {}, args)
        assert (cm.k, cm.d) == (receivers, animals)
        level = args[1].sum(0) / 6
        mode = find_mode(cm, args, np.zeros((6, animals)), level)
        np.testing.assert_allclose(mode.x, args[0] / 2, atol=1e-9)
        fit = maloc.infer.laplace(model, *args, draws=400)
        drawn = fit.draws()["level"]
        assert drawn.shape == (1, 400, receivers)
        np.testing.assert_allclose(drawn.mean((0, 1)), level, atol=5 / np.sqrt(6 * 400))
