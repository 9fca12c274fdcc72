"""Markov kernels on the whitened target, compiled once a model: NumPyro's NUTS, and jittered HMC.

Both advance a chunk of draws at a time, with the map and the data as arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpyro.infer.hmc import hmc

from maloc._jax import jax, jnp
from maloc.infer._map import WhiteningMap, from_white, potential
from maloc.infer._model import ChainModel

__all__ = ["CHUNK", "Chunk", "kernels", "off_resonance"]

CHUNK = 50
_LENGTH = 2.4  # trajectory length of jittered HMC: about a quarter turn and a half of N(0, I)
_DEPTH = 7
_LONGEST = 0.5  # step; few coordinates accept longer ones and then diverge in the tails


class Chunk(NamedTuple):
    """Draws of one chunk: x (n, T, d), u (n, k), potential, steps, accept, diverging, each (n,)."""

    x: Any
    u: Any
    potential: Any
    steps: Any
    accept: Any
    diverging: Any


class Kernel(NamedTuple):
    """What moves a chain.

    ``start(key, m, args) -> state``; ``advance(state, m, args, warming) -> state, Chunk``;
    ``settle(state, factor) -> state, step size``: after warm-up, hold ``factor`` times the step
    that it found. HMC takes keys (C,) too: C chains side by side, one step size for all.
    """

    start: Callable
    advance: Callable
    settle: Callable


def kernels(cm: ChainModel, method: str, warmup: int, target_accept: float) -> Kernel:
    """The kernel of a method, made (and so compiled) once a model and setting."""
    made = cm.__dict__.setdefault("kernels", {})
    key = (method, warmup, target_accept)
    if key not in made:
        make = _nuts if method == "nuts" else _jittered
        made[key] = make(cm, warmup, target_accept)
    return made[key]


def _white_size(m: WhiteningMap) -> int:
    return m.u.shape[0] + m.x.size


def _nuts(cm: ChainModel, warmup: int, target_accept: float) -> Kernel:
    """NumPyro's NUTS with identity mass: only the step size is adapted."""
    density = jax.jit(lambda white, m, args: potential(cm, white, m, args))
    initialise, step = hmc(potential_fn_gen=lambda m, args: partial(density, m=m, args=args))

    def start(key, m, args):
        key_place, key_chain = jax.random.split(key)
        return initialise(
            jax.random.normal(key_place, (_white_size(m),)),
            warmup,
            step_size=0.3,
            adapt_mass_matrix=False,
            target_accept_prob=target_accept,
            max_tree_depth=_DEPTH,
            model_args=(m, args),
            rng_key=key_chain,
        )

    @jax.jit
    def run(state, m, args):
        def one(state, _):
            state = step(state, (m, args))
            x, u, _ = from_white(m, state.z)
            energy, steps = state.potential_energy, state.num_steps
            return state, Chunk(x, u, energy, steps, state.accept_prob, state.diverging)

        return jax.lax.scan(one, state, length=CHUNK)

    def advance(state, m, args, warming):
        return run(state, m, args)

    def settle(state, factor):
        step_size = min(float(state.adapt_state.step_size), _LONGEST)
        step_size = off_resonance(factor * step_size)
        adapted = state.adapt_state._replace(step_size=np.asarray(step_size))
        return state._replace(adapt_state=adapted), step_size

    return Kernel(start, advance, settle)


def off_resonance(step_size: float) -> float:
    """Step size at which no doubled trajectory ends just short of half a turn of N(0, I).

    Where 2^j - 1 steps cover a little less than pi, the U-turn is missed, the next doubling comes
    round to the start, and NUTS doubles on to its limit for nothing. Such a step is lengthened to
    just beyond pi; acceptance falls by a few per cent.
    """
    for doublings in range(1, 8):
        turn = (2**doublings - 1) * step_size / np.pi
        if 0.85 < turn < 1.1:
            return step_size * 1.1 / turn
    return step_size


