"""When not to trust an approximate posterior: importance ratios' tails, and replicated data."""

from __future__ import annotations

import numpy as np
from numpyro import handlers

from maloc._jax import jax, jnp
from maloc.infer._arviz import psis
from maloc.infer._model import ChainModel, _unwrap
from maloc.infer.result import Fit

__all__ = ["K_BAD", "k_hat", "predictive_check"]

K_BAD = 0.7


def k_hat(log_ratios: np.ndarray) -> float:
    """Pareto shape of importance ratios; above `K_BAD` the approximation is not near the posterior.

    Of a whole path it says so sooner than any single position is wrong: small errors of hundreds
    of states add up in the ratio.

    Parameters
    ----------
    log_ratios : (n,) array
        Log of the posterior's density over the approximation's, at draws of the latter; 100 at
        least are needed for an answer that means something.

    References
    ----------
    Yao, Vehtari, Simpson & Gelman (2018) Yes, but did it work? Evaluating variational inference.
    ICML 35; Vehtari, Simpson, Gelman, Yao & Gabry (2024) Pareto smoothed importance sampling.
    J. Mach. Learn. Res. 25(72).
    """
    return psis(log_ratios)


def predictive_check(fit: Fit, draws: int = 40, seed: int = 0) -> float:
    """Chance that data replicated from the posterior are less likely than the data seen.

    Near 0: the data fit worse than the model can explain; near 1: better than it should.

    Parameters
    ----------
    fit : Fit
        Of a model whose observed sites can be drawn from.
    draws : int
        Posterior draws, with one replicate each.
    seed : int
        Seed of the replicates (the draws are the first of the fit's own).

    References
    ----------
    Gelman, Meng & Stern (1996) Posterior predictive assessment of model fitness. Stat. Sinica 6:
    733-807, with the log likelihood as discrepancy.
    """
    x, u = (part.reshape(-1, *part.shape[2:]) for part in fit.flat_draws())
    keep = np.linspace(0, len(x) - 1, min(draws, len(x))).astype(int)
    keys = jax.random.split(jax.random.key(seed), len(keep))
    compare = fit.cm.__dict__.setdefault("replicates", jax.jit(_replicates(fit.cm)))
    seen, drawn = compare(keys, jnp.asarray(x[keep]), jnp.asarray(u[keep]), fit.args)
    return float(np.mean(np.asarray(drawn) <= np.asarray(seen)))


def _replicates(cm: ChainModel):
    """Log likelihood of the data and of a replicate at each draw."""

    def one(key, x, u, args):
        values, _ = cm.sites(x, u)
        seen, drawn = jnp.zeros(()), jnp.zeros(())
        for site in cm._trace(values, args).values():
            if site["type"] != "sample" or not site["is_observed"]:
                continue
            fn, _ = _unwrap(site["fn"])
            if not hasattr(fn, "p_direct") and not fn.support.is_discrete:
                continue  # a factor
            key, own = jax.random.split(key)
            with handlers.block():
                replicate = fn.sample(own)
            seen += jnp.sum(site["fn"].log_prob(site["value"]))
            drawn += jnp.sum(site["fn"].log_prob(replicate))
        return seen, drawn

    return lambda keys, x, u, args: jax.lax.map(lambda d: one(d[0], d[1], d[2], args), (keys, x, u))
