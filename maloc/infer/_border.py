"""How receivers' effects border the path's precision.

A receiver's place, clock or habit errs for all pings it hears, so its effect is tied to the whole
path, and the precision of both is an arrow: the path's band, and a border of few rows. A receiver's
effect touches its own arrivals alone, so one derivative of the predicted arrivals serves all
receivers at once.
"""

from __future__ import annotations

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._sites import _is_own, _unwrap

__all__ = ["border", "by_receiver"]


def border(cm, x, u, args):
    """Gauss-Newton precision of the inner parameters, priors left out.

    Parameters
    ----------
    cm : ChainModel
    x : (T, d) array
        Path.
    u : (k,) array
        Unconstrained parameters.
    args : tuple
        The model's arguments.

    Returns
    -------
    mixed : (m, T, d) array
        With the path.
    block : (m, m) array
        Among themselves.
    """
    here = cm._trace(cm.sites(x, u)[0], args)
    mixed, block = jnp.zeros((cm.k, *x.shape)), jnp.zeros((cm.k, cm.k))
    for name, site in here.items():
        if not by_receiver(site):
            continue
        base, mask = _unwrap(site["fn"])
        weight = base.curvature(site["value"])
        weight = weight if mask is None else jnp.where(mask, weight, 0.0)
        weight = weight if site["scale"] is None else weight * site["scale"]
        ahead = _arrivals(cm, name, args)
        still = jnp.zeros_like(u)
        path = [_push(ahead, (x, u), (_column(x.shape, i), still)) for i in range(cm.d)]
        parts, rows = [], []
        for own in (s for s in cm.globals if s.inner):
            place = np.arange(own.place.start, own.place.stop).reshape(own.shape[0], -1)
            for column in place.T:
                tangent = jnp.zeros(cm.k).at[column].set(1.0)
                parts.append(_push(ahead, (x, u), (jnp.zeros_like(x), tangent)))
                rows.append(column)
        if not rows:
            continue
        effect, row, step = jnp.stack(parts), np.stack(rows), jnp.stack(path, axis=2)
        # (C, T, R), (C, R), (T, R, d)
        each = jnp.einsum("tr,ctr,trd->crtd", weight, effect, step)
        mixed = mixed.at[row].add(each)
        pair = jnp.einsum("tr,atr,btr->abr", weight, effect, effect)
        block = block.at[row[:, None], row[None]].add(pair)
    return mixed[cm.inner], block[cm.inner[:, None], cm.inner[None]]


def by_receiver(site) -> bool:
    """Whether a site is arrivals (T, R) that depend on their own states alone."""
    if not _is_own(site) or jnp.ndim(site["value"]) != 2:
        return False
    return hasattr(_unwrap(site["fn"])[0], "curvature")


def _arrivals(cm, name: str, args):
    """Predicted arrivals (T, R) of a site as a function of path and parameters."""

    def predicted(x, u):
        return _unwrap(cm._trace(cm.sites(x, u)[0], args)[name]["fn"])[0].loc

    return predicted


def _column(shape, i: int):
    return jnp.zeros(shape).at[:, i].set(1.0)


def _push(function, point: tuple, tangent: tuple):
    return jax.jvp(function, point, tangent)[1]
