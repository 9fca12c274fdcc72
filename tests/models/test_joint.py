"""The joint model: with one term alone it is the model that was there; its terms by hand."""

import numpy as np
import pytest
from numpyro import handlers
from numpyro.infer.util import log_density
from scipy.stats import multivariate_normal

import maloc
from maloc._jax import jax, jnp
from maloc.data import Schedule, arrival_history
from maloc.model_data import to_model_data
from maloc.models import joint, known_interval, toa_track, unknown_interval
from maloc.world.drift import GaussMarkov, IntervalDrift, interval_step
from maloc.world.habitat import water
from tests.infer import cases


def times(kind="unknown", unheard=()):
    return cases.toa(pings=6, unheard=unheard, kind=kind)[0]


def latent(model, args, **options):
    """One prior draw of the latent sites."""
    trace = handlers.trace(handlers.seed(model, 0)).get_trace(*args, **options)
    return {
        n: s["value"] for n, s in trace.items() if s["type"] == "sample" and not s["is_observed"]
    }


def density(model, data, values, **options):
    return float(log_density(model, (data,), options, values)[0])


@pytest.mark.parametrize("movement", ["ctcrw", "rw"])
@pytest.mark.parametrize("error", ["ddetect", "gaussian", "student"])
@pytest.mark.parametrize("kind", ["unknown", "random"])
def test_arrivals_alone_are_toa_track(movement, error, kind):
    toa = times(kind)
    values = latent(toa_track, (toa,), movement=movement, error=error)
    theirs = density(toa_track, toa, values, movement=movement, error=error)
    data = to_model_data(arrival_history(toa, known=False), pad=False)
    assert data.silence != "given"
    ours = density(joint, data, values, movement=movement, arrivals=error, detection=None)
    assert ours == pytest.approx(theirs, rel=1e-10)


@pytest.mark.parametrize("kind", ["halfnormal", "hazard"])
def test_silence_alone_is_the_detection_model(kind):
    alone = {"movement": "rw", "arrivals": None, "detection": kind, "range_drift": False}
    given = to_model_data(arrival_history(times(unheard=(2, 3))), pad=False)
    summed = to_model_data(arrival_history(times("random"), known=False), pad=False)
    assert (given.silence, summed.silence) == ("given", "summed")
    for model, data in ((known_interval, given), (unknown_interval, summed)):
        how = {"movement": "rw", "detection": kind}
        values = latent(model, (data.encounters,), **how)
        theirs = density(model, data.encounters, values, **how)
        assert density(joint, data, values, **alone) == pytest.approx(theirs, rel=1e-10)


def test_heard_pings_are_conditioned_on_being_heard():
    """Encounter histories of a ping that somebody heard sum to one, near and far."""
    from maloc.detection import encounters
    from maloc.models._parts import Heard

    near = np.array([[[0.0, 0.0], [30.0, 0.0], [0.0, 40.0]]])
    every = np.array(list(np.ndindex(2, 2, 2))[1:], bool)[:, None]
    for far in (0.0, 50.0, 400.0):
        for loss in (None, 0.3):
            law = encounters(
                "halfnormal", np.array([[far, 10.0]]), near, np.ones((1, 3), bool), 0.8, 25.0,
                p_lost=loss,
            )  # fmt: skip
            assert np.exp(Heard(law).log_prob(every)).sum() == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"movement": "walk"}, {"arrivals": "t"}, {"detection": "x"}, {"sound_speed": "1500"}]
)
def test_unknown_options_are_refused(wrong):
    with pytest.raises(ValueError, match="is none of"):
        latent(joint, (times(),), **wrong)


def test_nothing_to_learn_from_is_refused():
    with pytest.raises(ValueError, match="nothing to learn"):
        latent(joint, (times(),), arrivals=None, detection=None)


def test_water_without_arrivals_is_refused_not_left_out():
    square = np.array([[-500.0, -500], [500, -500], [500, 500], [-500, 500]])
    with pytest.raises(ValueError, match="water goes with arrivals"):
        latent(joint, (times(), water([[square]])), arrivals=None)


def test_gauss_markov_is_a_multivariate_normal():
    dt, tag, memory = np.array([1.0, 3.0, 1.0, 2.0]), np.array([0, 0, 0, 1, 1]), 4.0
    at = np.concatenate([[0.0], np.cumsum(dt)])
    cov = np.exp(-np.abs(at[:, None] - at) / memory) * (tag[:, None] == tag)
    law = GaussMarkov(jnp.asarray(dt), memory, jnp.asarray(tag))
    x = np.random.default_rng(0).normal(size=(3, 5))
    wanted = multivariate_normal(np.zeros(5), cov).logpdf(x)
    np.testing.assert_allclose(law.log_prob(jnp.asarray(x)), wanted, rtol=1e-10)
    draws = np.asarray(law.sample(jax.random.key(0), (20_000,)))
    np.testing.assert_allclose(np.cov(draws.T), cov, atol=0.04)


