"""Leave one ping out: which of several models foresees a ping better, given all others.

A ping has a position of its own. The density of its arrivals at positions drawn with their help
says next to nothing of what the model would have foreseen without them, and importance sampling
over such draws fails. So the path is integrated out: at each draw of the parameters it is normal
about its mode, and what a ping adds to it can be taken away again.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from maloc._jax import jax, jnp
from maloc.errors import InputError
from maloc.infer._model import ChainModel, _clipped, _unwrap
from maloc.infer.mode import _factor, find_mode
from maloc.infer.result import Fit, LaplaceFit

__all__ = ["loo_by_ping", "ping_log_likelihood"]

_LEAST_DRAWS = 25  # ArviZ 1.x refuses fewer: five in the tail of a fifth


def ping_log_likelihood(fit: Fit, draws: int = 100) -> np.ndarray:
    """Log predictive density of each heard ping given all others, at draws of the parameters.

    Parameters
    ----------
    fit : Fit
        Fit of a model of arrival times.
    draws : int
        Posterior draws of the parameters, spread over all that the fit has.

    Returns
    -------
    (D, P) array
        Log densities of the ping's arrivals (ranges, 1/m) and, where the model has it, of who heard
        it.

    Raises
    ------
    InputError
        If the model has no pings with arrival times.

    Notes
    -----
    Laplace's integral. With x the path's mode, S its covariance at the ping, and g and K slope and
    curvature (Gauss-Newton) of the ping's own log density l there, the other pings leave a normal
    law with precision C = 1 / S - K and mean x - g / C, so that the density is

        l(x) - g' inv(C) g / 2 + log det(C) / 2 - log det(1 / S) / 2.
    """
    data: Any = fit.args[0] if fit.args else None
    if not hasattr(data, "range") or not hasattr(data, "valid"):
        raise InputError(f"a fit of {fit.model_name} has no pings with arrival times")
    cm, args = fit.cm, fit.args
    _, u = fit.flat_draws()
    u = u.reshape(-1, cm.k)
    u = u[np.unique(np.linspace(0, len(u) - 1, min(draws, len(u))).astype(int))]
    known = np.asarray(data.heard).any(axis=1) & np.asarray(data.valid)
    x, slope, middle = _path(fit)
    return np.array(
        [_at(cm, args, x + np.tensordot(own - middle, slope, axes=1), own)[known] for own in u]
    )


def loo_by_ping(fit: Fit, draws: int = 100) -> Any:
    """Expected log predictive density by leaving out each heard ping in turn.

    Parameters
    ----------
    fit : Fit
        Fit of a model of arrival times.
    draws : int
        Posterior draws of the parameters, 25 at least.

    Returns
    -------
    arviz.ELPDData
        Pointwise, an observation a ping: models of the same pings compare by
        ``arviz.compare({"one": loo_by_ping(fit), "other": loo_by_ping(other)})``.

    Raises
    ------
    InputError
        If the model has no pings with arrival times, or the draws are too few.

    References
    ----------
    Vehtari, Mononen, Tolvanen, Sivula & Winther (2016) J. Mach. Learn. Res. 17(103): 1-38; Vehtari,
    Gelman & Gabry (2017) Stat. Comput. 27: 1413-1432, for the parameters' draws.
    """
    import arviz as az
    import xarray as xr

    if draws < _LEAST_DRAWS:
        raise InputError(f"{draws} draws are too few to leave pings out", mend="take 100")

    from maloc.infer._arviz import as_arviz

    value = ping_log_likelihood(fit, draws)[None]
    groups: dict[str, Any] = {
        "posterior": xr.Dataset({"draw_of": (("chain", "draw"), np.zeros(value.shape[:2]))}),
        "log_likelihood": xr.Dataset({"density": (("chain", "draw", "ping"), value)}),
    }
    tree = xr.DataTree.from_dict({f"/{name}": group for name, group in groups.items()})
    return az.loo(as_arviz(tree), pointwise=True, reff=1.0)


def _path(fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A path (T, d), how it moves with the parameters (k, T, d), and the parameters it is at."""
    if isinstance(fit, LaplaceFit):
        return fit.marginal.x, fit.marginal.slope, fit.marginal.u
    x, u = fit.flat_draws()
    x = x.reshape(-1, *x.shape[2:]).mean(axis=0)
    return x, np.zeros((fit.cm.k, *x.shape)), u.reshape(-1, fit.cm.k).mean(axis=0)


def _at(cm: ChainModel, args: tuple, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    x = find_mode(cm, args, x, u, max_steps=15, tol=1e-11).x  # slopes are set against flat priors
    factor = _factor(cm.terms(x, u, args, 0.0, False)[2], cm.d)
    density, slope, own = (np.asarray(v) for v in _compiled(cm)(x, u, args))
    precision = np.linalg.inv(factor.covariances())
    values, vectors = np.linalg.eigh(precision - own)
    values = np.maximum(values, 1e-13 * np.abs(values).max(axis=1, keepdims=True))
    away = np.einsum("tij,ti->tj", vectors, slope) ** 2 / values
    wider = np.log(values).sum(axis=1) - np.linalg.slogdet(precision)[1]
    return density + 0.5 * (wider - away.sum(axis=1))


@functools.lru_cache(maxsize=16)
def _compiled(cm: ChainModel):
    """Log density (T,) of what belongs to one state, its slope (T, d) and curvature (T, d, d)."""

    def parts(moving, x, u, args):
        """Densities at ``moving``, and the same with arrivals' Gauss-Newton curvature about x."""
        fixed = cm._trace(cm.sites(x, u)[0], args)
        exact = jnp.zeros(x.shape[0])
        arrivals = rest = jnp.zeros(())
        for name, site in cm._trace(cm.sites(moving, u)[0], args).items():
            if site["type"] != "sample" or not site["is_observed"]:
                continue
            base, mask = _unwrap(site["fn"])
            if not base.batch_shape or base.batch_shape[0] != x.shape[0]:
                continue
            density = base.log_prob(site["value"])
            density = density if mask is None else jnp.where(mask, density, 0.0)
            exact += density.reshape(x.shape[0], -1).sum(axis=1)
            if hasattr(base, "curvature"):
                law = _unwrap(fixed[name]["fn"])[0]
                curvature = law.curvature(site["value"])
                curvature = curvature if mask is None else jnp.where(mask, curvature, 0.0)
                arrivals += 0.5 * jnp.sum(curvature * (base.loc - law.loc) ** 2)
            else:
                rest -= jnp.sum(density)
        return exact, arrivals, rest

    def blocks(which, x, u, args):
        _, push = jax.linearize(jax.grad(lambda m: parts(m, x, u, args)[which]), x)
        columns = [push(jnp.broadcast_to(jnp.eye(cm.d)[j], x.shape)) for j in range(cm.d)]
        return jnp.stack(columns, axis=2)

    def all_of(x, u, args):
        slope = jax.grad(lambda m: jnp.sum(parts(m, x, u, args)[0]))(x)
        own = blocks(1, x, u, args) + _clipped(blocks(2, x, u, args), 0.0)
        return parts(x, x, u, args)[0], slope, own

    return jax.jit(all_of)
