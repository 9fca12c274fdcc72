"""Whether another law of late arrivals is worth a fit.

ddetect's late arrivals may come up to a farthest wall late, each lateness as likely: where most are
late by a few metres, it takes them for a wide direct error. The residuals of a fit are looked at
through both laws; and where arrivals err alike for stretches, the fit may stand on the wrong hill,
whose residuals say little.
"""

from __future__ import annotations

import itertools

import numpy as np

from maloc._jax import jax, jnp
from maloc.arrival import DDetect, Multipath
from maloc.infer._effects import ALIKE, spells
from maloc.infer._model import ChainModel

__all__ = ["late_law_may_be_other"]

_GAIN = 4.0  # log units
_SHRUNK, _SHARES, _LATENESS = (1.0, 0.75, 0.5), (0.05, 0.15, 0.3, 0.5), (2.0, 5.0, 12.0, 30.0)


def late_law_may_be_other(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> bool:
    """Whether `Multipath` explains a ddetect fit's residuals better, or spells speak against it."""
    if spells(cm, args, x, u)[0] >= ALIKE:
        return True
    part = next(p for p in cm.pointwise(x, u, args).values() if "p_direct" in p)
    heard = np.asarray(part.get("mask", args[0].heard))
    values = cm.values(x, u)
    sigma, clock = float(values["sigma"]), getattr(args[0], "clock_sd", None)
    grid = np.array(list(itertools.product(_SHRUNK, _SHARES, _LATENESS)))
    clock = jnp.zeros(heard.shape) if clock is None else clock
    found = _compared(
        jnp.asarray(part["residual"]), heard, sigma, clock, args[0].phi, values["w"], grid
    )
    return bool(found > _GAIN)


@jax.jit
def _compared(residual, heard, sigma, clock, phi, w, grid):
    """Best log likelihood of `Multipath` on a grid of its parameters, less that of `DDetect`."""

    def total(law):
        return jnp.sum(jnp.where(heard, law.log_prob(residual), 0.0))

    def other(row):
        scale = jnp.sqrt((row[0] * sigma) ** 2 + clock**2)
        return total(Multipath(0.0, scale, w=row[1], scale=row[2], phi=phi))

    own = total(DDetect(0.0, jnp.sqrt(sigma**2 + clock**2), phi, w, background=1e-4))
    return jnp.max(jax.lax.map(other, grid)) - own