def test_interval_drift_and_step_are_sums_of_intervals():
    """The joint law of (drift at the end, sum of n intervals) is that of the intervals summed."""
    sd, jitter, first = 3.0, 0.5, 40.0
    for n in (1, 2, 5):
        # b_0, w_1..w_n, jitters: b_n = b_0 + sum w, total = sum_i (b_0 + w_1 + .. + w_i) + jitters
        end = np.concatenate([[1.0], np.ones(n), np.zeros(n)])
        total = np.concatenate([[n], n - np.arange(1.0, n + 1), np.ones(n)])
        start = np.concatenate([[1.0], np.zeros(2 * n)])
        by = np.stack([start, end, total])
        cov = by @ np.diag(np.concatenate([[first**2], np.full(n, sd**2), np.full(n, jitter**2)]))
        wanted = multivariate_normal(np.zeros(3), cov @ by.T)  # pyright: ignore[reportArgumentType]
        b0, bn, t = 12.0, 15.0, 13.0 * n
        walk = IntervalDrift(np.array([float(n)]), sd, first)
        mean, width = interval_step(float(n), b0, bn, sd, jitter)
        ours = walk.log_prob(jnp.array([b0, bn])) - 0.5 * ((t - mean) / width) ** 2
        ours -= jnp.log(width * np.sqrt(2 * np.pi))
        assert float(ours) == pytest.approx(wanted.logpdf([b0, bn, t]), rel=1e-9)


def test_missed_pings_of_a_stable_interval_become_rows():
    toa = times("stable")
    every = np.arange(len(toa)) != 2
    heard = toa.replace(toa=np.where(every[:, None], toa.toa, np.nan))
    gone = heard.replace(toa=heard.toa[every], sound_speed=heard.sound_speed[every],
                         ping=heard.ping[every], detection=None, depth=None)  # fmt: skip
    history = arrival_history(gone)
    assert len(history.encounters) == len(toa)
    np.testing.assert_array_equal(history.encounters.n_heard == 0, ~every)
    assert history.silence == "given"
    assert (history.links.n == 1).all()
    assert history.links.nominal == pytest.approx(25.0, abs=0.2)


class TestSequence:
    intervals = np.random.default_rng(3).uniform(20, 40, 12)

    def toa(self, start, keep):
        sent = 5.0 + np.concatenate([[0.0], np.cumsum(np.tile(np.roll(self.intervals, -start), 3))])
        sent = sent[keep]
        toa = times()
        arrival = sent[:, None] + np.random.default_rng(0).uniform(0.01, 0.05, (len(sent), 6))
        return maloc.ArrivalTimes(arrival, toa.receivers, np.full(len(sent), 1480.0))

    def test_phase_and_missed_pings_are_found(self):
        keep = np.array([0, 1, 4, 5, 6, 9, 15, 16, 30])
        history = arrival_history(self.toa(7, keep), sequence=self.intervals)
        assert len(history.encounters) == 31
        np.testing.assert_array_equal(np.flatnonzero(history.encounters.n_heard), keep)
        # the missed pings lie where the sequence puts them, on average over each gap
        assert history.links.nominal.sum() == pytest.approx(
            np.tile(np.roll(self.intervals, -7), 3)[:30].sum()
        )
        assert history.schedule == "sequence"

    def test_another_sequence_is_refused(self):
        with pytest.raises(maloc.errors.InputError, match="fit the sequence"):
            arrival_history(self.toa(7, np.arange(12)), sequence=self.intervals[::-1] + 1.0)

    def test_too_few_pings_to_tell_the_phase(self):
        with pytest.raises(maloc.errors.InputError, match="do not tell where"):
            arrival_history(self.toa(0, np.array([0])), sequence=self.intervals)


def test_laplace_takes_arrival_times_of_two_tags():
    """Two tags in one model; their parameters are common, their paths their own."""
    one, _, xy = cases.toa(pings=20, unheard=(), kind="unknown")
    fit = maloc.infer.laplace(joint, [one.replace(tag="a"), one.replace(tag="b")])
    assert fit.n_states == 40
    position = fit.moments()[0][:, :2]
    np.testing.assert_allclose(position[:20], position[20:], atol=0.2)
    np.testing.assert_allclose(position[:20], xy, atol=8.0)


def test_schedule_can_be_of_no_account():
    toa = times("random")
    trace = handlers.trace(handlers.seed(joint, 0)).get_trace(toa, detection=None, schedule=False)
    assert "schedule" not in trace
    assert isinstance(toa.schedule, Schedule)
