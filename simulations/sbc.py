"""Simulation-based calibration of `toa_track`: ``python -m simulations.sbc --fits 100 --seed 0``.

Parameters and data are drawn from the model itself, the model is fitted, and the rank of each true
value among the posterior draws is noted. If the whole chain of density, engine and sampler is
right, the ranks are uniform (Talts, Betancourt, Simpson, Vehtari & Gelman 2018, arXiv:1804.06788;
Cook, Gelman & Rubin 2006). Fits that went badly are counted and keep their ranks: leaving them out
would break the identity.

The design is fixed: 8 receivers, 24 pings, 30 s apart. Arrivals are ranges from a reference time
that the design gives, not from each ping's first arrival, so that they are distributed exactly as
the model says. The model's own priors reach from a fish that is nailed down to one that crosses
the array between two pings, and to errors as wide as the array, where 24 pings say next to nothing
and no sampler is at its ease; `PRIORS` narrows them, in simulation and fit alike.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import numpyro.distributions as dist
from numpyro import handlers
from scipy.stats import chi2

import maloc.infer
from maloc._jax import jax, jnp
from maloc.data import ArrivalTimes
from maloc.infer.result import SampledFit
from maloc.model_data import to_model_data
from maloc.model_data.toa import ToaData
from maloc.models import toa_track
from maloc.readers import read_receivers

DRAWS = 99  # thinned draws a fit: ranks 0..99 fall into 10 bins of 10
BINS = 10
PINGS = (0, 7, 12, 23)
PRIORS = {
    "sigma": dist.LogNormal(np.log(2.0), 0.5),
    "sigma_vel": dist.LogNormal(np.log(0.3), 0.5),
    "t05": dist.LogNormal(np.log(260.0), 0.75),
    "sigma_step": dist.LogNormal(0.0, 0.5),
}


class Calibration(NamedTuple):
    """Ranks (fits,) by quantity, 0..draws, and how many fits said that something went wrong."""

    ranks: dict[str, np.ndarray]
    draws: int
    warned: int

    def p_values(self) -> dict[str, float]:
        """Chi-square p of uniform ranks, by quantity."""
        return {name: uniform_p(ranks, self.draws) for name, ranks in self.ranks.items()}


def uniform_p(ranks: np.ndarray, draws: int = DRAWS, bins: int = BINS) -> float:
    """P value of the chi-square test that ranks among ``draws`` draws are uniform on 0..draws."""
    if (draws + 1) % bins:
        raise ValueError(f"{draws} draws give {draws + 1} ranks, which {bins} bins do not divide")
    count = np.bincount(np.asarray(ranks) * bins // (draws + 1), minlength=bins)
    expected = len(ranks) / bins
    return float(chi2.sf(np.sum((count - expected) ** 2) / expected, bins - 1))


class _Priors(handlers.substitute):
    """Swap the distributions of latent sites by name."""

    def __init__(self, fn: Callable, priors: dict[str, Any]) -> None:
        super().__init__(fn, data={})
        self.priors = priors

    def process_message(self, msg: dict) -> None:
        """Put the site's new distribution in."""
        if msg["type"] == "sample" and msg["name"] in self.priors:
            msg["fn"] = self.priors[msg["name"]]


def with_priors(model: Callable, priors: dict[str, Any]) -> Callable:
    """The model with other prior distributions for some parameters."""
    swapped = _Priors(model, priors)

    def narrowed(*args, **options):
        return swapped(*args, **options)

    narrowed.__name__ = getattr(model, "__name__", "model")
    return narrowed


def design(pings: int = 24, step: float = 30.0, spread: float = 100.0) -> ToaData:
    """Eight receivers around a reach of river; every ping is heard by all of them."""
    x, y = np.meshgrid([-105.0, -38.0, 31.0, 110.0], [-62.0, 55.0])
    xy = np.column_stack([x.ravel(), y.ravel()]) + 7 * np.sin(np.arange(16.0)).reshape(8, 2)
    receivers = read_receivers(
        {"receiver": [f"R{i}" for i in range(8)], "x": xy[:, 0], "y": xy[:, 1]}
    )
    reference = np.broadcast_to(step * np.arange(pings)[:, None], (pings, 8))
    data = to_model_data(ArrivalTimes(reference, receivers, sound_speed=np.asarray(1500.0)), False)
    near = {"centre": jnp.zeros(2), "spread": jnp.asarray(spread), "phi": jnp.asarray(150.0)}
    return dataclasses.replace(data, **near)


@functools.partial(jax.jit, static_argnames=("model", "observed", "options"))
def prior_draw(key, data, *, model: Callable, observed: tuple[str, ...], options: tuple = ()):
    """Latent values from the model's prior, and the laws of the ``observed`` sites given them."""
    trace = handlers.trace(handlers.seed(model, key)).get_trace(data, **dict(options))
    truth = {
        name: site["value"]
        for name, site in trace.items()
        if site["type"] == "deterministic" or (site["type"] == "sample" and not site["is_observed"])
    }
    return truth, {name: trace[name]["fn"] for name in observed}


def draw_truth(key, model: Callable, data, site: str, **options) -> tuple[dict, np.ndarray]:
    """Latent values from the model's prior, and a draw of the observed ``site`` from its law."""
    key_latent, key_site = jax.random.split(key)
    some = tuple(options.items())
    truth, laws = prior_draw(key_latent, data, model=model, observed=(site,), options=some)
    return {k: np.asarray(v) for k, v in truth.items()}, drawn(laws[site], key_site)


