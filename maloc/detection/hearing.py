"""Who hears a ping, and who does not: detection as a function of distance.

A ping sent at u is heard by receiver j with probability p_j(u), independently of the others, or,
with probability ``p_lost``, by nobody at all (collision with another tag, failed transmission).
`encounters` makes the distribution of a ping's encounter history from positions and parameters.

References
----------
Hostetter & Royle (2020) Movement-assisted localization from acoustic telemetry data. Movement
Ecology 8: 15, equations 3-5.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpyro.distributions as dist
from jaxtyping import Array, Bool, Float
from numpyro.distributions import constraints

from maloc._jax import jax, jnp
from maloc.detection.curve import CAP, KINDS, curve, log_miss, log_product

Numbers = Array | np.ndarray

__all__ = [
    "CAP",
    "KINDS",
    "Encounters",
    "encounters",
    "linear_shift",
    "log_probabilities",
    "squared_distance",
]

_NODES = 15  # of the quadrature over a ping's own shift
_LEAST = -700.0  # log of the smallest chance of silence: its exponential is still a double


def squared_distance(position: Float[Array, "S 2"], near_xy: Float[Array, "S K 2"]) -> Array:
    """Squared Euclidean distance (S, K), m2, of each state from the receivers considered there."""
    x = near_xy[..., 0] - position[:, :1]  # axis by axis: 1.5 times the speed of (S, K, 2)
    y = near_xy[..., 1] - position[:, 1:]
    return x * x + y * y


def log_probabilities(kind: str, distance, p0, scale, shape=None, shift=None):
    """Log probabilities that a ping is heard, and missed, at these distances.

    Parameters
    ----------
    kind : {"halfnormal", "logistic", "hazard"}
        halfnormal: p = p0' exp(-d^2 / (2 scale^2)), equation 3;
        logistic: logit p = logit p0 + shift - d / scale, equation 4 with alpha_0 = logit p0 and
        alpha_1 = -1 / scale;
        hazard: p = p0' (1 - exp(-(d / scale)^-shape)), equation 5 where p0 = 1 (its theta is
        shape / 2, its sigma scale^2).
        p0' = sigmoid(logit p0 + shift).
    distance : (S, K) array
        Distance, m; 0 is allowed.
    p0 : () or (S, K)
        Probability at the receiver, in (0, 1].
    scale : () or (S, K)
        Scale of the curve, m.
    shape : () or (S, K)
        Exponent of the hazard curve, and of no other.
    shift : (S, K) array, optional
        Added on the linear predictor; see `linear_shift`.

    Returns
    -------
    log_p, log_miss : (S, K) arrays
        Finite, with finite derivatives of any order in everything.

    Raises
    ------
    ValueError
        If the kind is unknown, or a shape is given where there is none, or missing.

    Notes
    -----
    Every p is multiplied by ``CAP`` = 1 - 1e-6, so that log(1 - p) stays finite. The logistic and
    the hazard curve have a cusp at d = 0, where a path's posterior would have a needle: their d is
    sqrt(d^2 + (scale / 10)^2), .005 scale more than d at a distance of one scale.
    """
    linear, factor = curve(kind, jnp.asarray(distance) ** 2, p0, scale, shape, shift)
    log_p = linear if factor is None else linear + jnp.log(factor)
    return log_p, log_miss(linear, factor)


def linear_shift(covariates=None, coefficients=None, effects=None, receiver=None) -> Array | None:
    """Shift (S, K) of the linear predictor by covariates and by receivers' own effects.

    Parameters
    ----------
    covariates : (S, K, C) array, optional
        Standardised covariates at each state and receiver.
    coefficients : (C,) array, optional
        Their coefficients; None: covariates do nothing.
    effects : (J,) array, optional
        An effect for each deployment.
    receiver : (S, K) int array, optional
        Deployment of each column; needed with ``effects``.

    Returns
    -------
    (S, K) array, or None where nothing shifts
    """
    shift = None if coefficients is None else covariates @ coefficients
    if effects is None:
        return shift
    own = jnp.asarray(effects)[receiver]
    return own if shift is None else shift + own


class Encounters(dist.Distribution):
    """Encounter histories of S pings at K receivers.

    P(heard by nobody) = p_lost + (1 - p_lost) prod(1 - p) over the receivers that listened;
    P(y) = (1 - p_lost) prod p^y (1 - p)^(1 - y) for every other history y.

    Use `encounters` to make one from positions; directly, any curve of your own will do.

    Parameters
    ----------
    linear : (S, K) array; with ``log_weight`` (Q, S, K), or what broadcasts to it
        Log probability of hearing the ping, less ``log(factor)``; at most log `CAP` in all.
    listening : (S, K) bool array
        Which receivers were there and on.
    factor : array like ``linear``, optional
        A part of the probability whose log is taken for products only; None = 1.
    p_lost : () or (S,), optional
        Probability that a ping is lost to every receiver at once; None: 0.
    log_weight : (Q,) array, optional
        Log weights of a mixture along the first axis of ``linear``: pings that differ.

    Notes
    -----
    Batch shape (S,), event shape (K,). ``local`` tells the engine that each ping's density depends
    on one state of the path.
    """

    local = True
    arg_constraints: Any = {}
    support: Any = constraints.independent(constraints.boolean, 1)
    pytree_data_fields = ("linear", "listening", "factor", "p_lost", "log_weight")

    def __init__(
        self,
        linear: Array,
        listening: Bool[Numbers, "S K"],
        factor: Array | None = None,
        p_lost: Any = None,
        log_weight: Float[Array, " Q"] | None = None,
        *,
        validate_args=None,
    ) -> None:
        self.linear, self.listening, self.factor = linear, jnp.asarray(listening), factor
        self.log_weight = log_weight
        shape = self.listening.shape
        self.p_lost = None if p_lost is None else jnp.broadcast_to(p_lost, shape[:-1])
        super().__init__(shape[:-1], shape[-1:], validate_args=validate_args)

    def _probability(self):
        p = jnp.exp(self.linear)
        return p if self.factor is None else p * self.factor

    def _mixed(self, log_density):
        """Log of the mixture over the first axis."""
        if self.log_weight is None:
            return log_density
        weight = self.log_weight.reshape((-1,) + (1,) * (log_density.ndim - 1))
        return jax.nn.logsumexp(log_density + weight, axis=0)

    def _silent(self, log_density):
        """Log probability that nobody hears a ping that may have been lost."""
        if self.p_lost is None:
            return log_density
        lost = jnp.broadcast_to(self.p_lost, log_density.shape)
        return jnp.log(lost + (1 - lost) * jnp.exp(jnp.maximum(log_density, _LEAST)))

    @property
    def log_unheard(self) -> Float[Array, " S"]:
        """Log probability that a ping sent at each state is heard by nobody, (S,)."""
        miss = _where(self.listening, 1 - self._probability(), 1.0)
        return self._silent(self._mixed(log_product(miss)))

    @property
    def log_heard(self) -> Float[Array, " S"]:
        """Log probability that somebody hears a ping sent at each state, (S,).

        Far from every receiver, where the chance of silence rounds to 1, it is the sum of the
        receivers' chances.
        """
        log_p = self.linear if self.factor is None else self.linear + jnp.log(self.factor)
        heard = _where(self.listening, log_p, -jnp.inf)
        far = self._mixed(jax.nn.logsumexp(jnp.maximum(heard, -1e6), axis=-1))
        miss = _where(self.listening, 1 - self._probability(), 1.0)
        silent = self._mixed(log_product(miss))
        near = silent < -1e-6
        some = jnp.where(near, jnp.log(-jnp.expm1(jnp.where(near, silent, -1.0))), far)
        return some if self.p_lost is None else some + jnp.log1p(-self.p_lost)

    def log_prob(self, value: Bool[Numbers, "*N S K"]) -> Array:
        """Log probability of histories ``value`` (..., S, K), shape (..., S)."""
        heard = jnp.asarray(value, bool)
        several = jnp.ndim(heard) - len(self.batch_shape) - 1
        lead = (None,) * several

        def led(x):
            return x[lead] if self.log_weight is None else x[:, *lead]

        miss = led(1 - self._probability())
        hit = 1.0 if self.factor is None else led(self.factor)
        seen = _where(self.listening[lead], _where(heard, hit, miss), 1.0)
        total = log_product(seen) + jnp.sum(_where(heard, led(self.linear), 0.0), axis=-1)
        total = self._mixed(total)
        if self.p_lost is None:
            return total
        lost = jnp.broadcast_to(self.p_lost, total.shape)
        return jnp.where(heard.any(axis=-1), total + jnp.log1p(-lost), self._silent(total))

    def sample(self, key: Array, sample_shape=()):
        """Draw histories, bool, shape ``sample_shape + (S, K)``."""
        key_ping, key_node, key_lost = jax.random.split(key, 3)
        shape = self.shape(sample_shape)
        p = _where(self.listening, self._probability(), 0.0)
        if self.log_weight is not None:
            node = jax.random.categorical(key_node, self.log_weight, shape=shape[:-1])
            state = jnp.broadcast_to(jnp.arange(p.shape[1]), node.shape)
            p = p[node, state]
        heard = jax.random.uniform(key_ping, shape) < jnp.broadcast_to(p, shape)
        if self.p_lost is None:
            return heard
        lost = jax.random.uniform(key_lost, shape[:-1]) < jnp.broadcast_to(self.p_lost, shape[:-1])
        return heard & ~lost[..., None]

    @property
    def mean(self) -> Float[Array, "S K"]:
        """Probability that each receiver hears the ping, (S, K)."""
        p = self._probability()
        if self.log_weight is not None:
            p = jnp.tensordot(jnp.exp(self.log_weight), p, 1)
        p = jnp.where(self.listening, p, 0.0)
        return p if self.p_lost is None else p * (1 - self.p_lost[..., None])


def _where(condition, yes, no):
    """`jnp.where` whose arrays differ in leading axes only (the mixture's, several histories)."""
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in (condition, yes, no)))
    full = [
        x if jnp.ndim(x) == 0 else jnp.broadcast_to(x, shape)
        for x in (jnp.asarray(condition), yes, no)
    ]
    return jnp.where(*full)


