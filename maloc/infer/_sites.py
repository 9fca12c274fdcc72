"""The latent sites of a model: which are the path's, which are parameters', and how they unfold."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpyro.distributions as dist
from numpyro.distributions.transforms import biject_to

from maloc._jax import jax, jnp
from maloc.errors import FitError

__all__ = ["LEAST", "ChainSite", "GlobalSite", "Layout", "Structure", "laid_out", "signature"]

LEAST = 0.2


class ChainSite(NamedTuple):
    """A path site: name, class of its law, shape behind time, columns it takes in the flat path."""

    name: str
    law: type
    tail: tuple[int, ...]
    columns: slice


class GlobalSite(NamedTuple):
    """A parameter site: name, unconstrained shape, transform, place in the flat vector.

    ``inner``: standard normal effects (R, ...) of the receivers on the arrivals they heard, found
    and integrated out with the path (``infer={"inner": "receiver"}``).
    """

    name: str
    shape: tuple[int, ...]
    transform: Any
    place: slice
    inner: bool = False


class Layout(NamedTuple):
    """Latent sites of a model for arguments of given shapes; ``lengths`` of its path sites."""

    chain: tuple[ChainSite, ...]
    globals: tuple[GlobalSite, ...]
    lengths: frozenset[int]

    @property
    def key(self) -> tuple:
        """What two data sets must share to share a `ChainModel`: every shape but the length."""
        path = tuple((s.name, s.law, s.tail) for s in self.chain)
        return path, tuple((s.name, s.shape) for s in self.globals)


def laid_out(trace: dict, path: tuple | None) -> Layout:
    """Layout of the latent sites of a trace.

    Raises
    ------
    FitError
        If a path site has bounds.
    """
    chain: list[ChainSite] = []
    parameters: list[GlobalSite] = []
    start = place = 0
    lengths = set()
    for name, site in trace.items():
        if site["type"] != "sample" or site["is_observed"]:
            continue
        shape = jnp.shape(site["value"])
        transform = biject_to(site["fn"].support)
        if _is_chain(site, path):
            if not _is_identity(transform):
                raise FitError(f"path site '{name}' must be unbounded (real support)")
            lengths.add(shape[0])
            columns = slice(start, start + int(np.prod(shape[1:])))
            chain.append(ChainSite(name, type(_unwrap(site["fn"])[0]), shape[1:], columns))
            start = columns.stop
        else:
            flat = transform.inverse_shape(shape)
            columns = slice(place, place + int(np.prod(flat)))
            inner = site["infer"].get("inner") == "receiver"
            parameters.append(GlobalSite(name, flat, transform, columns, inner))
            place = columns.stop
    return Layout(tuple(chain), tuple(parameters), frozenset(lengths))


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
    """What the layout of a model may depend on: treedef and shapes."""
    leaves, tree = jax.tree_util.tree_flatten(args)
    return tree, tuple(np.shape(leaf) for leaf in leaves)


class Structure:
    """Hashable by its key only; carries the arguments for the first call."""

    def __init__(self, key, args) -> None:
        self.key, self.args = key, args

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other) -> bool:
        return self.key == other.key
