"""What the engine asks of an arrival law; public as `maloc.arrival.ArrivalError`."""

from __future__ import annotations

from typing import Any

import numpyro.distributions as dist
from numpyro.distributions import constraints

from maloc._jax import jax, jnp

__all__ = ["ArrivalError"]


class ArrivalError(dist.Distribution):
    """A density of arrivals, and what the engine asks of it beyond a distribution.

    A subclass has ``loc`` (the predicted arrival), ``log_prob``, ``widened`` and
    ``direct_curvature``; what it knows better than these defaults it overrides.
    """

    support: Any = constraints.real
    loc: Any

    def widened(self, scale) -> ArrivalError:
        """The same law with a direct scale of at least ``scale``, for annealing: itself here."""
        return self

    def direct_curvature(self, value):
        """Curvature (>= 0) of the direct arrival's part in ``-log_prob``.

        That of the whole, where positive, unless a law knows better.
        """
        return jnp.maximum(-self._second(value), 0.0)

    def robust_curvature(self, value):
        """Curvature of the surrogate that iteratively reweighted least squares (EM) minimises.

        Never below that of ``-log_prob``; shape of the broadcast value, 1 / unit^2.
        """
        return self.direct_curvature(value)

    def curvature(self, value, floor=0.1):
        """Non-negative curvature of ``-log_prob`` in the residual, for Gauss-Newton steps.

        The second derivative where it is above ``floor`` times `direct_curvature`, else that;
        shape of the broadcast value, 1 / unit^2.
        """
        return jnp.maximum(-self._second(value), floor * self.direct_curvature(value))

    def p_direct(self, value):
        """Posterior probability that the arrival came by the direct path: 1 here."""
        return jnp.ones(jnp.broadcast_shapes(jnp.shape(value), self.batch_shape))

    def _second(self, value):
        """Second derivative of ``log_prob`` in the value, elementwise."""
        value = jnp.asarray(value, float)
        value = jnp.broadcast_to(value, jnp.broadcast_shapes(value.shape, self.batch_shape))
        ones = jnp.ones_like(value)

        def slope(v):
            return jax.jvp(self.log_prob, (v,), (ones,))[1]

        return jax.jvp(slope, (value,), (ones,))[1]

    @property
    def mean(self):
        """Mean."""
        return jnp.broadcast_to(self.loc, self.batch_shape)
