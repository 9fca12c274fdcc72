"""A NumPyro model seen as a chain: flat path, flat parameters, and jitted derivatives of both.

The latent sites that are Markov in time (``is_chain`` on the distribution, ``infer={"is_chain":
True}`` on the site, or named by the caller) are flattened to a path of shape (T, d); all other
latent sites to a vector of unconstrained parameters. The Hessian in the path is then
block-tridiagonal, and its blocks come from 3 d coloured Hessian-vector products, whatever the
model.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpyro.distributions as dist
from numpyro import handlers

from maloc._jax import jax, jnp
from maloc.errors import FitError
from maloc.infer._border import border
from maloc.infer._sites import (
    LEAST,
    Structure,
    _clipped,
    _is_own,
    _median,
    _unwrap,
    laid_out,
    signature,
)

__all__ = ["ChainModel", "chain_model"]


class ChainModel:
    """Densities and derivatives of one model with one set of static options.

    Parameters
    ----------
    model : callable
        NumPyro model.
    options : dict
        Static keyword arguments of the model.
    args : tuple
        Arguments of the model (pytrees of arrays); their values are not kept.
    path : tuple of str, optional
        Names of the path sites; found by ``is_chain`` where None.

    Raises
    ------
    FitError
        If the model has no path site, or path sites of different lengths or with bounds.
    """

    def __init__(self, model: Callable, options: dict, args: tuple, path: tuple | None) -> None:
        self.model, self.options = model, options
        self._lengths: dict[tuple, int] = {}
        trace = abstract(model, options, args)
        layout = laid_out(trace, path)
        self.chain, self.globals = list(layout.chain), list(layout.globals)
        if len(layout.lengths) != 1:
            raise FitError(
                "the model has no path site (mark it with infer={'is_chain': True} or path=)"
                if not layout.lengths
                else f"path sites differ in length: {sorted(layout.lengths)}"
            )
        self.d = sum(int(np.prod(s.tail)) for s in self.chain)
        self.k = sum(int(np.prod(s.shape)) for s in self.globals)
        inner = np.zeros(self.k, bool)
        for s in self.globals:
            inner[s.place] = s.inner
        self.inner, self.outer = np.flatnonzero(inner), np.flatnonzero(~inner)
        observed = [_unwrap(s["fn"])[0] for s in trace.values() if s["type"] == "sample"]
        self.has_local = any(getattr(fn, "local", False) for fn in observed)
        self.has_stand_in = any(hasattr(fn, "local_log_prob") for fn in observed)
        self.has_own = any(map(_is_own, trace.values()))
        self.terms = jax.jit(self._robust_terms)
        self.exact = jax.jit(self._exact_terms)
        self.gradient = jax.jit(jax.grad(self._value))
        self.gradients = jax.jit(jax.grad(self._value, (0, 1)))
        self.border = jax.jit(functools.partial(border, self))
        self.natural = jax.jit(self._natural)
        self.values = jax.jit(lambda x, u: self.sites(x, u)[0])
        self.pointwise = jax.jit(self._pointwise)
        self.naturals = jax.jit(self._naturals)
        self.likelihoods = jax.jit(self._likelihoods)
        self.prior_medians = jax.jit(self._medians)
        self.unconstrain = jax.jit(self._unconstrain)

    def _trace(self, values: dict, args: tuple):
        model = handlers.seed(self.model, rng_seed=0)
        model = handlers.substitute(model, data=values)
        return handlers.trace(model).get_trace(*args, **self.options)

    def _abstract(self, args: tuple) -> dict:
        return abstract(self.model, self.options, args)

    def length(self, args: tuple) -> int:
        """Number of states T for these arguments."""
        shapes = tuple(np.shape(leaf) for leaf in jax.tree_util.tree_leaves(args))
        if shapes not in self._lengths:
            site = self._abstract(args)[self.chain[0].name]
            self._lengths[shapes] = jnp.shape(site["value"])[0]
        return self._lengths[shapes]

    # -- flat <-> sites ---------------------------------------------------------------------

    def sites(self, x, u) -> tuple[dict, Any]:
        """Natural values of all latent sites, and log |d natural / d unconstrained|."""
        values = {s.name: x[:, s.columns].reshape(x.shape[0], *s.tail) for s in self.chain}
        log_det = jnp.zeros(())
        for s in self.globals:
            flat = u[s.place].reshape(s.shape)
            values[s.name] = s.transform(flat)
            log_det += jnp.sum(s.transform.log_abs_det_jacobian(flat, values[s.name]))
        return values, log_det

    def flat_path(self, values: dict) -> np.ndarray:
        """Path sites' values as one array (T, d)."""
        columns = [np.asarray(values[s.name]) for s in self.chain]
        return np.concatenate([c.reshape(c.shape[0], -1) for c in columns], axis=1)

    def flat_globals(self, values: dict) -> np.ndarray:
        """Natural parameter values as one unconstrained vector (k,)."""
        natural = {s.name: jnp.asarray(values[s.name], float) for s in self.globals}
        parts = [np.ravel(part) for part in self.unconstrain(natural)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _unconstrain(self, values: dict) -> list:
        return [s.transform._inverse(values[s.name]) for s in self.globals]

    def _medians(self, args: tuple) -> dict:
        """Prior median of each parameter site, the others at a draw; the path stands still at 0."""
        still = {s.name: jnp.zeros((self.length(args), *s.tail)) for s in self.chain}
        trace = self._trace(still, args)
        return {s.name: _median(trace[s.name]["fn"]) for s in self.globals}

    # -- densities ----------------------------------------------------------------------------

    def _joint(self, x, u, args, temper, here=None, own=None):
        """Log joint density in (path, unconstrained parameters), errors widened to ``temper``.

        Given a trace ``here``, sites that are not local are replaced by their stand-ins there.
        ``own``: only sites that are `_is_own` (True), or only the others (False).
        """
        values, total = self.sites(x, u)
        for name, site in self._trace(values, args).items():
            if site["type"] != "sample" or own not in (None, _is_own(site)):
                continue
            fn = site["fn"]
            base, mask = _unwrap(fn)
            if site["is_observed"] and hasattr(base, "widened"):
                fn = base.widened(temper)
                fn = fn if mask is None else fn.mask(mask)
            scale = 1.0 if site["scale"] is None else site["scale"]
            if here is not None and hasattr(base, "local_log_prob"):
                density = base.local_log_prob(site["value"], _unwrap(here[name]["fn"])[0])
            else:
                density = fn.log_prob(site["value"])
            total += jnp.sum(scale * density)
        return total

    def log_joint(self, x, u, args):
        """Exact log joint density of path (T, d) and unconstrained parameters (k,)."""
        return self._joint(x, u, args, 0.0)

    def _value(self, x, u, args, temper):
        return -self._joint(x, u, args, temper)

    def _surrogate(self, moving, x, u, args, temper, robust, own):
        """Negative log joint whose Hessian in ``moving`` at x is the Gauss-Newton one.

        Sites whose distribution knows a non-negative curvature of its residual enter by it and by
        the movement of their ``loc``; local ones are left out (see `_local`); everything else
        enters exactly. ``own`` as in `_joint`.
        """
        here = self._trace(self.sites(x, u)[0], args)
        values, total = self.sites(moving, u)
        for name, site in self._trace(values, args).items():
            if site["type"] != "sample" or _is_own(site) != own:
                continue
            fn = site["fn"]
            base, mask = _unwrap(fn)
            scale = 1.0 if site["scale"] is None else site["scale"]
            if site["is_observed"] and hasattr(base, "curvature"):
                fixed = _unwrap(here[name]["fn"])[0].widened(temper)
                curvature = jnp.where(
                    robust,
                    fixed.robust_curvature(site["value"]),
                    fixed.curvature(site["value"]),
                )
                if mask is not None:
                    curvature = jnp.where(mask, curvature, 0.0)
                total -= 0.5 * jnp.sum(scale * curvature * (base.loc - fixed.loc) ** 2)
            elif not getattr(base, "local", False):
                total += jnp.sum(scale * fn.log_prob(site["value"]))
        return -total

    def _local(self, moving, x, u, args):
        """Negative log density of the local sites: each term depends on one state.

        A distribution whose terms do not (missed pings summed out) offers
        ``local_log_prob(value, here)``, which has its gradient at ``here`` and is local.
        """
        here = self._trace(self.sites(x, u)[0], args)
        total = jnp.zeros(())
        for name, site in self._trace(self.sites(moving, u)[0], args).items():
            if site["type"] != "sample":
                continue
            base, mask = _unwrap(site["fn"])
            if not getattr(base, "local", False):
                continue
            if hasattr(base, "local_log_prob"):
                density = base.local_log_prob(site["value"], _unwrap(here[name]["fn"])[0])
            else:
                density = base.log_prob(site["value"])
            density = density if mask is None else jnp.where(mask, density, 0.0)
            total += jnp.sum(density if site["scale"] is None else site["scale"] * density)
        return -total

    # -- derivatives ----------------------------------------------------------------------------

    def _band(self, push, shape):
        """Hessian from its products with vectors (T, d), as a lower band matrix (2 d, T d)."""
        length, d = shape
        probes = np.zeros((3, d, length, d))
        for colour in range(3):
            for j in range(d):
                probes[colour, j, colour::3, j] = 1.0
        pushed = jax.vmap(jax.vmap(push))(jnp.asarray(probes))
        t = np.arange(length)
        diagonal = pushed[t % 3, :, t]  # (T, j, i)
        below = pushed[t[:-1] % 3, :, t[1:]]
        below = jnp.concatenate([below, jnp.zeros((1, d, d))])
        both = jnp.concatenate([diagonal, below], axis=2)  # (T, j, 2 d): column j, row offset
        reach = np.arange(d)[:, None] + np.arange(2 * d)[None]
        band = both[:, np.arange(d)[:, None], np.minimum(reach, 2 * d - 1)]
        band = jnp.where(reach < 2 * d, band, 0.0)
        return band.reshape(length * d, 2 * d).T

    def _robust_terms(self, x, u, args, temper, robust):
        value, gradient = jax.value_and_grad(self._value)(x, u, args, temper)
        slope = jax.grad(self._surrogate)
        band = self._hessian(lambda m, own: slope(m, x, u, args, temper, robust, own), x)
        if self.has_local:
            # a state that nothing ties to its neighbours is held by its own block alone
            tied = any(getattr(s.law, "is_chain", False) for s in self.chain)
            slope = jax.grad(self._local)
            blocks = self._blocks(lambda m: slope(m, x, u, args), x)
            band = self._with_blocks(band, _clipped(blocks, 0.0 if tied else LEAST))
        return value, gradient, band

    def _hessian(self, slope, x):
        """Band of the derivative of slope(path, own) in the path, both kinds of sites together."""
        _, push = jax.linearize(lambda m: slope(m, False), x)
        band = self._band(push, x.shape)
        if self.has_own:
            band = self._with_blocks(band, self._blocks(lambda m: slope(m, True), x))
        return band

    def _blocks(self, slope, x):
        """Diagonal blocks (T, d, d) of a slope's derivative that has no others.

        One product a column does for all states: a third of what `_band` takes.
        """
        _, push = jax.linearize(slope, x)
        probes = jnp.broadcast_to(jnp.eye(self.d)[:, None], (self.d, *x.shape))
        return jnp.moveaxis(jax.vmap(push)(probes), 0, 2)

    def _with_blocks(self, band, blocks):
        """A band with diagonal blocks (T, d, d) added."""
        d = self.d
        for i in range(d):
            column = jnp.moveaxis(blocks[:, i:, i], 1, 0)  # (d - i, T), below the diagonal
            band = band.at[: d - i, i::d].add(column)
        return band

    def _exact_terms(self, x, u, args, temper):
        value, gradient = jax.value_and_grad(self._value)(x, u, args, temper)
        slope = jax.grad(self._part)
        return value, gradient, self._hessian(lambda m, own: slope(m, x, u, args, temper, own), x)

    def _part(self, moving, x, u, args, temper, own):
        """Part of the negative log joint, with stand-ins for what is not local: it is banded."""
        here = self._trace(self.sites(x, u)[0], args) if self.has_stand_in else None
        return -self._joint(moving, u, args, temper, here, own)

    def cross(self, x, u, args) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the joint's gradient in path and parameters by the outer parameters.

        By differences; of the negative log joint, (m, T, d) and (m, k).
        """
        step, m = 1e-4, len(self.outer)
        path, own = np.empty((m, *np.shape(x))), np.empty((m, self.k))
        for row, i in enumerate(self.outer):
            off = np.zeros(self.k)
            off[i] = step
            ahead, behind = (self.gradients(x, u + s * off, args, 0.0) for s in (1, -1))
            path[row] = (np.asarray(ahead[0]) - np.asarray(behind[0])) / (2 * step)
            own[row] = (np.asarray(ahead[1]) - np.asarray(behind[1])) / (2 * step)
        return path, own

    # -- what the user sees -----------------------------------------------------------------------

    def _natural(self, x, u, args):
        """All latent and deterministic sites in natural space."""
        values, _ = self.sites(x, u)
        for name, site in self._trace(values, args).items():
            if site["type"] == "deterministic":
                values[name] = site["value"]
        return values

    def _pointwise(self, x, u, args):
        """Of each observed site: log density, p_direct and residual where the law knows them."""
        values, _ = self.sites(x, u)
        out = {}
        for name, site in self._trace(values, args).items():
            if site["type"] != "sample" or not site["is_observed"]:
                continue
            base, mask = _unwrap(site["fn"])
            if isinstance(base, dist.Unit):
                continue  # numpyro.factor: a part of the prior, no data
            out[name] = {"log_likelihood": base.log_prob(site["value"])}
            if hasattr(base, "p_direct"):
                out[name]["p_direct"] = base.p_direct(site["value"])
                out[name]["residual"] = site["value"] - base.loc
            if mask is not None:
                out[name]["mask"] = mask
        return out

    def _naturals(self, x, u, args):
        """All sites of many draws: x (N, T, d), u (N, k)."""
        return jax.lax.map(lambda draw: self._natural(draw[0], draw[1], args), (x, u))

    def _likelihoods(self, x, u, args):
        """Of many draws: log densities of the observed sites, and means of the rest."""

        def one(total, draw):
            parts = self._pointwise(draw[0], draw[1], args)
            density = {name: part.pop("log_likelihood") for name, part in parts.items()}
            return jax.tree.map(jnp.add, total, parts), density

        shapes = jax.eval_shape(self._pointwise, x[0], u[0], args)
        zero = {
            name: {k: jnp.zeros(v.shape) for k, v in part.items() if k != "log_likelihood"}
            for name, part in shapes.items()
        }
        total, density = jax.lax.scan(one, zero, (x, u))
        return density, jax.tree.map(lambda v: v / x.shape[0], total)


def abstract(model: Callable, options: dict, args: tuple) -> dict:
    """The model's trace with shapes in place of numbers: nothing is computed or compiled."""
    seen = {}

    def look(args):
        seen.update(handlers.trace(handlers.seed(model, rng_seed=0)).get_trace(*args, **options))
        return 0

    jax.eval_shape(look, args)
    return seen


def chain_model(model: Callable, options: dict, args: tuple, path: tuple | None = None):
    """The `ChainModel` of a model, made once per model, options and layout of its latent sites.

    Its jitted functions take the data as arguments, so every data set of one shape shares one
    compilation.
    """
    given = (model, tuple(sorted(options.items())), path)
    tree, shapes = signature(args)
    layout = _layout(Structure((*given, tree, shapes), args))
    return _cached(Structure((*given, tree, tuple(map(len, shapes)), layout), args))


@functools.lru_cache(maxsize=1024)
def _layout(key: Structure) -> tuple:
    model, options, path, *_ = key.key
    args, key.args = key.args, ()
    return laid_out(abstract(model, dict(options), args), path).key


@functools.lru_cache(maxsize=32)
def _cached(key: Structure) -> ChainModel:
    model, options, path, *_ = key.key
    args, key.args = key.args, ()
    return ChainModel(model, dict(options), args, path)
