"""The law that tags share: each tag's parameters are normal around a mean, on the log scale.

What a tag's data say of its parameters is kept as a normal site (mean, precision) with the prior
they were fitted under taken out, so that the law's posterior is that of a normal with two levels,
the tags' own values integrated out:

    z_i ~ N(mu, B_i + diag(tau^2)),   B_i the inverse precision of site i.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpyro.distributions as dist
from numpyro.primitives import Messenger
from scipy.optimize import minimize

from maloc._jax import jax
from maloc.errors import InputError
from maloc.infer._model import ChainModel

__all__ = [
    "Law",
    "Site",
    "expected_law",
    "learn_population",
    "own_law",
    "reweighted",
    "shared",
    "site_of",
]

TAU = (np.log(0.3), 1.0)  # log-normal prior of the spread between tags, on the log scale
_LEAST = 1e-6  # precision of a site that says nothing


class Law(NamedTuple):
    """Log-normal law of the shared parameters: location and scale (h,) of their logarithms."""

    loc: np.ndarray
    scale: np.ndarray


class Site(NamedTuple):
    """What one tag says: mean (h,) and precision (h, h) of the logarithms, the prior taken out."""

    mean: np.ndarray
    precision: np.ndarray


class _Swap(Messenger):
    """Gives named sites a log-normal law."""

    def __init__(self, law: dict[str, tuple]) -> None:
        super().__init__(None)
        self.law = law

    def process_message(self, msg: dict[str, Any]) -> None:
        """Swap the distribution of a named site."""
        if msg["type"] == "sample" and msg["name"] in self.law:
            msg["fn"] = dist.LogNormal(*self.law[msg["name"]])


@functools.cache
def shared(model: Callable, names: tuple[str, ...]) -> Callable:
    """The model with a `Law` of the named parameters as its second argument."""

    @functools.wraps(model)
    def lawful(data, law, *args, **options):
        with _Swap({n: (law.loc[i], law.scale[i]) for i, n in enumerate(names)}):
            return model(data, *args, **options)

    return lawful


def own_law(cm: ChainModel, args: tuple, names: tuple[str, ...]) -> Law:
    """The law that a model gives the named sites itself.

    Raises
    ------
    InputError
        If a name is no site of the model, or its prior is not log-normal.
    """
    trace = cm._abstract(args)
    for name in names:
        if name not in trace or not isinstance(trace[name]["fn"], dist.LogNormal):
            what = "not log-normal in" if name in trace else "no parameter of"
            raise InputError(f"hierarchical '{name}' is {what} the model")

    def numbers(args):
        found = cm._trace({}, args)
        return [(found[name]["fn"].loc, found[name]["fn"].scale) for name in names]

    loc, scale = np.asarray(jax.jit(numbers)(args), float).T
    return Law(loc, scale)


def site_of(u: np.ndarray, covariance: np.ndarray, law: Law) -> Site:
    """Site of a tag whose logarithms are N(u, covariance) under a law."""
    whole = np.linalg.inv(covariance)
    prior = np.diag(law.scale**-2)
    values, vectors = np.linalg.eigh(whole - prior)
    precision = (vectors * np.maximum(values, _LEAST)) @ vectors.T
    mean = np.linalg.solve(precision, whole @ u - prior @ law.loc)
    return Site(mean, precision)


def learn_population(sites: list[Site], prior: Law) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2 h,) and covariance of mu and log tau: the mode, and the curvature there.

    Parameters
    ----------
    sites : list of Site
    prior : Law
        Normal prior of mu; tau is log-normal (`TAU`).
    """
    h = len(prior.loc)
    z = np.stack([s.mean for s in sites])
    spread = np.linalg.inv(np.stack([s.precision for s in sites]))

    def loss(v):
        mu, log_tau = v[:h], v[h:]
        total = spread + np.diag(np.exp(2 * log_tau))
        off = z - mu
        quadratic = np.einsum("ni,ni->", off, np.linalg.solve(total, off[..., None])[..., 0])
        own = ((mu - prior.loc) / prior.scale) ** 2 + ((log_tau - TAU[0]) / TAU[1]) ** 2
        return 0.5 * (np.linalg.slogdet(total)[1].sum() + quadratic + own.sum())

    start = np.concatenate([np.median(z, axis=0), np.full(h, TAU[0])])
    best = minimize(loss, start, method="BFGS").x
    step = 1e-3
    eye = step * np.eye(2 * h)
    hessian = np.array(
        [
            [
                loss(best + a + b) - loss(best + a - b) - loss(best - a + b) + loss(best - a - b)
                for b in eye
            ]
            for a in eye
        ]
    ) / (4 * step**2)
    return best, np.linalg.inv(hessian)


def expected_law(mean: np.ndarray, covariance: np.ndarray) -> Law:
    """The law whose log density is, but for a constant, the expected one under the posterior."""
    h = len(mean) // 2
    variance = np.diag(covariance)[h:]
    both = np.diag(covariance[:h, h:])
    return Law(mean[:h] - 2 * both, np.exp(mean[h:] - variance))


def reweighted(
    u: np.ndarray,
    covariance: np.ndarray,
    rows: np.ndarray,
    old: Law,
    new: Law,
    sure: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (k,) and covariance of normal parameters under another law than they were fitted under.

    Parameters
    ----------
    u : (k,) array
    covariance : (k, k) array
    rows : (h,) array of int
        Places of the shared parameters in u.
    old, new : Law
        That they were fitted under, and the new one.
    sure : (h, h) array, optional
        Covariance of the new law's location, which widens the parameters' own.
    """
    weight, where = np.zeros((2, len(u))), np.zeros((2, len(u)))
    weight[0, rows], weight[1, rows] = old.scale**-2, new.scale**-2
    where[0, rows], where[1, rows] = old.loc, new.loc
    precision = np.linalg.inv(covariance)
    narrow = np.linalg.inv(precision + np.diag(weight[1] - weight[0]))
    moved = narrow @ (precision @ u + weight[1] * where[1] - weight[0] * where[0])
    if sure is not None:
        gain = narrow[:, rows] * new.scale**-2
        narrow = narrow + gain @ sure @ gain.T
    return moved, narrow
