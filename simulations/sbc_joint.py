"""SBC of the joint model: ``python -m simulations.sbc_joint --fits 100``.

Ranks and their test, array and times are those of `simulations.sbc`; who hears a ping is drawn
from the model too. ``--silence given``: every ping is known to have been sent, heard or not.
``--silence unknown``: pings are known because they were heard, so encounter histories are drawn
until somebody hears. The detection range drifts, the sound speed is not sure; the schedule, whose
factor is no law to draw from, is left out. Priors are narrowed, in simulation and fit alike, so
that tags stay about the array: far out a ping heard by one receiver, or none, leaves rings and
lobes that no sampler mixes over.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator

import numpy as np
import numpyro.distributions as dist

import maloc.infer
from maloc._jax import jax, jnp
from maloc.data import ArrivalTimes, arrival_history
from maloc.model_data import to_model_data
from maloc.model_data.joint import JointData
from maloc.models import joint
from simulations import sbc

PARAMETERS = (
    "sigma", "sigma_vel", "t05", "w", "p0", "scale", "range_sd", "range_memory",
    "sound_speed_ratio",
)  # fmt: skip
PRIORS = sbc.PRIORS | {
    "sigma_vel": dist.LogNormal(np.log(0.12), 0.4),
    "p0": dist.Beta(20.0, 4.0),
    "scale": dist.LogNormal(np.log(120.0), 0.15),
    "range_sd": dist.LogNormal(np.log(0.15), 0.4),
    "range_memory": dist.LogNormal(np.log(300.0), 0.4),
}
OPTIONS = {"schedule": False, "sound_speed": "estimated"}
PINGS = (0, 7, 16, 23)


def design(silence: str) -> JointData:
    """The array and times of `simulations.sbc`; nothing heard yet."""
    base = sbc.design()
    xy = np.asarray(base.receiver_xy)
    from maloc.data import Receivers

    receivers = Receivers(np.array([f"R{i}" for i in range(len(xy))]), xy[:, 0], xy[:, 1])
    reference = np.asarray(base.time)[:, None] + np.zeros(len(xy))
    toa = ArrivalTimes(reference, receivers, sound_speed=np.asarray(1500.0))
    data = to_model_data(arrival_history(toa, known=silence == "given"), pad=False)
    near = {"centre": base.centre, "spread": 0.5 * base.spread, "phi": base.phi}
    return dataclasses.replace(data, **near)


def simulate(key, model, data: JointData) -> tuple[dict, JointData]:
    """Draw latent values from the prior, who hears each ping, and when."""
    key_latent, key_heard, key_arrival = jax.random.split(key, 3)
    how = {"observed": ("encounter", "arrival"), "options": tuple(OPTIONS.items())}
    truth, laws = sbc.prior_draw(key_latent, data, model=model, **how)
    truth = {name: np.asarray(value) for name, value in truth.items()}
    law = laws["encounter"].base_dist
    if data.silence == "given":
        heard = sbc.drawn(law, key_heard)
    else:
        heard = np.zeros(np.shape(data.heard), bool)
        for key_again in jax.random.split(key_heard, 10_000):
            again = ~heard.any(axis=1)
            if not again.any():
                break
            heard = np.where(again[:, None], np.asarray(sbc.drawn(law.law, key_again)), heard)
    arrivals = sbc.drawn(laws["arrival"], key_arrival)
    heard = jnp.asarray(heard)
    encounters = dataclasses.replace(data.encounters, heard=heard)
    ranges = jnp.where(heard, arrivals, 0.0)
    return truth, dataclasses.replace(data, heard=heard, range=ranges, encounters=encounters)


def quantities(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Scalars to rank: parameters, positions, an emission time, the range's drift."""
    out = {name: values[name] for name in PARAMETERS}
    for ping in PINGS:
        for axis, name in enumerate("xy"):
            out[f"{name}[{ping}]"] = values["position"][..., ping, axis]
    out[f"emission[{PINGS[1]}]"] = values["emission"][..., PINGS[1]]
    out[f"range[{PINGS[2]}]"] = values["range_drift"][..., PINGS[2]]
    return out


def cases(
    key, fits: int, silence: str, *, method: str = "nuts", chains: int = 2, draws: int = 1000
) -> Iterator[tuple[dict, dict, bool]]:
    """Truth and posterior of ``fits`` simulated data sets."""
    model = sbc.with_priors(joint, PRIORS)
    data = design(silence)
    for key_fit in jax.random.split(key, fits):
        key_data, key_chains = jax.random.split(key_fit)
        truth, seen = simulate(key_data, model, data)
        how = {"method": method, "chains": chains, "draws": draws, "progress": False}
        fit = maloc.infer.nuts(key_chains, model, seen, **how, **OPTIONS)
        every = {k: v.reshape(-1) for k, v in quantities(fit.draws()).items()}
        keep = sbc.spaced(len(every["sigma"]))
        yield quantities(truth), {k: v[keep] for k, v in every.items()}, bool(fit.warnings)


def main(argv: list[str] | None = None) -> int:
    """Print the rank histogram and p value of each quantity; exit 1 if one is .01 or less."""
    parser = argparse.ArgumentParser(prog="python -m simulations.sbc_joint", description=__doc__)
    parser.add_argument("--fits", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--silence", choices=("given", "unknown"), default="given")
    parser.add_argument("--method", choices=("nuts", "hmc"), default="nuts")
    parser.add_argument("--chains", type=int, default=2)
    parser.add_argument("--draws", type=int, default=500, help="draws of each chain")
    asked = parser.parse_args(argv)
    how = {"method": asked.method, "chains": asked.chains, "draws": asked.draws}
    found = cases(jax.random.key(asked.seed), asked.fits, asked.silence, **how)
    return sbc.print_ranks(sbc.calibrate(sbc.shown(found, asked.fits)))


if __name__ == "__main__":
    sys.exit(main())