class _HmcState(NamedTuple):
    key: jax.Array
    white: jax.Array
    potential: jax.Array
    gradient: jax.Array
    log_step: np.ndarray  # a NumPy scalar has one type, a JAX one two: compiled once
    log_steps: tuple[float, ...]


def _jittered(cm: ChainModel, warmup: int, target_accept: float) -> Kernel:
    """HMC of fixed length +-30 %, the jitter drawn anew for every draw.

    The whitened target is so near to N(0, I) that one length suits all coordinates, which spares
    the doubling and the turning checks of NUTS. The step size follows the acceptance rate a chunk
    at a time during warm-up (Robbins-Monro on its logarithm) and is then held.
    """
    value_and_grad = jax.value_and_grad(lambda white, m, args: potential(cm, white, m, args))

    @jax.jit
    def begin(key, m, args):
        key, key_place = jax.random.split(key)
        white = jax.random.normal(key_place, (_white_size(m),))
        return key, white, *value_and_grad(white, m, args)

    many_begin = jax.jit(jax.vmap(begin, (0, None, None)))

    def start(key, m, args):
        place = many_begin if key.ndim else begin
        key, white, energy, gradient = place(key, m, args)
        return _HmcState(key, white, energy, gradient, np.asarray(np.log(0.25)), ())

    @jax.jit
    def run(key, white, energy, gradient, log_step, m, args):
        eps = jnp.exp(log_step)

        def one(carry, key):
            white, energy, gradient = carry
            key_momentum, key_length, key_accept = jax.random.split(key, 3)
            momentum = jax.random.normal(key_momentum, white.shape)
            jitter = jax.random.uniform(key_length, minval=0.7, maxval=1.3)
            steps = jnp.clip(jnp.round(_LENGTH / eps * jitter), 1, 1000).astype(int)

            def leap(_, s):
                w, _, g, p = s
                p = p - 0.5 * eps * g
                w = w + eps * p
                e, g = value_and_grad(w, m, args)
                return w, e, g, p - 0.5 * eps * g

            w, e, g, p = jax.lax.fori_loop(0, steps, leap, (white, energy, gradient, momentum))
            change = energy - e + 0.5 * (momentum @ momentum - p @ p)
            change = jnp.where(jnp.isnan(change), -jnp.inf, change)
            accept = jnp.log(jax.random.uniform(key_accept)) < change
            new = jax.tree.map(
                lambda a, b: jnp.where(accept, a, b), (w, e, g), (white, energy, gradient)
            )
            x, u, _ = from_white(m, new[0])
            rate = jnp.minimum(1.0, jnp.exp(change))
            return new, Chunk(x, u, new[1], steps, rate, change < -1000.0)

        key, key_chunk = jax.random.split(key)
        carry, chunk = jax.lax.scan(
            one, (white, energy, gradient), jax.random.split(key_chunk, CHUNK)
        )
        return (key, *carry), chunk

    many_run = jax.jit(jax.vmap(run, (0, 0, 0, 0, None, None, None)))

    def advance(state, m, args, warming):
        move = many_run if state.key.ndim else run
        (key, white, energy, gradient), chunk = move(*state[:5], m, args)
        log_step, seen = state.log_step, state.log_steps
        if warming:
            rate = float(np.mean(chunk.accept))
            off = 0.8 / (1 + 0.3 * len(seen)) * (rate - target_accept)
            log_step = np.asarray(float(log_step) + off)
            seen = (*seen, float(log_step))
            if len(seen) == warmup // CHUNK:
                log_step = np.asarray(np.mean(seen[len(seen) // 2 :]))
        return _HmcState(key, white, energy, gradient, log_step, seen), chunk

    def settle(state, factor):
        log_step = min(float(state.log_step), np.log(_LONGEST)) + np.log(factor)
        return state._replace(log_step=np.asarray(log_step)), float(np.exp(log_step))

    return Kernel(start, advance, settle)
