"""Whether receivers err for good, and the fit that lets them.

A receiver in another place than its table says, or whose clock or habit makes it early or late for
good, errs in all its arrivals alike, and no number of pings averages that away. A score test at the
fit without such errors says whether the arrivals tell of any; where they do, places and lateness of
all receivers are found with the path, at scales that the data tell.
"""

from __future__ import annotations

import functools
import inspect

import numpy as np
from scipy.stats import chi2

from maloc._jax import jax, jnp
from maloc.infer._border import _arrivals, _column, _push, by_receiver
from maloc.infer._chain import ChainFactor
from maloc.infer._model import ChainModel
from maloc.infer._sites import _unwrap
from maloc.infer.initial import _position_columns

__all__ = ["ALIKE", "LEVEL", "asked_of", "carried", "spells", "standing_errors"]

ALIKE = 3.0  # sds of `spells`; below -1 on the average where arrivals err independently
LEVEL = 0.01
_MOST = 3.0  # sizes; a wild arrival tells little of its neighbours
_FLAT = 1e-6  # of the largest eigenvalue: directions that the data do not know


def asked_of(model, options: dict, name: str) -> str:
    """What is asked of an option of a model that may be "auto": its value, "" of other models."""
    known = inspect.signature(model).parameters.get(name) if callable(model) else None
    if known is None or known.default != "auto":
        return ""
    return options.get(name, "auto")


def standing_errors(cm: ChainModel, args: tuple, x, u, factor: ChainFactor) -> float:
    """P value of receivers that all stand in their places and are late by nothing.

    Parameters
    ----------
    cm, args : ChainModel, tuple
        A model without receivers' errors, and its arguments.
    x, u : arrays (T, d), (k,)
        Its mode.
    factor : ChainFactor
        Of the path's precision there.

    References
    ----------
    Efficient scores: Cox & Hinkley (1974) Theoretical Statistics, 9.3.
    """
    weight, slope, step = (np.asarray(a) for a in _looked(cm)(x, u, args))
    columns = _position_columns(cm)
    late = np.ones((*weight.shape, 1))
    effect = np.concatenate([-step[:, :, columns], late], axis=2)  # (T, R, 3)
    heard = np.flatnonzero(weight.any(axis=0))
    weight, slope, step, effect = (a[:, heard] for a in (weight, slope, step, effect))
    score = np.einsum("tr,trc->rc", slope, effect).ravel()
    mixed = np.einsum("tr,trc,trd->rctd", weight, effect, step)
    mixed = mixed.reshape(-1, *x.shape)
    own = np.einsum("tr,tra,trb->rab", weight, effect, effect)
    information = np.zeros((len(score), len(score)))
    for r, block in enumerate(own):
        information[3 * r : 3 * r + 3, 3 * r : 3 * r + 3] = block
    flat = mixed.reshape(len(score), -1)
    information -= flat @ factor.solve(mixed).reshape(len(score), -1).T
    size = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    known = values > _FLAT * values.max()
    part = vectors[:, known].T @ (score / size)
    return float(chi2.sf(np.sum(part**2 / values[known]), known.sum()))


@functools.lru_cache(maxsize=32)
def _looked(cm: ChainModel):
    """Of the arrivals: Gauss-Newton weight and slope (T, R), and derivative by the path."""

    def look(x, u, args):
        trace = cm._trace(cm.sites(x, u)[0], args)
        name = next(n for n, site in trace.items() if by_receiver(site))
        law, mask = _unwrap(trace[name]["fn"])
        value = trace[name]["value"]
        mask = jnp.ones(value.shape, bool) if mask is None else jnp.asarray(mask)
        slope = jax.grad(lambda v: jnp.sum(jnp.where(mask, law.log_prob(v), 0.0)))(value)
        weight = jnp.where(mask, law.curvature(value), 0.0)
        ahead, still = _arrivals(cm, name, args), jnp.zeros_like(u)
        step = [_push(ahead, (x, u), (_column(x.shape, i), still)) for i in range(cm.d)]
        return weight, -slope, jnp.stack(step, axis=2)

    return jax.jit(look)


def spells(cm: ChainModel, args: tuple, x, u) -> tuple[float, int]:
    """How much a receiver's arrivals err alike from ping to ping, and which receiver most.

    Products of neighbouring residuals' slopes, those of one ping to three pings apart, over their
    own size: about a standard normal number, or below, where arrivals err independently.

    Returns
    -------
    z : float
        0 where there is nothing to compare.
    which : int
        Column of the receiver.
    """
    slope, heard = np.asarray(_looked(cm)(x, u, args)[1]), np.asarray(args[0].heard)
    slope = np.where(heard, slope, 0.0)
    size = np.sqrt((slope**2).sum() / max(heard.sum(), 1))
    slope = np.clip(slope / max(size, 1e-12), -_MOST, _MOST)
    pairs = [slope[:-lag] * slope[lag:] for lag in (1, 2, 3) if lag < len(slope)]
    if not pairs or not any(p.any() for p in pairs):
        return 0.0, 0
    own = np.sum([p.sum(axis=0) for p in pairs], axis=0)
    square = np.sum([(p**2).sum(axis=0) for p in pairs], axis=0)
    each = own / np.sqrt(np.maximum(square, 1e-12))
    return float(own.sum() / np.sqrt(square.sum())), int(np.argmax(each))


def carried(plain: ChainModel, x, u, cm: ChainModel, args: tuple) -> np.ndarray:
    """Parameters (k,) of a model with receivers' errors, none of them yet, from one without."""
    values = {k: np.asarray(v) for k, v in plain.values(x, u).items()}
    medians = {k: np.asarray(v) for k, v in cm.prior_medians(args).items()}
    still = {s.name: np.zeros(s.shape) for s in cm.globals if s.inner}
    return cm.flat_globals(medians | values | still)