@jax.jit
def drawn(law, key):
    """A draw of a law."""
    return law.sample(key)


def simulate(key, model: Callable, data: ToaData, **options) -> tuple[dict, ToaData]:
    """Draw latent values from the model's prior, then arrivals from its law: truth, data."""
    truth, arrivals = draw_truth(key, model, data, "arrival", **options)
    return truth, dataclasses.replace(data, range=arrivals)


def quantities(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Scalars to rank, from one draw's values or from arrays of draws: name -> (...)."""
    out = {k: v for k, v in values.items() if k in ("sigma", "sigma_vel", "sigma_step", "t05", "w")}
    for ping in PINGS:
        for axis, name in enumerate("xy"):
            out[f"{name}[{ping}]"] = values["position"][..., ping, axis]
    out[f"emission[{PINGS[1]}]"] = values["emission"][..., PINGS[1]]
    return out


def thinned(fit: SampledFit, draws: int = DRAWS) -> dict[str, np.ndarray]:
    """Quantities at ``draws`` evenly spaced draws of a fit's chains, laid end to end."""
    every = {name: value.reshape(-1) for name, value in quantities(fit.draws()).items()}
    keep = spaced(len(next(iter(every.values()))), draws)
    return {name: value[keep] for name, value in every.items()}


def spaced(total: int, draws: int = DRAWS) -> np.ndarray:
    """Indices (draws,) spread evenly over ``total`` draws."""
    return ((np.arange(draws) + 0.5) * total / draws).astype(int)


def calibrate(cases: Iterator[tuple[dict, dict, bool]], draws: int = DRAWS) -> Calibration:
    """Rank true values among posterior draws.

    Parameters
    ----------
    cases : iterator of (truth, posterior, warned)
        By quantity: the true value, and its posterior draws (draws,); whether the fit warned.
    draws : int
        Draws in each posterior.
    """
    ranks: dict[str, list[int]] = {}
    warned = 0
    for truth, posterior, bad in cases:
        warned += bad
        for name, value in truth.items():
            assert posterior[name].shape == (draws,)
            ranks.setdefault(name, []).append(int(np.sum(posterior[name] < value)))
    return Calibration({name: np.array(r) for name, r in ranks.items()}, draws, warned)


def toa_track_cases(
    key, fits: int, *, method: str = "nuts", draws: int = 1000, bias: float = 1.0, **options
) -> Iterator[tuple[dict, dict, bool]]:
    """Truth and posterior of ``fits`` simulated data sets.

    ``bias`` other than 1 stretches every arrival before the fit: a planted error.
    """
    model = with_priors(toa_track, PRIORS)
    data = design()
    for key_fit in jax.random.split(key, fits):
        key_data, key_chains = jax.random.split(key_fit)
        truth, heard = simulate(key_data, model, data, **options)
        heard = dataclasses.replace(heard, range=heard.range * bias)
        fit = maloc.infer.nuts(
            key_chains, model, heard, draws=draws, method=method, progress=False, **options
        )
        yield quantities(truth), thinned(fit), bool(fit.warnings)


def shown(cases: Iterator, fits: int) -> Iterator:
    """Pass cases on with a line of progress on stderr."""
    start = time.perf_counter()
    for i, case in enumerate(cases, 1):
        print(f"\rfit {i}/{fits}, {time.perf_counter() - start:.0f} s", end="", file=sys.stderr)
        yield case
    print(file=sys.stderr)


def print_ranks(result: Calibration) -> int:
    """Print the rank histogram and p value of each quantity; 1 if one is .01 or less, else 0."""
    p_values = result.p_values()
    print(f"{'quantity':14}{'p':>8}  fits in each tenth of the ranks")
    for name, p in p_values.items():
        count = np.bincount(result.ranks[name] * BINS // (result.draws + 1), minlength=BINS)
        print(f"{name:14}{p:8.3f}  {' '.join(f'{c:3d}' for c in count)}")
    fits = len(next(iter(result.ranks.values())))
    print(f"{fits} fits, {result.warned} of them with a warning; smallest p", end=" ")
    print(f"{min(p_values.values()):.4f} of {len(p_values)}")
    return int(min(p_values.values()) <= 0.01)


def main(argv: list[str] | None = None) -> int:
    """Print the rank histogram and p value of each quantity; exit 1 if one is .01 or less."""
    parser = argparse.ArgumentParser(prog="python -m simulations.sbc", description=__doc__)
    parser.add_argument("--fits", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", choices=("nuts", "hmc"), default="nuts")
    parser.add_argument("--draws", type=int, default=1000, help="draws of each of two chains")
    parser.add_argument("--movement", choices=("ctcrw", "rw"), default="ctcrw")
    parser.add_argument("--error", choices=("ddetect", "gaussian", "student"), default="ddetect")
    parser.add_argument("--bias", type=float, default=1.0, help="plant an error: stretch arrivals")
    asked = parser.parse_args(argv)
    cases = toa_track_cases(
        jax.random.key(asked.seed),
        asked.fits,
        method=asked.method,
        draws=asked.draws,
        bias=asked.bias,
        movement=asked.movement,
        error=asked.error,
    )
    return print_ranks(calibrate(shown(cases, asked.fits)))


if __name__ == "__main__":
    sys.exit(main())
