"""SBC of the detection models: ``python -m simulations.sbc_detections known_interval``.

Ranks and their test are those of `simulations.sbc`.
Sixteen receivers a unit apart, two tags. Priors are narrowed, in simulation and fit alike:

- ``independent`` and ``detection_only`` leave pings out that nobody heard, without conditioning on
  having been heard, so they are calibrated only where every ping is heard. `CERTAIN` sees to that
  (receivers that hear well, tags that stay among them); pings that were left out all the same are
  counted and printed.
- ``known_interval``: 12 pings a tag at given times, heard or not.
- ``unknown_interval``: tags are on from 0 to 20 s and ping at intervals of Uniform(1, 2) s, the
  first within a second; heard pings are kept, all else is unknown. A tag that nobody heard is no
  data: where it happens, the whole data set is drawn again from new parameters, which would bend
  the ranks if it were not rare; it is counted and printed. The number of missed pings is ranked
  too, its ties broken at random.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import numpy as np
import numpyro.distributions as dist

import maloc.infer
import maloc.models
from maloc._jax import jax
from maloc.data import EncounterHistory, Receivers, Schedule
from maloc.model_data import to_model_data
from simulations import sbc

MODELS = ("independent", "detection_only", "known_interval", "unknown_interval")
PARAMETERS = ("p0", "scale", "sigma_step")
PRIORS = {
    "p0": dist.Beta(6.0, 4.0),
    "scale": dist.LogNormal(np.log(0.75), 0.25),
    "sigma_step": dist.LogNormal(np.log(0.3), 0.4),
}
CERTAIN = {
    "p0": dist.Beta(30.0, 5.0),
    "scale": dist.LogNormal(np.log(2.0), 0.15),
    "sigma_step": dist.LogNormal(np.log(0.12), 0.3),
}
PINGS, LAST = 12, 20.0  # pings a tag; s
INTERVAL = (1.0, 2.0)
EDGE = 0.2


def receivers() -> Receivers:
    """Four by four, a unit apart."""
    x, y = np.meshgrid(*[np.arange(4.0)] * 2)
    return Receivers(np.array([f"R{i:02d}" for i in range(16)]), x.ravel(), y.ravel())


def priors(model: str) -> dict:
    """Narrowed priors of a model."""
    return CERTAIN if model in ("independent", "detection_only") else PRIORS


def box(model: str) -> tuple[np.ndarray, np.ndarray]:
    """State space: around the middle where every ping is to be heard, else wider than the array."""
    inside = 1.0 if model in ("independent", "detection_only") else -0.5
    return np.full(2, inside), np.full(2, 3.0 - inside)


def given_pings(model: str) -> EncounterHistory:
    """The design where times are given: two tags, every ping a row; nothing heard yet."""
    step = np.random.default_rng(5).uniform(*INTERVAL, (2, PINGS))
    low, high = box(model)
    return EncounterHistory(
        time=np.cumsum(step, axis=1).ravel(),
        tag=np.repeat([0, 1], PINGS),
        heard=np.zeros((2 * PINGS, 16), bool),
        receivers=receivers(),
        tags=("one", "two"),
        schedule=Schedule("random", *INTERVAL),
        known=True,
        low=low,
        high=high,
        edge=EDGE,
    )


def draw_given(key, name: str, model) -> tuple[dict, EncounterHistory, int]:
    """Truth, data, and how many pings nobody heard; from the model's own joint density."""
    design = given_pings(name)
    truth, heard = sbc.draw_truth(key, model, to_model_data(design, pad=False), "encounter")
    history = design.replace(heard=np.asarray(heard))
    return truth, history, int((history.n_heard == 0).sum())


def draw_unknown(rng: np.random.Generator) -> tuple[dict, EncounterHistory, int]:
    """Truth, heard pings, and how many data sets were drawn in vain; tags as they really are."""
    for vain in range(1000):
        key = jax.random.key(int(rng.integers(2**31)))
        value = {
            name: float(prior.sample(k))
            for (name, prior), k in zip(PRIORS.items(), jax.random.split(key, 3), strict=True)
        }
        low, high = box("unknown_interval")
        tags = [_ping(rng, value, low, high) for _ in range(2)]
        if all(heard.any() for _, _, heard in tags):
            return *_heard_alone(value, tags), vain
    raise RuntimeError("no data set in 1000 had both tags heard")


def _heard_alone(value: dict, tags: list) -> tuple[dict, EncounterHistory]:
    """Truth and data of all pings (times, places, hearers) of the tags: the heard ones."""
    low, high = box("unknown_interval")
    kept = [heard.sum(axis=1) > 0 for _, _, heard in tags]
    history = EncounterHistory(
        time=np.concatenate([t[k] for (t, _, _), k in zip(tags, kept, strict=True)]),
        tag=np.repeat([0, 1], [int(k.sum()) for k in kept]),
        heard=np.concatenate([h[k] for (_, _, h), k in zip(tags, kept, strict=True)]),
        receivers=receivers(),
        tags=("one", "two"),
        schedule=Schedule("random", *INTERVAL),
        start=np.zeros(2),
        end=np.full(2, LAST),
        first_at_start=True,
        low=low,
        high=high,
        edge=EDGE,
        lead=LAST,
    )
    position = np.concatenate([x[k] for (_, x, _), k in zip(tags, kept, strict=True)])
    missed = sum(int((~k).sum()) for k in kept)
    return value | {"position": position, "missed": missed}, history


