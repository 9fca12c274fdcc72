"""How sure the clocks were counts in the arrival error of a track."""

import numpy as np
import pytest
from numpyro.infer.util import log_density
from scipy.stats import norm

import maloc.infer
from maloc._jax import jax, jnp
from maloc.data import arrival_history
from maloc.errors import InputError
from maloc.infer.track import track_table
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests.infer import cases

GAP = slice(8, 12)  # pings of a silence of the sync tags


@pytest.fixture(scope="module")
def times():
    return cases.toa(pings=20, unheard=(), p_late=0.0)[0]


def unsure(times, sd):
    """Clocks that nobody knew well during the gap."""
    clock = np.zeros(times.toa.shape)
    clock[GAP] = sd
    return times.replace(clock_sd=clock)


def test_density_is_that_of_the_two_errors_together(times):
    """Against SciPy: the densities with and without differ by the normal laws of the arrivals."""
    rng = np.random.default_rng(1)
    sd = rng.uniform(0, 0.02, times.toa.shape)
    given = {
        "sigma_step": 0.4,
        "track": jnp.asarray(rng.normal(0, 30, (len(times), 2))),
        "emission": jnp.asarray(rng.normal(-60, 5, len(times))),
        "sigma": 1.7,
    }

    @jax.jit
    def density(data):
        return log_density(toa_track, (data,), {"movement": "rw", "error": "gaussian"}, given)[0]

    plain = to_model_data(times, pad=False)
    clocks, exact = (
        to_model_data(times.replace(clock_sd=s), pad=False) for s in (sd, np.zeros(sd.shape))
    )
    distance = np.linalg.norm(
        np.asarray(given["track"])[:, None] - np.asarray(plain.receiver_xy), axis=-1
    )
    error = np.asarray(plain.range) - np.asarray(given["emission"])[:, None] - distance
    both = np.hypot(1.7, cases.SPEED * sd)
    gain = norm.logpdf(error, 0, both) - norm.logpdf(error, 0, 1.7)
    expected = gain[times.heard].sum()
    assert float(density(exact)) == pytest.approx(float(density(plain)), rel=1e-12)
    # the model rounds off the distance's corner at half a metre
    assert float(density(clocks) - density(plain)) == pytest.approx(expected, rel=2e-3)


def test_a_track_is_less_sure_where_clocks_were(times):
    def sds(toa):
        fit = maloc.infer.laplace(toa_track, toa, movement="rw", error="gaussian", draws=10)
        return track_table(fit, toa).select("sd_x", "sd_y").to_numpy().mean(axis=1)

    plain, wide = sds(unsure(times, 0.0)), sds(unsure(times, 0.05))
    assert (wide[GAP] > 3 * plain[GAP]).all()
    away = np.r_[0:6, 14:20]
    np.testing.assert_allclose(wide[away], plain[away], rtol=0.2)


def test_a_history_of_the_joint_model_reads_them(times):
    data = to_model_data(arrival_history(unsure(times, 0.01)), pad=False)
    assert np.asarray(data.clock_sd)[GAP] == pytest.approx(0.01 * cases.SPEED)
    assert (np.asarray(data.clock_sd)[: GAP.start] == 0).all()
    assert (np.asarray(to_model_data(arrival_history(times)).clock_sd) == 0).all()


def test_a_negative_standard_error_is_refused(times):
    with pytest.raises(InputError, match="negative"):
        unsure(times, -0.01)
