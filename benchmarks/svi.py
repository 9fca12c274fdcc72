"""Variational posterior and Laplace fit against NUTS: ``python -m benchmarks.svi``.

A simulated canal track, or (``--model known_interval`` and the like) a data set of the paper's
simulation study. Errors of posterior means in NUTS's posterior standard deviations, and ratios of
standard deviations, over states and for each parameter (on the unconstrained scale, where skewed
tails do not rule); CPU seconds include compilation.
"""

from __future__ import annotations

import benchmarks._threads  # noqa: F401  isort: skip

import argparse

import numpy as np

import maloc
from maloc._jax import jax
from maloc.infer._ascent import ascent
from maloc.infer._guide import laplace_frame
from maloc.simulate import canal_toa

MODELS = ("toa_track", "independent", "detection_only", "known_interval", "unknown_interval")


def start(name: str, size: int, seed: int):
    """Laplace fit of a simulated data set."""
    import maloc.models

    rng = np.random.default_rng(seed)
    if name == "toa_track":
        data, _ = canal_toa(rng, n_pings=size)
    else:
        from maloc.simulate.hostetter_royle import Design, simulate_study

        data = simulate_study(rng, Design(tags=size)).history(name)  # pyright: ignore[reportArgumentType]
    return maloc.infer.laplace(getattr(maloc.models, name), data)


def line(label: str, fit, wanted, bound: float | None = None) -> None:
    """Print how far a fit is from NUTS's draws."""
    n = fit.n_states
    x, u = (part[0] for part in fit.flat_draws(4000))
    theirs_x, theirs_u = (part.reshape(-1, *part.shape[2:]) for part in (wanted.x, wanted.u))
    rows = []
    for mine, theirs in ((x[:, :n], theirs_x[:, :n]), (u, theirs_u)):
        sd = theirs.std(axis=0)
        rows.append((np.abs(mine.mean(axis=0) - theirs.mean(axis=0)) / sd, mine.std(axis=0) / sd))
    (error, ratio), (error_u, ratio_u) = rows
    print(f"{label}" + ("" if bound is None else f", evidence bound {bound:.2f}"))
    print(f"  states      error of mean: median {np.median(error):.3f}, worst {error.max():.3f}")
    print(f"              ratio of sd: median {np.median(ratio):.3f}, ", end="")
    print(f"from {ratio.min():.3f} to {ratio.max():.3f}")
    for site in fit.cm.globals:
        for e, r in zip(error_u[site.place], ratio_u[site.place], strict=True):
            print(f"  {site.name:12}error of mean {e:.3f}, ratio of sd {r:.3f}")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", choices=MODELS, default="toa_track")
    parser.add_argument("--size", type=int, default=40, help="pings of the track, or tags (25)")
    parser.add_argument("--draws", type=int, default=1000, help="of each of NUTS's two chains")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--particles", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    laplace = start(given.model, given.size, given.seed)
    cpu = {"laplace": sum(s["cpu"] for s in laplace.seconds.values())}
    key = jax.random.key(given.seed)
    fit = maloc.infer.svi(
        key, laplace, steps=given.steps, particles=given.particles, progress=False
    )
    cpu["svi"] = fit.seconds["optimisation"]["cpu"]
    wanted = maloc.infer.nuts(key, laplace, draws=given.draws, progress=False)
    cpu["nuts"] = wanted.seconds["sampling"]["cpu"]
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in cpu.items())
    print(f"{given.model}: {laplace.n_states} states, {fit.cm.k} parameters; CPU s: {seconds}")
    for some in (fit, wanted):
        for warning in some.warnings:
            print(f"  {some.method}: {warning}")
    frame = laplace_frame(fit.cm, fit.args, laplace.marginal)
    white = jax.random.normal(key, (200, fit.cm.k + laplace.marginal.x.size))
    bound = np.asarray(ascent(fit.cm, given.particles).bounds(frame.start, white, fit.args))
    line("Laplace", laplace, wanted, float(bound.mean()))
    line("SVI", fit, wanted, fit.elbo)


if __name__ == "__main__":
    main()
