"""The four detection models: densities by hand, tags pooled, options, plain NumPyro."""

import itertools

import numpy as np
import pytest
from numpyro import handlers
from numpyro.infer import MCMC, NUTS
from numpyro.infer.util import log_density
from scipy.stats import halfnorm, lognorm, norm

import maloc.models
from maloc._jax import jax, jnp
from maloc.data import EncounterHistory, Schedule
from maloc.detection import squared_distance
from maloc.model_data import to_model_data
from maloc.readers import read_receivers
from maloc.schedule.renewal import gap_log_likelihood

NAMES = ("independent", "detection_only", "known_interval", "unknown_interval")
P0, SCALE, SIGMA = 0.6, 0.9, 0.4


def array():
    x, y = (part.ravel() for part in np.meshgrid(np.arange(4.0), np.arange(3.0)))
    names = np.array([f"R{i}" for i in range(12)])
    nothing = np.full(12, np.nan)
    return read_receivers({"receiver": names, "x": x, "y": y, "depth": nothing})


def history(tags=2, unheard=(2,), **changes):
    """Two tags of six pings, intervals 1 to 2 s; row 2 of each heard by nobody."""
    rng = np.random.default_rng(3)
    heard = rng.random((6 * tags, 12)) < 0.25
    heard[:, 0] |= ~heard.any(axis=1)
    for row in unheard:
        heard[row::6] = False
    known = {
        "time": np.concatenate([np.cumsum(rng.uniform(1, 2, 6)) for _ in range(tags)]),
        "tag": np.repeat(np.arange(tags), 6),
        "tags": tuple(f"tag {i}" for i in range(tags)),
        "schedule": Schedule("random", 1.0, 2.0),
        "known": True,
    }
    return EncounterHistory(heard=heard, receivers=array(), **(known | changes))


def data_for(name, **changes):
    made = history(**changes)
    if name == "unknown_interval":
        made = made.detected()
    return to_model_data(made, pad=False)


def start_law(position, data):
    """Log density of first positions in the soft box, one axis after the other."""
    total = 0.0
    for axis in (0, 1):
        low, high = float(data.low[axis]), float(data.high[axis])
        edge = float(data.edge)
        inside = 1 / (1 + np.exp(-(position[..., axis] - low) / edge))
        inside = inside / (1 + np.exp(-(high - position[..., axis]) / edge))
        total += np.log(inside * (1 - np.exp(-(high - low) / edge)) / (high - low))
    return total


def heard_law(position, heard, p_lost=0.0):
    """Log probability of each ping's history, receiver by receiver."""
    out = np.zeros(len(position))
    xy = array().xy
    for s, place in enumerate(position):
        p = (1 - 1e-6) * P0 * np.exp(-((place - xy) ** 2).sum(1) / (2 * SCALE**2))
        product = np.prod(np.where(heard[s], p, 1 - p))
        out[s] = np.log((1 - p_lost) * product + (0 if heard[s].any() else p_lost))
    return out


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("loss", [False, True])
def test_density_by_hand(name, loss):
    """Every term with NumPy and SciPy, over two tags of which the second starts afresh."""
    data = data_for(name)
    s = len(data.time)
    position = np.random.default_rng(1).normal(1.5, 1.0, (s, 2))
    values = {"p0": P0, "scale": SCALE, "track": position}
    total = lognorm.logpdf(SCALE, 1.0, scale=float(data.spacing))
    p_lost = 0.0
    if loss:
        p_lost = values["p_lost"] = 0.2
        total += np.log(4 * (1 - 0.2) ** 3)
    tag = np.asarray(data.tag)
    if name == "independent":
        total += start_law(position, data).sum()
    else:
        values["sigma_step"] = SIGMA
        median = 0.2 * float(data.spacing) / np.sqrt(float(data.interval))
        total += lognorm.logpdf(SIGMA, 1.5, scale=median)
        for t in range(s):
            if t == 0 or tag[t] != tag[t - 1]:
                total += start_law(position[t], data)
            else:
                sd = SIGMA * np.sqrt(float(data.dt[t - 1]))
                total += norm.logpdf(position[t], position[t - 1], sd).sum()
    heard = np.asarray(data.heard)
    each = heard_law(position, heard, p_lost)
    if name in ("independent", "detection_only"):
        total += each[np.any(heard, axis=1)].sum()
    else:
        total += each[np.asarray(data.ping)].sum()
    if name == "unknown_interval":
        log_q = heard_law(position, np.zeros_like(heard), p_lost)
        total += float(gap_log_likelihood(data.gaps, jnp.asarray(log_q)).sum())
    values = {k: jnp.asarray(v) for k, v in values.items()}
    ours, _ = log_density(getattr(maloc.models, name), (data,), {"loss": loss}, values)
    np.testing.assert_allclose(ours, total, rtol=1e-8)


@pytest.mark.parametrize("name", NAMES[1:])
def test_unheard_pings_count_only_where_the_schedule_is_known(name):
    """A model that knows of row 2 dislikes it in the middle of the array."""
    data = data_for(name)
    model = getattr(maloc.models, name)

    def density(place):
        values = {"p0": jnp.asarray(0.9), "scale": jnp.asarray(SCALE)}
        values |= {"sigma_step": jnp.asarray(50.0)}
        at = jnp.full((len(data.time), 2), 1.0)
        silent = ~np.any(data.heard, axis=1)
        at = jnp.where(jnp.asarray(silent)[:, None], place, at)
        return float(log_density(model, (data,), {}, values | {"track": at})[0])

    inside, outside = density(1.0), density(4.5)
    if name == "detection_only":
        assert abs(inside - outside) < 0.1
    else:
        assert outside > inside + 1


