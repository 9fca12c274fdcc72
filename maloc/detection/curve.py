"""Detection functions of distance, split so that a whole ping's likelihood needs few logarithms.

Every curve is p = exp(linear) * factor, with ``linear`` free of exponentials and logarithms a pair
of ping and receiver, and ``factor`` between 1e-30 and 1. The log likelihood of a ping is then the
sum of ``linear`` over the receivers that heard it plus the log of ONE product over all receivers:
of ``factor`` where they heard it and of 1 - p where they did not.
"""

from __future__ import annotations

from typing import Any

from jaxtyping import Array, Float

from maloc._jax import jax, jnp

__all__ = ["CAP", "KINDS", "curve", "log_miss", "log_product"]

# No receiver hears more than all but a millionth of the pings sent beside it: log(1 - p) and its
# slope stay finite at d = 0 and p0 = 1, and one unexplained silence costs at most 14 nats.
CAP = 1 - 1e-6
KINDS = ("halfnormal", "logistic", "hazard")

_LARGEST = 30.0  # of a logit or log hazard: beyond it p is 1 to a double
_NEAREST = 0.1  # smoothing of the cusp of a curve at d = 0, in scales
_GROUP = 8  # factors of at least 1e-30 multiplied before a log is taken: a double goes to 1e-308


def _logit(p0):
    p0 = jnp.minimum(p0, 1 - 1e-13)  # p0 = 1 keeps a finite slope
    return jnp.log(p0) - jnp.log1p(-p0)


def curve(
    kind: str, squared, p0, scale, shape: Any = None, shift=None
) -> tuple[Array, Array | None]:
    """``(linear, factor)`` of the curve ``kind`` at squared distances; None: a factor of 1."""
    if kind not in KINDS:
        raise ValueError(f"detection {kind!r} is none of {', '.join(KINDS)}")
    if (shape is None) == (kind == "hazard"):
        raise ValueError(f"a {kind} curve takes {'a' if kind == 'hazard' else 'no'} shape")
    if kind == "halfnormal":
        linear = squared * (-0.5 / scale**2)
        if shift is None:
            return linear + jnp.log(CAP * p0), None
        return linear, _plateau(p0, shift)
    # smooth and even in d at a receiver, off by half a percent of the scale one scale away
    relative = squared / scale**2 + _NEAREST**2
    if kind == "logistic":
        eta = _logit(p0) - jnp.sqrt(relative)
        eta = jnp.minimum(eta if shift is None else eta + shift, _LARGEST)
        return eta, CAP / (1 + jnp.exp(eta))
    log_hazard = jnp.minimum(-0.5 * shape * jnp.log(relative), _LARGEST)
    hazard = jnp.exp(jnp.maximum(log_hazard, -100.0))  # far away 1 - exp(-hazard) = hazard
    p = CAP * p0 if shift is None else _plateau(p0, shift)
    return log_hazard, p * (-jnp.expm1(-hazard) / hazard)


def _plateau(p0, shift):
    """p0 moved by ``shift`` on the logit scale."""
    return CAP * jax.nn.sigmoid(jnp.clip(_logit(p0) + shift, -_LARGEST, _LARGEST))


def log_miss(linear, factor):
    """log(1 - p)."""
    p = jnp.exp(linear)
    return jnp.log1p(-(p if factor is None else p * factor))


@jax.custom_jvp
def log_product(x: Float[Array, "*rest k"]) -> Float[Array, "*rest"]:
    """Sum of log(x) over the last axis by way of products of a few at a time."""
    whole = x.shape[-1] - x.shape[-1] % _GROUP
    groups = x[..., :whole].reshape(*x.shape[:-1], whole // _GROUP, _GROUP)
    rest = jnp.prod(x[..., whole:], axis=-1)
    return jnp.sum(jnp.log(jnp.prod(groups, axis=-1)), axis=-1) + jnp.log(rest)


@log_product.defjvp
def _log_product_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    return log_product(x), jnp.sum(dx / x, axis=-1)
