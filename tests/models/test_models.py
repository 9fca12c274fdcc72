"""Every model in the folder: its prior simulates, its density is finite, plain NumPyro runs it."""

import inspect
import itertools
from pathlib import Path

import numpy as np
import pytest
from numpyro import handlers
from numpyro.infer import MCMC, NUTS
from numpyro.infer.util import log_density
from scipy.special import expit
from scipy.stats import lognorm, norm, t

import maloc.infer
import maloc.models
from maloc._jax import jax, jnp
from maloc.data import Schedule
from maloc.detection import squared_distance
from maloc.model_data import to_model_data
from maloc.models import toa_track
from tests.infer import cases

SWITCHES = {n: (False, True) for n in ("loss", "receiver_effects", "dispersion")}
DETECTION = {"detection": ("halfnormal", "logistic", "hazard"), "distance": (squared_distance,)}
DETECTION |= SWITCHES
MOVING = DETECTION | {"movement": ("rw", "ctcrw"), "hierarchical": (False, True)}
OPTIONS = {
    "clock_sync": {
        "error": ("ddetect", "gaussian"),
        "sound_speed": ("auto", "given", "estimated"),
        "noise": ("estimated", "given"),
        "position_sd": (1.0, 0.0),
    },
    "independent": DETECTION,
    "detection_only": MOVING,
    "known_interval": MOVING,
    "unknown_interval": MOVING,
    "joint": DETECTION
    | {
        "movement": ("ctcrw", "rw"),
        "arrivals": ("ddetect", "gaussian", "student", None),
        "detection": (*DETECTION["detection"], None),
        "schedule": (True, False),
        "sound_speed": ("auto", "given", "estimated", "drifting"),
        "range_drift": (True, False),
    },
    "toa_track": {
        "movement": ("ctcrw", "rw", "ou"),
        "error": ("auto", "multipath", "gaussian", "student"),
        "sound_speed": ("auto", "given", "estimated"),
        "receivers": ("auto", "estimated"),
    },
    "yaps": {
        "error": ("mixture", "student", "gaussian"),
        "sound_speed": ("auto", "given", "walk"),
    },
}
SCHEDULES = {
    "unknown": Schedule(),
    "random": Schedule("random", 20.0, 30.0),
    "stable": Schedule("stable", 25.0, 0.02),
}


def every(options):
    names = list(options)
    return [
        dict(zip(names, values, strict=True)) for values in itertools.product(*options.values())
    ]


def data(schedule="unknown", sure=True):
    times, _, _ = cases.toa(pings=6, unheard=(), kind=schedule)
    if not sure:
        times = times.replace(sound_speed_sd=10.0)
    return times


def sites(trace, kind="sample"):
    return {n: s for n, s in trace.items() if s["type"] == kind and not s.get("is_observed")}


def test_the_folder_is_the_list():
    """A model a file, a function of the file's name, all of them exported and tested here."""
    folder = Path(inspect.getfile(maloc.models)).parent
    files = sorted(f.stem for f in folder.glob("*.py") if not f.stem.startswith("_"))
    assert files == sorted(maloc.models.__all__) == sorted(OPTIONS)
    for name in files:
        function = getattr(maloc.models, name)
        assert function.__name__ == name
        assert function.__doc__
        text = (folder / f"{name}.py").read_text()
        assert len(text.splitlines()) <= 110, f"{name} is more than a screen"
        # the options that its signature has, with the defaults among their choices
        signature = inspect.signature(function).parameters
        options = {n: p.default for n, p in signature.items() if p.kind == p.KEYWORD_ONLY}
        assert set(options) == set(OPTIONS[name])
        assert all(value in OPTIONS[name][n] for n, value in options.items())


def latin():
    """Options and schedules: every pair of choices; the other combinations in the long run."""
    for options in every(OPTIONS["toa_track"]):
        places = [OPTIONS["toa_track"][n].index(v) for n, v in options.items()]
        for i, schedule in enumerate(SCHEDULES):
            sums = sum(places), places[0] + 2 * places[1] + i
            marks = [pytest.mark.extended] if sums[0] % 3 or sums[1] % 3 else []
            name = "-".join([*options.values(), schedule])
            yield pytest.param(options, schedule, marks=marks, id=name)


