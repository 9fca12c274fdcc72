"""Data replicated from a posterior, and the prior's density at its draws."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import numpyro.distributions as dist
from numpyro import handlers
from numpyro.primitives import Messenger

from maloc._jax import jax, jnp
from maloc.infer._model import ChainModel, _unwrap

if TYPE_CHECKING:
    from maloc.infer._fit import Fitted

__all__ = ["log_prior", "replicated", "unobserved"]


class unobserved(Messenger):
    """A model whose data are to be drawn, not given: for `numpyro.infer.Predictive`.

    ``Predictive(model)`` returns data that are observed as they are;
    ``Predictive(maloc.infer.unobserved(model), draws)(key, data)`` draws them at the places, times
    and masks of the data given. Factors, and the missed pings that a model sums out, stay.

    Parameters
    ----------
    fn : callable
        A NumPyro model.
    """

    def process_message(self, msg) -> None:
        """Take the value of an observed site away."""
        if msg["type"] != "sample" or not msg["is_observed"]:
            return
        if _is_data(_unwrap(msg["fn"])[0]):
            msg["value"], msg["is_observed"] = None, False


def _is_data(law) -> bool:
    """Whether values of the law can be drawn: no factor, nothing that is summed out."""
    known = type(law).sample is not dist.Distribution.sample
    return known and not isinstance(law, dist.Unit) and not getattr(law, "summed_out", False)


def replicated(fit: Fitted, seed: int = 0) -> dict[str, np.ndarray]:
    """Data of every observed site that can be drawn, at each draw: site -> (chain, draw, ...).

    References
    ----------
    Gelman, Meng & Stern (1996) Posterior predictive assessment of model fitness. Stat. Sinica 6:
    733-807.
    """
    x, u, lead = _flat(fit)
    keys = jax.random.split(jax.random.key(seed), len(x))
    found = _drawer(fit.cm)(keys, x, u, fit.args)
    return {k: np.asarray(v).reshape(*lead, *v.shape[1:]) for k, v in found.items()}


@functools.lru_cache(maxsize=16)
def _drawer(cm: ChainModel):
    def one(key, x, u, args):
        out = {}
        for name, site in cm._trace(cm.sites(x, u)[0], args).items():
            if site["type"] != "sample" or not site["is_observed"]:
                continue
            if not _is_data(law := _unwrap(site["fn"])[0]):
                continue
            key, own = jax.random.split(key)
            with handlers.block():
                out[name] = law.sample(own)
        return out

    return jax.jit(
        lambda k, x, u, args: jax.lax.map(lambda d: one(d[0], d[1], d[2], args), (k, x, u))
    )


def log_prior(fit: Fitted) -> dict[str, np.ndarray]:
    """Log density of each latent site given those before it: site -> (chain, draw)."""
    x, u, lead = _flat(fit)
    return {k: np.asarray(v).reshape(lead) for k, v in _density(fit.cm)(x, u, fit.args).items()}


@functools.lru_cache(maxsize=16)
def _density(cm: ChainModel):
    def one(x, u, args):
        return {
            name: jnp.sum(site["fn"].log_prob(site["value"]))
            for name, site in cm._trace(cm.sites(x, u)[0], args).items()
            if site["type"] == "sample" and not site["is_observed"]
        }

    return jax.jit(lambda x, u, args: jax.lax.map(lambda d: one(d[0], d[1], args), (x, u)))


def _flat(fit: Fitted):
    x, u = fit.flat_draws()
    flat = (jnp.asarray(part.reshape(-1, *part.shape[2:])) for part in (x, u))
    return *flat, x.shape[:2]