def encounters(
    kind: str,
    position: Float[Numbers, "S 2"],
    near_xy: Float[Numbers, "S K 2"],
    listening: Bool[Numbers, "S K"],
    p0,
    scale,
    shape=None,
    *,
    shift: Float[Numbers, "S K"] | None = None,
    p_lost=None,
    dispersion=None,
    squared: Callable[..., Array] = squared_distance,
) -> Encounters:
    """The law of who hears pings sent at these positions.

    Parameters
    ----------
    kind : {"halfnormal", "logistic", "hazard"}
        Detection function, see `log_probabilities`.
    position : (S, 2) array
        Where the pings are sent, m.
    near_xy : (S, K, 2) array
        The receivers considered at each, m.
    listening : (S, K) bool array
        Which of them were there and on.
    p0, scale, shape : ()
        Parameters of the curve; ``shape`` for the hazard curve only.
    shift : (S, K) array, optional
        Shift of the linear predictor, see `linear_shift`.
    p_lost : () or (S,), optional
        Probability that a ping is lost to every receiver at once.
    dispersion : (), optional
        Standard deviation of a normal shift of the linear predictor that all receivers of a ping
        share; integrated out by Gauss-Hermite quadrature with 15 nodes.
    squared : callable
        ``squared(position (S, 2), near_xy (S, K, 2))`` -> squared effective distance (S, K), m2;
        Euclidean by default. Squares have slopes at 0; a distance has none.

    Returns
    -------
    Encounters
        Batch shape (S,), event shape (K,).

    Raises
    ------
    ValueError
        See `log_probabilities`.

    Examples
    --------
    A wall along x = 0 that doubles the distance across it, over a width of 20 m:

    >>> def across(position, near_xy):
    ...     side = jax.nn.sigmoid(position[:, :1] / 5), jax.nn.sigmoid(near_xy[..., 0] / 5)
    ...     apart = side[0] * (1 - side[1]) + (1 - side[0]) * side[1]
    ...     return squared_distance(position, near_xy) * (1 + apart) ** 2
    """
    listening = jnp.asarray(listening)
    far = squared(jnp.asarray(position), jnp.asarray(near_xy))
    if dispersion is None:
        linear, factor = curve(kind, far, p0, scale, shape, shift)
        return Encounters(linear, listening, factor, p_lost)
    node, weight = np.polynomial.hermite_e.hermegauss(_NODES)
    own = dispersion * jnp.asarray(node)[:, None, None]
    linear, factor = curve(
        kind, far[None], p0, scale, shape, own if shift is None else own + shift[None]
    )
    return Encounters(linear, listening, factor, p_lost, jnp.log(weight / weight.sum()))