@pytest.mark.parametrize(("options", "schedule"), list(latin()))
def test_every_combination_traces(options, schedule):
    """Abstractly: sites, shapes, and none of them a surprise."""
    times = data(schedule)

    def run(key):
        trace = handlers.trace(handlers.seed(toa_track, key)).get_trace(times, **options)
        return {n: s["value"] for n, s in sites(trace).items()}

    shapes = {n: v.shape for n, v in jax.eval_shape(run, jax.random.key(0)).items()}
    expected = {"emission": (6,), "sigma": ()}
    if options["movement"] == "ctcrw":
        expected |= {"track": (6, 2, 2), "sigma_vel": (), "t05": ()}
    elif options["movement"] == "ou":
        expected |= {"track": (6, 2), "home_sd": (), "home_t05": (), "home_offset": (2,)}
    else:
        expected |= {"track": (6, 2), "sigma_step": ()}
    if options["error"] == "auto":
        expected["w"] = ()
    if options["error"] == "multipath":
        expected |= {"w": (), "lateness": ()}
    if options["sound_speed"] == "estimated":
        expected["sound_speed_ratio"] = ()
    if options["receivers"] == "estimated":
        r = len(times.receivers)
        expected |= {"receiver_sd": (), "receiver_offset_sd": ()}
        expected |= {"receiver_shift": (r, 2), "receiver_offset": (r,)}
    if schedule == "stable":
        expected |= {"interval_offset": (), "interval_sd": ()}
    assert shapes == expected


@pytest.mark.parametrize("wrong", [{"movement": "walk"}, {"error": "t"}, {"sound_speed": "1500"}])
def test_unknown_options_are_refused(wrong):
    with pytest.raises(ValueError, match="is none of"):
        handlers.trace(handlers.seed(toa_track, 0)).get_trace(data("unknown"), **wrong)


def test_auto_sound_speed_follows_the_data():
    for sure in (True, False):
        trace = handlers.trace(handlers.seed(toa_track, 0)).get_trace(data(sure=sure))
        assert ("sound_speed_ratio" in trace) is not sure
    sd = float(trace["sound_speed_ratio"]["fn"].scale)
    assert sd == pytest.approx(10.0 / cases.SPEED)


@pytest.mark.parametrize(
    ("movement", "error", "schedule"),
    [
        ("ctcrw", "ddetect", "unknown"),
        pytest.param("ctcrw", "student", "random", marks=pytest.mark.extended),
        ("rw", "gaussian", "stable"),
    ],
)
class TestDensity:
    def test_prior_simulates(self, movement, error, schedule):
        """Fifty draws: all finite, inside their support, tracks around the array's middle."""
        times = data(schedule)

        def run(key):
            trace = handlers.trace(handlers.seed(toa_track, key)).get_trace(
                times, movement=movement, error=error
            )
            arrival = trace["arrival"]["fn"].sample(jax.random.fold_in(key, 1))
            values = {n: s["value"] for n, s in sites(trace).items()}
            inside = {n: s["fn"].support(s["value"]) for n, s in sites(trace).items()}
            return values, inside, arrival, sites(trace, "deterministic")["position"]["value"]

        values, inside, arrival, position = jax.jit(jax.vmap(run))(
            jax.random.split(jax.random.key(1), 50)
        )
        assert all(np.isfinite(v).all() for v in values.values())
        assert all(np.all(v) for v in inside.values())
        assert np.isfinite(arrival).all()
        assert arrival.shape == (50, 6, 6)
        assert position.shape == (50, 6, 2)
        # sd of the first position is the spread, 1 km: five standard errors of a mean of 50
        xy = np.column_stack([times.receivers.x, times.receivers.y]).mean(0)
        assert (np.abs(position[:, 0].mean(0) - xy) < 5 * 1000 / np.sqrt(50)).all()

    def test_density_and_gradient_are_finite(self, movement, error, schedule):
        """At prior draws, near the truth or not."""
        times = data(schedule)
        options = {"movement": movement, "error": error}

        @jax.jit
        def draw(key):
            trace = handlers.trace(handlers.seed(toa_track, key)).get_trace(times, **options)
            return {n: s["value"] for n, s in sites(trace).items()}

        def density(values):
            return log_density(toa_track, (times,), options, values)[0]

        both = jax.jit(jax.value_and_grad(density))
        for key in jax.random.split(jax.random.key(2), 10):
            value, slope = both(draw(key))
            assert np.isfinite(value)
            assert all(np.isfinite(s).all() for s in slope.values())


