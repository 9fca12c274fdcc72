"""Natural gradient ascent of the evidence lower bound, compiled once a model and shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from maloc._jax import jax, jnp
from maloc.infer._guide import (
    Frame,
    Guide,
    Learnt,
    covariances,
    information,
    log_density,
    moved,
    push,
)
from maloc.infer._model import ChainModel

__all__ = ["CHUNK", "Engine", "Seen", "State", "ascent", "climb", "rising", "settle"]

CHUNK = 25
_RATE, _LAST = 0.05, 0.005  # natural step, held for half the steps and then falling to the last


class State(NamedTuple):
    """Increments now, and their average so far with its weight."""

    by: Learnt
    average: Learnt
    weight: Any


class Seen(NamedTuple):
    """Of each step: the bound, whether it was finite, the parameters' increments (n, k)."""

    bound: Any
    finite: Any
    u: Any


class Engine(NamedTuple):
    """Compiled functions of a model."""

    advance: Callable
    bounds: Callable
    draws: Callable
    covariances: Callable


def climb() -> np.ndarray:
    """Size of each step of a chunk and its weight in the average (CHUNK, 2), on the way up."""
    return np.column_stack([np.full(CHUNK, _RATE), np.zeros(CHUNK)])


def settle(chunks: int) -> np.ndarray:
    """The same of so many chunks at the end (chunks, CHUNK, 2): falling rates, averaged."""
    t = (np.arange(chunks * CHUNK) + 0.5) / (chunks * CHUNK)
    rate = np.interp(t, [0.0, 1.0], [_RATE, _LAST])
    return np.column_stack([rate, np.ones(len(t))]).reshape(chunks, CHUNK, 2)


def rising(seen: list[Seen]) -> bool:
    """Whether the bound of the last chunk is above that of the one before, beyond their noise."""
    before, last = (part.bound[part.finite] for part in seen[-2:])
    if min(len(before), len(last)) < 2:
        return True
    noise = np.hypot(*(np.std(part, ddof=1) / np.sqrt(len(part)) for part in (before, last)))
    return bool(np.mean(last) - np.mean(before) > 2 * noise)


def ascent(cm: ChainModel, particles: int) -> Engine:
    """The functions of a model, made (and so compiled) once."""
    made = cm.__dict__.setdefault("svi", {})
    if particles not in made:
        made[particles] = _make(cm, particles)
    return made[particles]


def _make(cm: ChainModel, particles: int) -> Engine:
    def log_ratio(guide: Guide, held: Guide, white, args):
        x, u = push(guide, white)
        return cm.log_joint(x, u, args) - log_density(held, x, u)

    def loss(by: Learnt, frame: Frame, white, args):
        """Minus the bound; the guide's own density is held, so the draws alone carry gradient."""
        guide = moved(frame, by)
        held = jax.lax.stop_gradient(guide)
        bound = jnp.mean(jax.vmap(lambda w: log_ratio(guide, held, w, args))(white))
        return -bound, bound

    slope = jax.grad(loss, has_aux=True)

    @jax.jit
    def advance(state: State, key, plan, frame: Frame, args):
        units = information(state.by)
        size = state.by.u.size + state.by.x.size

        def one(state: State, now):
            key, rate, weight = now
            half = jax.random.normal(key, (particles // 2, size))
            gradient, bound = slope(state.by, frame, jnp.concatenate([half, -half]), args)
            finite = jnp.isfinite(bound)
            for part in gradient:
                finite &= jnp.all(jnp.isfinite(part))

            def step(by, gradient, unit):
                return by - rate * jnp.where(finite, jnp.clip(gradient / unit, -1.0, 1.0), 0.0)

            by = jax.tree.map(step, state.by, gradient, units)
            total = state.weight + weight
            share = weight / jnp.maximum(total, 1.0)
            average = jax.tree.map(lambda a, b: a + share * (b - a), state.average, by)
            return State(by, average, total), Seen(bound, finite, by.u)

        keys = jax.random.split(key, len(plan))
        return jax.lax.scan(one, state, (keys, plan[:, 0], plan[:, 1]))

    def each(function, white):
        return jax.lax.map(function, white)

    return Engine(
        advance,
        jax.jit(lambda g, white, args: each(lambda w: log_ratio(g, g, w, args), white)),
        jax.jit(lambda g, white: each(lambda w: push(g, w), white)),
        jax.jit(covariances),
    )
