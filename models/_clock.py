"""What is constant in the clock model: delays, places, sound speed and jumps; travel times."""

from __future__ import annotations

from typing import Any

import numpyro
import numpyro.distributions as dist

from maloc._jax import jax, jnp
from maloc.model_data.clock_pings import SPEED

__all__ = ["constants", "travel"]

_DELAY, _JUMP = 3.0, 500.0  # ms; prior sds of a receiver's delay with its own tag, of a jump
_SPEED = 50.0 / SPEED  # relative prior sd of the sound speed


class _Joint(dist.MultivariateNormal):
    """A normal law whose many draws are drawn one by one: shapes are never guessed."""

    def sample(self, key: Any, sample_shape=()):
        """Draw values."""
        if not sample_shape:
            return super().sample(key)
        return jax.vmap(lambda k: self.sample(k, sample_shape[1:]))(
            jax.random.split(key, sample_shape[0])
        )


def constants(data, position_sd: float, free_speed: bool):
    """Delays (D,) ms, shifts (D, 2) m, sound speeds (K, M) m/s and departures of jumps (J,) ms.

    They are sampled at once, ``constants``, in coordinates in which the pings tell them about
    independently: shifts, delays and sound speed trade off. What is held stays as in the ClockSync.
    """
    d = len(data.given)
    n = 3 * d + 1
    sd = [jnp.full(d, _DELAY), jnp.full(2 * d, position_sd), jnp.full(1, _SPEED * free_speed)]
    sd = jnp.concatenate([*sd, jnp.full(len(data.constants) - n, _JUMP)])
    prior = 1 / jnp.maximum(sd, 1e-9) ** 2
    size = jnp.linalg.cholesky(jnp.linalg.inv(data.information + jnp.diag(prior)))
    off = jnp.where(sd > 0, -data.constants, 0.0)
    law = _Joint(
        jax.scipy.linalg.solve_triangular(size, off, lower=True),
        precision_matrix=size.T @ (prior[:, None] * size),
    )
    value = data.constants + size @ numpyro.sample("constants", law)
    delay, shift = value[:d], value[d : 3 * d].reshape(d, 2)
    speed = SPEED * (1 + value[3 * d])
    named = {"delay": delay, "shift": shift, "sound_speed": speed, "jump": value[n:]}
    for name, each in named.items():
        numpyro.deterministic(name, each)
    return delay, shift, data.speed * speed / (SPEED * (1 + data.constants[3 * d])), value[n:]


def travel(data, shift, speed):
    """Travel time (K, M, D) ms of each ping to each deployment; 0 to the one beside the tag."""
    xyz = data.given + jnp.pad(shift, ((0, 0), (0, 1)))
    apart = data.source[..., None] != jnp.arange(len(xyz))[None, None]
    between = jnp.where(apart[..., None], xyz[data.source][..., None, :] - xyz[None, None], 1.0)
    distance = jnp.where(apart, jnp.sqrt(jnp.sum(between**2, axis=-1)), 0.0)
    return 1e3 * distance / speed[..., None]
