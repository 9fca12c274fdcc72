"""What path distributions share: shapes, batches, tags laid end to end, the law of first states."""

from __future__ import annotations

import math
from typing import Any

import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions.util import promote_shapes

from maloc._jax import jax, jnp

__all__ = ["LOG_2PI", "MarkovPath", "by_tag", "column"]

LOG_2PI = math.log(2 * math.pi)


class MarkovPath(dist.Distribution):
    """What the path distributions share: shapes, tags laid end to end, a start around a centre."""

    is_chain = True
    pytree_data_fields = ("tag", "start")
    support: Any
    dt: Any
    centre: Any
    spread: Any
    tag: Any
    start: Any
    _log_density: Any  # (batch + event) -> (batch)
    _path: Any  # standard normal noise (batch + event), first positions (or None) -> path

    def _set(
        self, dt, centre, scalars: dict, tail: tuple[int, ...], tag, start, validate_args
    ) -> None:
        """Keep the parameters, all with the batch's number of dimensions (plus their own)."""
        dt, centre = jnp.asarray(dt), jnp.asarray(centre)
        self.tag, self.start = tag, start
        if tag is not None:
            if dt.ndim != 1 or centre.ndim != 1 or jnp.shape(tag) != (dt.shape[0] + 1,):
                raise ValueError("tags laid end to end take dt (T - 1,), centre (A,) and tag (T,)")
            self.dt, self.centre = dt, centre
            for name, value in scalars.items():
                setattr(self, name, jnp.asarray(value) if name == "spread" else by_tag(value, tag))
            event = (dt.shape[0] + 1, *tail, centre.shape[0])
            super().__init__(batch_shape=(), event_shape=event, validate_args=validate_args)
            return
        shapes = [jnp.shape(v) for v in scalars.values()]
        batch = jax.lax.broadcast_shapes(dt.shape[:-1], centre.shape[:-1], *shapes)
        (self.dt,) = promote_shapes(dt, shape=(*batch, dt.shape[-1]))
        (self.centre,) = promote_shapes(centre, shape=(*batch, centre.shape[-1]))
        for name, value in scalars.items():
            (value,) = promote_shapes(value, shape=batch)
            setattr(self, name, value)
        event = (dt.shape[-1] + 1, *tail, centre.shape[-1])
        super().__init__(batch_shape=batch, event_shape=event, validate_args=validate_args)

    def _over(self, function, value):
        """``function(value)``, mapped over the value's sample dimensions."""
        for _ in range(jnp.ndim(value) - len(self.batch_shape) - len(self.event_shape)):
            function = jax.vmap(function)
        return function(value)

    def log_prob(self, value: Float[Array, ...]):
        """Log density of a path; the value's shape ends in batch_shape + event_shape."""
        return self._over(self._log_density, value)

    def sample(self, key: Array, sample_shape=()):
        """Draw paths, shape ``sample_shape + batch_shape + event_shape``."""
        key, key_first = jax.random.split(key)
        noise = jax.random.normal(key, self.shape(sample_shape))
        if self.start is None:
            return self._over(lambda z: self._path(z, None), noise)
        lead = noise.shape[: noise.ndim - len(self.event_shape)]
        firsts = self.start.sample(key_first, (*lead, self.event_shape[0]))
        path = self._path
        for _ in lead:
            path = jax.vmap(path)
        return path(noise, firsts)

    def _starts(self):
        """Which states after the first start a tag, (T - 1,) bool."""
        return self.tag[1:] != self.tag[:-1]

    def _first_law(self):
        """Law of a first position (A,)."""
        if self.start is not None:
            return self.start
        spread = jnp.broadcast_to(column(self.spread), self.centre.shape)
        return dist.Normal(self.centre, spread).to_event(1)

    def _firsts(self, states):
        """Those of the states (..., T, A) that the law of first states is asked about."""
        return states[..., :1, :] if self.tag is None else states

    def _place(self, position):
        """Log density (..., T or 1) of positions as first ones."""
        position = self._firsts(position)
        if self.start is not None:
            return self.start.log_prob(position)
        spread = column(self.spread)
        off = (position - self.centre[..., None, :]) / column(spread)
        n_axes = self.event_shape[-1]
        return -0.5 * jnp.sum(off**2, -1) - n_axes * (jnp.log(spread) + 0.5 * LOG_2PI)

    def _join(self, first, steps):
        """Total of the steps' log densities (..., T - 1) and those of first states (..., T)."""
        if self.tag is None:
            return first[..., 0] + jnp.sum(steps, -1)
        return first[0] + jnp.sum(jnp.where(self._starts(), first[1:], steps))

    def _by_step(self, x):
        """A parameter as it goes with the steps (..., T - 1)."""
        if self.tag is None or jnp.ndim(x) == 0:
            return column(x)
        return x[1:]

    def _by_first(self, x):
        """A parameter as it goes with what `_firsts` keeps, without its axes."""
        return column(x) if self.tag is None else x

    def _own_start(self):
        """For each state, where its tag starts, (T,) int."""
        if self.tag is None:
            return jnp.zeros(self.event_shape[0], int)
        here = jnp.arange(1, self.event_shape[0])
        started = jnp.where(self._starts(), here, 0)
        return jax.lax.cummax(jnp.concatenate([jnp.zeros(1, int), started]))

    def _elapsed(self):
        """Seconds since the tag's first state, (..., T)."""
        zero = jnp.zeros_like(self.dt[..., :1])
        time = jnp.cumsum(jnp.concatenate([zero, self.dt], axis=-1), axis=-1)
        return time - time[..., self._own_start()]

    def _broadcast(self, x):
        return jnp.broadcast_to(x, self.batch_shape + self.event_shape)


def by_tag(x, tag):
    """A parameter by tag (N,) as one by state (T,); a scalar as it is. Padding takes the last."""
    x = jnp.asarray(x)
    return x if x.ndim == 0 else x.at[tag].get(mode="clip")


def column(x):
    """A parameter (...) as (..., 1), to go with an array over time; a scalar as it is (faster)."""
    return x if jnp.ndim(x) == 0 else x[..., None]
