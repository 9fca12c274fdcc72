"""Variational inference with a guide of the posterior's own structure (`maloc.infer._guide`).

The evidence lower bound is climbed by natural gradient steps: in the guide's units, plain ones. Its
gradient is taken through the draws alone, so that its noise vanishes as the guide comes near the
posterior, at draws in antithetic pairs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from maloc._jax import jax, jnp
from maloc.errors import FitError
from maloc.infer._ascent import CHUNK, Seen, State, ascent, climb, rising, settle
from maloc.infer._guide import Guide, laplace_frame, moved, still, whitening
from maloc.infer._map import WhiteningMap
from maloc.infer.laplace import laplace
from maloc.infer.result import Fit, LaplaceFit
from maloc.infer.trust import k_hat

__all__ = ["SviFit", "svi"]

_CHECKS = 200  # draws that the bound is measured with at the end


def svi(
    key,
    model: Callable | LaplaceFit,
    *args,
    steps: int = 400,
    particles: int = 8,
    draws: int = 1000,
    seed: int = 0,
    checks: int = _CHECKS,
    progress: bool = True,
    path: tuple[str, ...] | None = None,
    positions: np.ndarray | str | None = None,
    **options,
) -> SviFit:
    """Fit a chain-structured NumPyro model by structured variational inference.

    Much quicker than sampling, and better than the Laplace fit it starts from where the posterior
    is skewed: means are the posterior's rather than the mode's.

    Parameters
    ----------
    key : jax.Array
        Random key (``jax.random.key(seed)``).
    model : callable or LaplaceFit
        Model, as for `laplace`, or a Laplace fit of it (then no ``args``).
    *args
        The model's arguments.
    steps : int
        Gradient steps at most. The first half ends early where the bound no longer rises; the guide
        is the average over as many more, at falling rates.
    particles : int
        Draws a step, an even number.
    draws, seed : int
        Posterior draws that the fit's outputs are made of, and their seed.
    checks : int
        Draws that the bound, and `SviFit.k_hat`, are worked out from at the end.
    progress : bool
        Show a progress bar on stderr.
    path, positions, **options
        As for `laplace`.

    Returns
    -------
    SviFit
        Interrupted by the keyboard, what has been learnt so far, with a warning.

    Raises
    ------
    FitError
        If the Laplace fit fails, or the density is finite at hardly any draw.

    References
    ----------
    Hoffman, Blei, Wang & Paisley (2013) Stochastic variational inference. J. Mach. Learn. Res. 14:
    1303-1347 (natural gradients); Roeder, Wu & Duvenaud (2017) Sticking the landing. NeurIPS 30
    (the gradient's estimate); Tan & Nott (2018) Gaussian variational approximation with sparse
    precision matrices. Stat. Comput. 28: 259-275 (the structure).
    """
    if callable(key) or isinstance(key, Fit):
        raise TypeError("svi(key, model, data, ...) takes the random key first: jax.random.key(1)")
    if particles < 2 or particles % 2:
        raise ValueError("particles must be an even number: draws come in antithetic pairs")
    if steps < 2 * CHUNK:
        raise ValueError(f"steps must be {2 * CHUNK} or more")
    if isinstance(model, LaplaceFit):
        start = model
    else:
        start = laplace(model, *args, path=path, positions=positions, **options)
    cm, data, stages = start.cm, start.args, start.seconds
    engine = ascent(cm, particles)
    with stages.time("map"):
        frame = laplace_frame(cm, data, start.marginal)
    half = -(-steps // (2 * CHUNK))
    keys = iter(jax.random.split(key, 2 * half + 1))
    white = jax.random.normal(next(keys), (checks, cm.k + frame.start.x.size))
    state = State(still(frame), still(frame), jnp.zeros(()))
    seen: list[Seen] = []
    warnings = list(start.warnings)
    with stages.time("optimisation"), _bar(2 * half * CHUNK, progress) as bar:

        def advance(rates):
            nonlocal state
            state, chunk = engine.advance(state, next(keys), jnp.asarray(rates), frame, data)
            seen.append(Seen(*(np.asarray(part) for part in chunk)))
            bar.update(CHUNK)

        try:
            while len(seen) < half and (len(seen) < 2 or rising(seen)):
                advance(climb())
            for rates in settle(len(seen)):
                advance(rates)
        except KeyboardInterrupt:
            if not seen:
                raise
            warnings.append("interrupted: what has been learnt so far is kept")
        by = state.average if float(state.weight) else state.by
        guide = moved(frame, by)
        bound = np.asarray(engine.bounds(guide, white, data))
    history = Seen(*(np.concatenate(part) for part in zip(*seen, strict=True)))
    warnings += _unsettled(history, bound, white.shape[1])
    fit = SviFit(
        cm, data, start.options, stages, tuple(warnings), guide, bound, history.bound, draws, seed
    )
    fit.source = start.source
    return fit


class SviFit(Fit):
    """A variational posterior.

    Attributes
    ----------
    guide : Guide
        What was learnt.
    elbo, elbo_error : float
        Evidence lower bound (log units, all constants included) and its Monte Carlo error.
    history : (steps,) array
        The bound as it was climbed, at each step's draws.
    log_ratios : (checks,) array
        Log of the model's density over the guide's, at draws of the guide.
    """

    method = "svi"

    def __init__(
        self, cm, args, options, seconds, warnings, guide: Guide, bound, history, n: int, seed: int
    ) -> None:
        super().__init__(cm, args, options, seconds, warnings)
        self.guide, self.history, self.n, self.seed = guide, history, n, seed
        bound = bound[np.isfinite(bound)]
        self.log_ratios = bound
        self.elbo = float(np.mean(bound))
        self.elbo_error = float(np.std(bound, ddof=1) / np.sqrt(len(bound)))

    def flat_draws(
        self, n: int | None = None, seed: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Independent draws of parameters and path."""
        n, seed = self.n if n is None else n, self.seed if seed is None else seed
        size = self.cm.k + self.guide.x.size
        white = np.random.default_rng(seed).standard_normal((n, size))
        x, u = ascent(self.cm, 2).draws(self.guide, jnp.asarray(white))
        return np.asarray(x)[None], np.asarray(u)[None]

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (T, d) and covariance (T, d, d), the parameters' uncertainty included.

        Exact but for the mean over the parameters' values of the covariance given them, which is
        taken over 64 draws.
        """
        g, length = self.guide, self.n_states
        half = np.random.default_rng(self.seed).standard_normal((32, self.cm.k))
        zeta = jnp.asarray(np.concatenate([half, -half]))
        given = np.asarray(ascent(self.cm, 2).covariances(g, zeta))
        moving = np.einsum("kl,ktd->ltd", np.asarray(g.c), np.asarray(g.b))
        spread = np.einsum("lti,ltj->tij", moving, moving)
        return np.asarray(g.x)[:length], (given + spread)[:length]

    @property
    def k_hat(self) -> float:
        """Pareto shape of the importance ratios, see `maloc.infer.trust.k_hat`."""
        return k_hat(self.log_ratios)

    def mapping(self) -> WhiteningMap:
        """Whitening map for `nuts`."""
        return whitening(self.guide)


def _bar(total: int, show: bool):
    from tqdm import tqdm

    return tqdm(total=total, disable=not show, desc="svi", unit="step", leave=False)


def _unsettled(seen: Seen, bound: np.ndarray, size: int) -> list[str]:
    """Sentences on what has not converged: the last quarter of the steps against the one before."""
    said = []
    bad = int((~seen.finite).sum()), int((~np.isfinite(bound)).sum())
    if 2 * bad[0] > len(seen.finite) or 2 * bad[1] > len(bound):
        raise FitError("the density is not finite at draws of the variational posterior")
    if any(bad):
        said.append(
            f"the density was not finite at {bad[0]} steps and {bad[1]} of {len(bound)} draws"
        )
    before, last = (
        Seen(*(part[quarter][seen.finite[quarter]] for part in seen))
        for quarter in np.array_split(np.arange(len(seen.finite)), 4)[2:]
    )
    rise = last.bound.mean() - before.bound.mean()
    error = np.hypot(*(q.bound.std() / np.sqrt(len(q.bound)) for q in (before, last)))
    if rise > 3 * error + 1e-3 * size:
        said.append(f"the evidence bound is still rising (by {rise:.2g}): take more steps")
    moved_by = np.abs(last.u.mean(axis=0) - before.u.mean(axis=0)).max(initial=0.0)
    if moved_by > 0.1:
        said.append(f"a parameter is still moving (by {moved_by:.2g} of its sd): take more steps")
    return said