def _ping(rng, value: dict, low, high) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, places and hearers of all pings of one tag."""
    step = rng.uniform(*INTERVAL, int(LAST / INTERVAL[0]) + 2)
    step[0] = rng.uniform(0, INTERVAL[1] / 2)
    time = np.cumsum(step)
    n = int((time <= LAST).sum())
    start = rng.uniform(low, high) + EDGE * rng.logistic(size=2)
    noise = rng.standard_normal((n, 2)) * np.sqrt(step[:n, None])
    place = start + value["sigma_step"] * np.cumsum(noise, axis=0)
    squared = ((place[:, None] - receivers().xy) ** 2).sum(axis=2)
    p = value["p0"] * np.exp(-squared / (2 * value["scale"] ** 2))
    return time[:n], place, rng.random(p.shape) < p


def quantities(values: dict[str, np.ndarray], rows: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Scalars to rank, of one draw or of arrays of draws; ``rows`` of positions (..., P, 2)."""
    out = {name: values[name] for name in PARAMETERS if name in values}
    for where, row in zip(("first", "middle", "last"), rows, strict=True):
        for axis, name in enumerate("xy"):
            out[f"{name} {where}"] = values["position"][..., row, axis]
    return out


def posterior(fit, rng: np.random.Generator, count: bool) -> dict[str, np.ndarray]:
    """Draws (99, ...) of parameters, positions at the rows of the history, and missed pings."""
    flat = {k: v.reshape(-1, *v.shape[2:]) for k, v in fit.draws().items()}
    keep = sbc.spaced(len(flat["position"]))
    out = {name: flat[name][keep] for name in (*PARAMETERS, "position") if name in flat}
    if count:
        from maloc import renewal

        gaps = fit.args[0].gaps
        each = [renewal.draw_missed(rng, gaps, q) for q in flat["log_q"][keep]]
        out["missed"] = np.array([sum(map(len, times)) for times in each])
    rows = np.flatnonzero(np.asarray(fit.args[0].ping)[: fit.n_states])
    out["position"] = out["position"][:, rows]
    return out


def detection_cases(
    seed: int,
    name: str,
    fits: int,
    *,
    method: str = "nuts",
    draws: int = 500,
    fit_as: str | None = None,
    odd: list[int] | None = None,
) -> Iterator[tuple[dict, dict, bool]]:
    """Truth and posterior of ``fits`` simulated data sets.

    ``fit_as`` names another model to fit: a planted error. ``odd`` gathers, a fit, the number of
    unheard pings (given times) or of data sets drawn in vain (unknown interval).
    """
    model = sbc.with_priors(getattr(maloc.models, name), priors(name))
    other = fit_as or name
    fitted = sbc.with_priors(getattr(maloc.models, other), priors(name))
    for i in range(fits):
        rng = np.random.default_rng([seed, i])
        key_data, key_chains = jax.random.split(jax.random.fold_in(jax.random.key(seed), i))
        if name == "unknown_interval":
            truth, history, strange = draw_unknown(rng)
        else:
            truth, history, strange = draw_given(key_data, name, model)
        if odd is not None:
            odd.append(strange)
        fit = maloc.infer.nuts(
            key_chains, fitted, history, draws=draws, method=method, progress=False
        )
        middle = history.first_rows[1] // 2
        rows = (0, int(middle), len(history) - 1)
        drawn = posterior(fit, rng, "missed" in truth and other == name)
        true = quantities(truth, rows)
        ranked = quantities(drawn, rows)
        if "missed" in drawn:  # whole numbers: ties are broken at random
            true["missed"] = truth["missed"] + rng.random()
            ranked["missed"] = drawn["missed"] + rng.random(sbc.DRAWS)
        yield {k: np.asarray(true[k]) for k in ranked}, ranked, bool(fit.warnings)


def main(argv: list[str] | None = None) -> int:
    """Print the rank histogram and p value of each quantity; exit 1 if one is .01 or less."""
    parser = argparse.ArgumentParser(prog="python -m simulations.sbc_detections")
    parser.add_argument("model", choices=MODELS)
    parser.add_argument("--fits", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", choices=("nuts", "hmc"), default="nuts")
    parser.add_argument("--draws", type=int, default=500, help="draws of each of two chains")
    parser.add_argument("--fit", choices=MODELS, help="plant an error: fit another model")
    asked = parser.parse_args(argv)
    odd: list[int] = []
    cases = detection_cases(
        asked.seed,
        asked.model,
        asked.fits,
        method=asked.method,
        draws=asked.draws,
        fit_as=asked.fit,
        odd=odd,
    )
    bad = sbc.print_ranks(sbc.calibrate(sbc.shown(cases, asked.fits)))
    if asked.model == "unknown_interval":
        print(f"{sum(odd)} data sets more had a tag that nobody heard, and were drawn again")
    else:
        print(f"{sum(odd)} of {2 * PINGS * asked.fits} pings were heard by nobody")
    return bad


if __name__ == "__main__":
    sys.exit(main())