def test_plain_nuts_runs():
    """Ten steps of NumPyro's own sampler on the bare function, no engine."""
    sampler = MCMC(NUTS(toa_track, max_tree_depth=5), num_warmup=10, num_samples=10,
                   progress_bar=False)  # fmt: skip
    sampler.run(jax.random.key(3), data("stable"), movement="rw", error="gaussian")
    draws = sampler.get_samples()
    assert draws["position"].shape == (10, 6, 2)
    assert np.isfinite(draws["emission_time"]).all()
    assert len(np.unique(draws["sigma"])) > 1


def test_density_of_toa_track_by_hand():
    """Log joint of one configuration, term by term with SciPy."""
    times = data()
    model_data = to_model_data(times, pad=False)
    rng = np.random.default_rng(0)
    position = rng.normal(0, 20, (6, 2))
    emission = -60 + rng.normal(0, 1, 6)
    values = {
        "sigma_step": jnp.asarray(0.7),
        "sigma": jnp.asarray(1.3),
        "track": jnp.asarray(position),
        "emission": jnp.asarray(emission),
    }
    xy = np.column_stack([times.receivers.x, times.receivers.y])
    first = np.nanmin(times.toa, axis=1)
    heard = times.heard
    spread = max(1000.0, 2 * np.max(np.linalg.norm(xy[:, None] - xy, axis=-1)))
    total = lognorm.logpdf(0.7, 1.5) + lognorm.logpdf(1.3, 1.5, scale=2.0)
    total += norm.logpdf(position[0], xy[heard.any(0)].mean(0), spread).sum()
    scale = 0.7 * np.sqrt(np.diff(first))[:, None]
    total += norm.logpdf(np.diff(position, axis=0), 0, scale).sum()
    total += norm.logpdf(emission, 0, 10 * spread).sum()
    distance = np.sqrt(((position[:, None] - xy) ** 2).sum(-1) + 0.25)
    ranges = (times.toa - first[:, None]) * cases.SPEED
    residual = (ranges - emission[:, None] - distance)[heard]
    terms = {
        "gaussian": norm.logpdf(residual, 0, 1.3).sum(),
        "student": t.logpdf(residual, 3, 0, 1.3).sum(),
    }
    for error, term in terms.items():
        options = {"movement": "rw", "error": error}
        ours = log_density(toa_track, (model_data,), options, values)[0]
        np.testing.assert_allclose(ours, total + term, rtol=1e-9)


def test_schedule_terms():
    """Stable: normal around n intervals. Random: no cost inside the limits, dear outside."""
    times = data("stable")
    trace = handlers.trace(
        handlers.substitute(
            handlers.seed(toa_track, 0),
            data={
                "interval_offset": jnp.zeros(()),
                "interval_sd": jnp.asarray(0.02),
                "emission": jnp.full(6, -50.0),
            },
        )  # fmt: skip
    ).get_trace(times)
    gaps = np.diff(np.nanmin(times.toa, axis=1))
    wanted = norm.logpdf(gaps, 25.0, 0.02)
    factor = trace["schedule"]["fn"].log_factor
    np.testing.assert_allclose(factor, wanted, rtol=1e-6)

    random = data("random")

    def cost(emission):
        fixed = handlers.substitute(handlers.seed(toa_track, 0), data={"emission": emission})
        return handlers.trace(fixed).get_trace(random)["schedule"]["fn"].log_factor

    gaps = np.diff(np.nanmin(random.toa, axis=1))
    soft = [np.log(expit((gaps - 20) / 0.02)), np.log(expit((30 - gaps) / 0.02))]
    np.testing.assert_allclose(cost(jnp.full(6, -50.0)), sum(soft), rtol=1e-6, atol=1e-12)
    late = jnp.full(6, -50.0).at[3].add(15.0 * cases.SPEED)
    assert (cost(late)[2:4] < -50).any()
