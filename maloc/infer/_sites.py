"""The latent sites of a model: which are the path's, which are parameters', and how they unfold."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpyro.distributions as dist

from maloc._jax import jax, jnp

__all__ = ["LEAST", "ChainSite", "GlobalSite", "Structure", "signature"]

LEAST = 0.2


class ChainSite(NamedTuple):
    """A path site: name, class of its law, shape behind time, columns it takes in the flat path."""

    name: str
    law: type
    tail: tuple[int, ...]
    columns: slice


class GlobalSite(NamedTuple):
    """A parameter site: name, unconstrained shape, transform, place in the flat vector."""

    name: str
    shape: tuple[int, ...]
    transform: Any
    place: slice


def _unwrap(fn):
    """Innermost distribution of a masked one, and its mask."""
    if isinstance(fn, dist.MaskedDistribution):
        inner, mask = _unwrap(fn.base_dist)
        return inner, fn._mask if mask is None else mask & fn._mask
    return fn, None


def _is_chain(site, path) -> bool:
    if path is not None:
        return site["name"] in path
    return bool(getattr(site["fn"], "is_chain", False) or site["infer"].get("is_chain"))


def _is_own(site) -> bool:
    """Whether a site's rows depend on one state of the path each: ``infer={"per_state": True}``."""
    return bool(site["type"] == "sample" and site["is_observed"] and site["infer"].get("per_state"))


def _clipped(blocks, least: float):
    """Symmetric blocks (T, d, d), eigenvalues raised to ``least`` times the largest in size."""
    values, vectors = jnp.linalg.eigh(0.5 * (blocks + jnp.swapaxes(blocks, 1, 2)))
    floor = least * jnp.max(jnp.abs(values), axis=1, keepdims=True)
    return jnp.einsum("tik,tk,tjk->tij", vectors, jnp.maximum(values, floor), vectors)


def _median(fn):
    """Median of a distribution: by its quantile function, else of some draws."""
    try:
        return fn.icdf(jnp.full(fn.shape(), 0.5))
    except (RuntimeError, ImportError, AttributeError, TypeError):
        return jnp.median(fn.sample(jax.random.key(0), (101,)), axis=0)


def _is_identity(transform) -> bool:
    from numpyro.distributions.transforms import IdentityTransform, IndependentTransform

    while isinstance(transform, IndependentTransform):
        transform = transform.base_transform
    return isinstance(transform, IdentityTransform)


def signature(args: tuple):
    """What the structure of a model may depend on: treedef and numbers of dimensions."""
    leaves, tree = jax.tree_util.tree_flatten(args)
    return tree, tuple(np.ndim(leaf) for leaf in leaves)


class Structure:
    """Hashable by the structure only; carries the arguments for the first call."""

    def __init__(self, key, args) -> None:
        self.key, self.args = key, args

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other) -> bool:
        return self.key == other.key
