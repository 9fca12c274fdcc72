"""Exact sampling: NUTS or jittered HMC in the coordinates that the Laplace fit whitens.

The Laplace fit only chooses coordinates; the target is the model's own posterior. Chains are
looked after: one that diverges, hangs or sits in another place than the rest is run again from a
new start, and what cannot be mended is said in ``warnings``.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from maloc._jax import jax
from maloc.errors import FitError
from maloc.infer._diagnostics import ess_bulk, r_hat
from maloc.infer._hmc import CHUNK, Chunk, Kernel, kernels
from maloc.infer._map import make_map
from maloc.infer.laplace import laplace
from maloc.infer.result import Fit, LaplaceFit, SampledFit

__all__ = ["nuts"]

_FEW = 500  # coordinates: about 100 pings
_RETRIES = 2
_SHRINK = 0.6  # of the step size at each retry: what diverged may pass with shorter steps


def nuts(
    key,
    model: Callable | Fit,
    *args,
    chains: int = 2,
    draws: int = 1000,
    warmup: int = 200,
    method: str = "nuts",
    target_accept: float | None = None,
    side_by_side: bool | None = None,
    progress: bool = True,
    path: tuple[str, ...] | None = None,
    positions: np.ndarray | str | None = None,
    **options,
) -> SampledFit:
    """Sample a chain-structured NumPyro model.

    Parameters
    ----------
    key : jax.Array
        Random key (``jax.random.key(seed)``).
    model : callable, LaplaceFit or SviFit
        Model, as for `laplace`, or a fit of it, whose map is then used (no ``args``).
    *args
        The model's arguments.
    chains, draws, warmup : int
        Chains (two or more), draws kept of each, and draws for step size adaptation before them;
        draws are taken in chunks of 50.
    method : {"nuts", "hmc"}
        NumPyro's NUTS, or HMC of jittered length on the same map (faster where the posterior is
        nearly Gaussian).
    target_accept : float, optional
        Target acceptance probability. By default .7 for NUTS and .8 for HMC, which gave the most
        effective draws a gradient on real tracks; .9 below 500 coordinates, where steps adapt so
        long that the tails diverge, and short ones cost nothing.
    side_by_side : bool, optional
        HMC's chains advance together in one batch. By default where JAX computes on an
        accelerator: there dozens of chains cost little more time than one.
    progress : bool
        Show a progress bar on stderr.
    path, positions, **options
        As for `laplace`.

    Returns
    -------
    SampledFit
        Interrupted by the keyboard, the draws so far, with a warning.

    Raises
    ------
    FitError
        If fewer than two chains could be brought to work.

    References
    ----------
    Hoffman & Gelman (2014) J. Mach. Learn. Res. 15: 1593-1623; Neal (2011) MCMC using Hamiltonian
    dynamics.
    """
    if callable(key) or isinstance(key, Fit):
        raise TypeError("nuts(key, model, data, ...) takes the random key first: jax.random.key(1)")
    if chains < 2:
        raise ValueError("chains must be 2 or more: one chain cannot show that it has converged")
    if method not in ("nuts", "hmc"):
        raise ValueError(f"method must be 'nuts' or 'hmc', not {method!r}")
    if isinstance(model, Fit):
        start = model
    else:
        start = laplace(model, *args, path=path, positions=positions, **options)
    cm, data, stages = start.cm, start.args, start.seconds
    with stages.time("map"):
        if isinstance(start, LaplaceFit):
            mapping = make_map(cm, data, start.marginal)
        else:
            mapping = start.mapping()
    chunks = -(-draws // CHUNK)
    warm = -(-warmup // CHUNK)
    accept = target_accept or _default_accept(method, mapping.x.size + cm.k)
    kernel = kernels(cm, method, warm * CHUNK, accept)
    bar = _bar(chains * (warm + chunks) * CHUNK, progress, method)
    runs: list[list[Chunk]] = []
    sizes: list[float] = []
    spent: list[float] = []
    warnings: list[str] = list(start.warnings)
    together = jax.default_backend() != "cpu" if side_by_side is None else side_by_side
    batch = chains if together and method == "hmc" else 1
    keys = iter(jax.random.split(key, (chains * (1 + _RETRIES) // batch, batch)))
    retries, factor = _RETRIES * (chains - 1), 1.0
    try:
        with stages.time("sampling"):
            while len(runs) < chains:
                found, size, cpu = _run_chains(
                    next(keys), kernel, mapping, data, warm, chunks, factor, bar
                )
                ill = False
                for run in found[: chains - len(runs)]:
                    why = _unhealthy(run)
                    if why and retries:
                        retries, ill = retries - 1, True
                        warnings.append(
                            f"a chain was run again from another start, with shorter steps: {why}"
                        )
                        continue
                    if why:
                        warnings.append(f"chain {len(runs)} is not to be trusted: {why}")
                    runs.append(run)
                    sizes.append(size)
                    spent.append(cpu / batch)
                if ill:
                    factor *= _SHRINK
                    bar.total += batch * (warm + chunks) * CHUNK
    except _Interrupted as stop:
        runs = [r for r in runs + stop.runs if r][:chains]
        if len(runs) < 2 and sum(map(len, runs)) < 2:
            raise KeyboardInterrupt from None
        warnings.append("interrupted: the draws so far are kept")
    finally:
        bar.close()
    x, u, stats = _stack(runs)
    stats["step_size"] = np.asarray(sizes)
    stats["cpu"] = np.asarray(spent)  # seconds of the kept draws: no compilation, no warm-up
    fit = SampledFit(cm, data, start.options, stages, (), method, x, u, stats)
    fit.source = start.source
    fit.warnings = (*warnings, *_convergence(fit))
    return fit


def _default_accept(method: str, coordinates: int) -> float:
    """Target acceptance probability where the caller names none."""
    if coordinates < _FEW:
        return 0.9
    return 0.7 if method == "nuts" else 0.8


class _Interrupted(Exception):
    def __init__(self, runs: list[list[Chunk]]) -> None:
        self.runs = runs


def _bar(total: int, show: bool, label: str):
    from tqdm import tqdm

    return tqdm(total=total, disable=not show, desc=label, unit="draw", leave=False)


def _run_chains(
    keys, kernel: Kernel, mapping, data, warm: int, chunks: int, factor: float, bar
) -> tuple[list[list[Chunk]], float, float]:
    """Chains side by side, one a key: chunks of each after warm-up, step size, their CPU s."""
    alone = len(keys) == 1
    run: list[Chunk] = []
    size, began = float("nan"), time.process_time()
    try:
        state = kernel.start(keys[0] if alone else keys, mapping, data)
        for i in range(warm + chunks):
            if i == warm:
                state, size = kernel.settle(state, factor)
                began = time.process_time()
            state, chunk = kernel.advance(state, mapping, data, i < warm)
            if i >= warm:
                run.append(Chunk(*(np.asarray(part) for part in chunk)))
            bar.update(CHUNK * len(keys))
    except KeyboardInterrupt:
        raise _Interrupted(_each(run, len(keys))) from None
    return _each(run, len(keys)), size, time.process_time() - began


def _each(run: list[Chunk], chains: int) -> list[list[Chunk]]:
    """Chunks of chains side by side, chain by chain."""
    if chains == 1:
        return [run]
    return [[Chunk(*(part[c] for part in chunk)) for chunk in run] for c in range(chains)]


def _unhealthy(run: list[Chunk]) -> str:
    """Why a chain cannot be believed; empty if it can."""
    energy = np.concatenate([c.potential for c in run])
    accept = np.concatenate([c.accept for c in run])
    diverging = int(np.concatenate([c.diverging for c in run]).sum())
    if not np.isfinite(energy).all():
        return "its density is not finite"
    if diverging:
        return f"{diverging} divergent transitions"
    if accept.mean() < 0.4:
        return f"acceptance {accept.mean():.2f}: the step size collapsed or the chain hangs"
    if len(np.unique(energy)) < 0.1 * len(energy):
        return "it hangs at one place"
    return ""


def _stack(runs: list[list[Chunk]]):
    """Draws (chain, draw, ...) cut to the shortest chain, and statistics by name."""
    n = min(len(run) for run in runs)
    if n == 0:
        raise FitError("interrupted before two chains had draws")
    parts = [np.stack([np.concatenate([c[i] for c in run[:n]]) for run in runs]) for i in range(6)]
    names = ("potential", "steps", "accept", "diverging")
    stats: dict[str, np.ndarray] = dict(zip(names, parts[2:], strict=True))
    return parts[0], parts[1], stats


def _settled(values: np.ndarray) -> np.ndarray:
    """R-hat with infinity where a coordinate stood still (0 / 0)."""
    return np.nan_to_num(values, nan=np.inf)


def _convergence(fit: SampledFit) -> list[str]:
    """Sentences on what has not converged."""
    said = []
    worst_u = np.max(_settled(r_hat(fit.u)), initial=0.0)
    if worst_u > 1.05:
        said.append(f"parameters have not converged: R-hat up to {worst_u:.2f}; draw more")
    states = _settled(r_hat(fit.x[:, :, : fit.n_states]))
    bad = (states > 1.05).any(axis=tuple(range(1, states.ndim)))
    if bad.any():
        said.append(
            f"{int(bad.sum())} of {fit.n_states} states have R-hat above 1.05: "
            "several modes, or too few draws"
        )
    low = np.min(ess_bulk(fit.u), initial=np.inf)
    if low < 100:
        said.append(f"a parameter has only {low:.0f} effective draws; draw more")
    return said
