"""maloc's sampler against plain NumPyro NUTS on the same model: ``python -m benchmarks.engine``.

One simulated canal track. Effective draws of positions (median) and of the worst parameter are
counted per CPU second after compilation. Plain NUTS is favoured: it starts from the Laplace mode,
which it would not have by itself, and only its sampling is timed, not its warm-up.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse
import time

import numpy as np
from numpyro.infer import MCMC, NUTS, init_to_value

import maloc
from maloc._jax import jax
from maloc.infer._diagnostics import ess_bulk
from maloc.simulate import canal_toa


def _speed(places: np.ndarray, parameters: np.ndarray, seconds: float) -> tuple[float, float]:
    """Effective draws a second: median position, worst parameter."""
    return float(np.median(ess_bulk(places))) / seconds, float(ess_bulk(parameters).min()) / seconds


def ours(start, method: str, draws: int) -> tuple[float, float]:
    """Whitened sampler of maloc."""
    for n in (50, draws):  # the first run compiles
        start.seconds.pop("sampling", None)
        key = jax.random.key(1)
        fit = maloc.infer.nuts(key, start, method=method, draws=n, progress=False)
    places = fit.x[:, :, : fit.n_states, :2]
    return _speed(places, fit.u, fit.seconds["sampling"]["cpu"])


def plain(start, draws: int, warmup: int) -> tuple[float, float]:
    """NumPyro's NUTS on the bare model, mass matrix adapted, two chains one after the other."""
    values = {k: v[0].mean(axis=0) for k, v in start.draws().items()}
    data = start.args[0]
    for name in ("track", "emission"):  # with the padding's states
        site = next(s for s in start.cm.chain if s.name == name)
        shape = (len(data.time), *site.tail)
        values[name] = start.marginal.x[:, site.columns].reshape(shape)
    kernel = NUTS(maloc.models.toa_track, init_strategy=init_to_value(values=values))
    run = MCMC(
        kernel, num_warmup=warmup, num_samples=draws, num_chains=2, progress_bar=False,
        chain_method="sequential",
    )  # fmt: skip
    run.warmup(jax.random.key(2), data)
    run.run(jax.random.key(2), data)  # compiles
    begin = time.process_time()
    run.run(jax.random.key(2), data)
    seconds = time.process_time() - begin
    samples = run.get_samples(group_by_chain=True)
    scalars = [np.asarray(v) for k, v in samples.items() if np.ndim(v) == 2]
    places = np.asarray(samples["position"])[:, :, : start.n_states]
    return _speed(places, np.stack(scalars, axis=-1), seconds)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=48)
    parser.add_argument("--draws", type=int, default=200, help="plain; ours: 5 x")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    toa, _ = canal_toa(np.random.default_rng(given.seed), n_pings=given.pings)
    start = maloc.infer.laplace(maloc.models.toa_track, toa)
    base = plain(start, given.draws, given.draws)
    print(f"{given.pings} pings, effective draws a CPU second: position (median), worst parameter")
    print(f"{'NumPyro NUTS, bare model':28}{base[0]:>10.3f}{base[1]:>10.3f}")
    for method in ("nuts", "hmc"):
        mine = ours(start, method, 5 * given.draws)
        line = f"{'maloc ' + method:28}{mine[0]:>10.1f}{mine[1]:>10.1f}"
        print(line + f"   {mine[0] / base[0]:>8.0f}x{mine[1] / base[1]:>8.0f}x")


if __name__ == "__main__":
    main()