@pytest.mark.parametrize("name", NAMES)
def test_options(name):
    """Every combination traces; sites as they should be; wrong names are refused."""
    model = getattr(maloc.models, name)
    data = data_for(name, covariates={"depth": np.tile(np.arange(12.0), (12, 1))})
    moving = name != "independent"
    choices = itertools.product(
        ("halfnormal", "logistic", "hazard"),
        ("rw", "ctcrw") if moving else (None,),
        (False, True),
    )
    for kind, movement, on in choices:
        options = {"detection": kind, "loss": on, "receiver_effects": on, "dispersion": on}
        if moving:
            options |= {"movement": movement, "hierarchical": on}

        def run(key, options=options):
            trace = handlers.trace(handlers.seed(model, key)).get_trace(data, **options)
            return {
                n: s["value"]
                for n, s in trace.items()
                if s["type"] == "sample" and not s["is_observed"]
            }

        shapes = {n: v.shape for n, v in jax.eval_shape(run, jax.random.key(0)).items()}
        s = len(data.time)
        wanted = {"p0": (), "scale": (), "coefficient": (1,)}
        wanted["track"] = (s, 2, 2) if movement == "ctcrw" else (s, 2)
        names = {"rw": ("sigma_step",), "ctcrw": ("sigma_vel", "t05"), None: ()}[movement]
        wanted |= dict.fromkeys(names, ())
        if kind == "hazard":
            wanted["shape"] = ()
        if on:
            wanted |= {"p_lost": (), "dispersion": (), "receiver_sd": (), "receiver_effect": (12,)}
            wanted |= {f"{n}_between": () for n in names} | {f"{n}_tag": (2,) for n in names}
        assert shapes == wanted
    with pytest.raises(ValueError, match="is none of"):
        handlers.trace(handlers.seed(model, 0)).get_trace(data, detection="cone")


def test_a_schedule_is_needed():
    bare = to_model_data(history().without_schedule(), pad=False)
    with pytest.raises(ValueError, match="burst interval"):
        handlers.trace(handlers.seed(maloc.models.unknown_interval, 0)).get_trace(bare)


@pytest.mark.parametrize("name", NAMES)
def test_padding_changes_nothing(name):
    """Up to what padding itself is worth, which does not depend on the rest."""
    made = history() if name != "unknown_interval" else history().detected()
    bare, padded = to_model_data(made, pad=False), to_model_data(made)
    more = len(padded.time) - len(bare.time)
    assert more > 0
    model = getattr(maloc.models, name)

    def density(data, path):
        values = {"p0": jnp.asarray(P0), "scale": jnp.asarray(SCALE), "track": path}
        if name != "independent":
            values["sigma_step"] = jnp.asarray(SIGMA)
        return float(log_density(model, (data,), {}, values)[0])

    rng = np.random.default_rng(0)
    paths = jnp.asarray(rng.normal(1.5, 1.0, (3, len(bare.time), 2)))
    tail = jnp.full((more, 2), 1.0)
    less = [density(bare, p) for p in paths]
    both = [density(padded, jnp.concatenate([p, tail])) for p in paths]
    np.testing.assert_allclose(np.diff(both), np.diff(less), rtol=1e-9)


@pytest.mark.extended
def test_plain_nuts_runs():
    name = "unknown_interval"
    sampler = MCMC(
        NUTS(getattr(maloc.models, name), max_tree_depth=4),
        num_warmup=5, num_samples=5, progress_bar=False,
    )  # fmt: skip
    sampler.run(jax.random.key(3), data_for(name))
    draws = sampler.get_samples()
    assert np.isfinite(draws["position"]).all()
    assert ((draws["p0"] > 0) & (draws["p0"] < 1)).all()


def twice_as_far(position, near_xy):
    return 4 * squared_distance(position, near_xy)


@pytest.mark.parametrize("name", NAMES)
def test_effective_distance(name):
    """Twice the distance is half the scale; the engine takes the hook as any option."""
    data = data_for(name)
    values = {"p0": jnp.asarray(P0), "track": jnp.ones((len(data.time), 2))}
    values |= {} if name == "independent" else {"sigma_step": jnp.asarray(SIGMA)}
    model = getattr(maloc.models, name)

    def density(scale, prior, **options):
        at = values | {"scale": jnp.asarray(scale)}
        log_prior = lognorm.logpdf(prior, 1.0, scale=float(data.spacing))
        return float(log_density(model, (data,), options, at)[0]) - log_prior

    far = density(2 * SCALE, 2 * SCALE, distance=twice_as_far)
    np.testing.assert_allclose(far, density(SCALE, SCALE), rtol=1e-9)


def test_tags_of_their_own_pace():
    """Hierarchical: each tag's steps have its own sd."""
    data = data_for("known_interval")
    values = {
        "p0": P0, "scale": SCALE, "sigma_step": SIGMA, "sigma_step_between": 0.5,
        "sigma_step_tag": np.array([-1.0, 2.0]), "track": np.ones((12, 2)),
    }  # fmt: skip
    values = {k: jnp.asarray(v) for k, v in values.items()}
    model = maloc.models.known_interval
    mine = log_density(model, (data,), {"hierarchical": True}, values)[0]
    common = {k: v for k, v in values.items() if "_step_" not in k}
    theirs = log_density(model, (data,), {}, common)[0]
    # standing still: each of the 5 steps of a tag is dearer by 2 log(sd ratio)
    wanted = -2 * 5 * 0.5 * (-1.0 + 2.0) + halfnorm.logpdf(0.5, scale=0.5)
    wanted += norm.logpdf([-1.0, 2.0]).sum()
    np.testing.assert_allclose(mine - theirs, wanted, rtol=1e-9)
