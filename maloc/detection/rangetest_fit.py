"""The fit of a range test: posterior mode, its curvature, draws."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.special import expit

from maloc._jax import jax, jnp
from maloc.detection import encounters, linear_shift

__all__ = ["Problem", "mode", "names", "natural", "nuts", "prior", "unheard"]

PRIORS = {"shape": (math.log(3.0), 0.5), "p_lost": (-2.0, 1.5), "p0": (0.0, 2.0)}
_COEFFICIENT = "coefficient"


class Problem(NamedTuple):
    """What is static in a fit: compiled functions are made for it."""

    kind: str
    names: tuple[str, ...]
    conditional: bool


def names(kind: str, n_covariates: int, loss: bool) -> list[str]:
    """Names of the unconstrained parameters, in order; a coefficient has a name each."""
    shape = ["shape"] if kind == "hazard" else []
    lost = ["p_lost"] if loss else []
    return ["p0", "scale", *shape, *lost, *[_COEFFICIENT] * n_covariates]


def prior(names, log_distance: float):
    """Mean and standard deviation (k,) of the normal prior on the unconstrained scale."""
    known = {**PRIORS, "scale": (log_distance, 1.5), _COEFFICIENT: (0.0, 2.0)}
    both = np.array([known[name] for name in names])
    return both[:, 0], both[:, 1]


def natural(names, flat) -> dict[str, np.ndarray]:
    """Draws (D, k) by name, on the natural scale."""
    out = {}
    for i, name in enumerate(names):
        if name != _COEFFICIENT:
            out[name] = (expit if name in ("p0", "p_lost") else np.exp)(flat[:, i])
    if _COEFFICIENT in names:
        out[_COEFFICIENT] = flat[:, names.index(_COEFFICIENT) :]
    return out


def _law(problem: Problem, u, data):
    """Encounter law of all pings at unconstrained parameters u."""
    near, on, _, x = data
    own = dict(zip(problem.names, u, strict=True))
    coefficients = None
    if _COEFFICIENT in problem.names:
        coefficients = u[problem.names.index(_COEFFICIENT) :]
    shape = jnp.exp(own["shape"]) if "shape" in own else None
    lost = jax.nn.sigmoid(own["p_lost"]) if "p_lost" in own else None
    return encounters(
        problem.kind, jnp.zeros((near.shape[0], 2)), near, on,
        jax.nn.sigmoid(own["p0"]), jnp.exp(own["scale"]), shape,
        shift=linear_shift(x, coefficients), p_lost=lost,
    )  # fmt: skip


def _energy(problem: Problem, u, middle, spread, data):
    """Negative log posterior, up to a constant."""
    law = _law(problem, u, data)
    log_prob = law.log_prob(data[2])
    if problem.conditional:
        # log(1 - unheard); unheard is below 1 by the smallest number where all is out of reach
        log_prob -= jnp.log(jnp.maximum(-jnp.expm1(law.log_unheard), 1e-300))
    return 0.5 * jnp.sum(((u - middle) / spread) ** 2) - jnp.sum(log_prob)


_value = jax.jit(jax.value_and_grad(_energy, argnums=1), static_argnums=0)
_curvature = jax.jit(jax.hessian(_energy, argnums=1), static_argnums=0)


def mode(problem: Problem, middle, spread, data):
    """Posterior mode (k,) and inverse curvature (k, k); NaN where it is no maximum."""
    found = optimize.minimize(
        lambda u: tuple(np.asarray(part) for part in _value(problem, u, middle, spread, data)),
        middle,
        jac=True,
        hess=lambda u: np.asarray(_curvature(problem, u, middle, spread, data)),
        method="trust-exact",
        options={"gtol": 1e-6 * data[0].shape[0] ** 0.5},
    )
    curvature = np.asarray(_curvature(problem, found.x, middle, spread, data))
    if not np.all(np.isfinite(curvature)) or np.linalg.eigvalsh(curvature)[0] <= 0:
        return found.x, np.full_like(curvature, np.nan)
    return found.x, np.linalg.inv(curvature)


def nuts(problem: Problem, mode, covariance, middle, spread, data, draws: int, seed: int):
    """Draws (D, k) by NUTS, whitened by the Laplace approximation."""
    from numpyro.infer import MCMC, NUTS

    root = jnp.asarray(np.linalg.cholesky(covariance))

    def potential(z):
        return _energy(problem, mode + root @ z, middle, spread, data)

    chain = MCMC(
        NUTS(potential_fn=potential), num_warmup=300, num_samples=draws, progress_bar=False
    )
    chain.run(jax.random.key(seed), init_params=jnp.zeros(len(mode)))
    return mode + np.asarray(chain.get_samples()) @ np.asarray(root).T


@functools.partial(jax.jit, static_argnums=0)
def _mean_unheard(problem: Problem, u, data):
    return jnp.mean(jnp.exp(_law(problem, u, data).log_unheard))


def unheard(problem: Problem, mode, data) -> float:
    """Share of pings that nobody hears; of all sent, also where only heard ones are known."""
    if not problem.conditional:
        return float(_mean_unheard(problem, mode, data))
    # each heard ping stands for 1 / P(heard) sent from its place
    heard = 1 - np.exp(np.asarray(_law(problem, jnp.asarray(mode), data).log_unheard))
    return float(1 - len(heard) / np.sum(1 / heard))
