"""Population Monte Carlo of one ping: place and emission drawn, weighted, drawn anew.

The emission is drawn together with the place. Given the place its posterior is as narrow as the
arrivals' error, and a kernel shaped like the posterior there (place and emission at once) costs a
third of the effective sample; summing over it on a grid would cost every arrival of every particle
several times, and profiling it out would not give the posterior.
"""

from __future__ import annotations

from copy import copy
from typing import Any

from maloc._jax import jax, jnp
from maloc.points._kernels import Kernels, cholesky, draw, log_density, solve_cholesky
from maloc.points._prior import Prior, log_prior
from maloc.points._problem import Problem
from maloc.points._robust import hypotheses

__all__ = ["population"]

_SETS = 40  # minimal sets that give starting places
_POWER = 0.5  # of the weights by which the first kernels are chosen: unlikely places stay in
_NEAR = 1e-6  # m^2; a receiver is no point where slopes end
_FAR = 6.0  # local standard deviations beyond which a particle belongs to another place


def _errors(ping: Problem, z: Any) -> tuple[Any, list]:
    """Residuals (M, N) m of places and emissions (d + 1, N), and their slopes, d of (M, N)."""
    d = len(z) - 1
    offset = [z[i][None] - ping.place[:, i, None] for i in range(d)]
    square = sum(o**2 for o in offset)
    if d == 2:
        square = square + ping.place[:, 2, None] ** 2
    distance = jnp.sqrt(square + _NEAR)
    slope = [o / distance for o in offset]
    return ping.range[:, None] - z[d][None] - distance, slope


def _log_target(ping: Problem, law: Any, prior: Prior, z: Any) -> Any:
    """Log posterior (N,) up to a constant."""
    x, sent = z[:-1], z[-1]

    def add(total: Any, one: Problem) -> tuple:
        square = sum((x[i] - one.place[i]) ** 2 for i in range(len(x)))
        if len(x) == 2:
            square = square + one.place[2] ** 2
        error = one.range - sent - jnp.sqrt(square + _NEAR)
        return total + jnp.where(one.heard, _with_sigma(law, one.sigma).log_prob(error), 0.0), None

    # arrival by arrival, so that each step is a plain loop over particles
    return jax.lax.scan(add, log_prior(prior, [*x]), ping)[0]


def _with_sigma(law: Any, sigma: Any) -> Any:
    """The law, with the arrivals' standard deviations where it has none of its own (NaN)."""
    own = copy(law)
    if hasattr(law, "sigma"):
        own.sigma = jnp.where(jnp.isnan(law.sigma), sigma, law.sigma)
    return own


def _information(ping: Problem, law: Any, prior: Prior, z: Any, span: Any) -> tuple[list, Any]:
    """Curvature that the direct arrivals give (rows of arrays), and the slope (d + 1, K)."""
    n = len(z)
    error, slope = _errors(ping, z)
    heard = ping.heard[:, None]
    ones = jnp.ones_like(error)
    law = _with_sigma(law, ping.sigma[:, None])
    _, force = jax.jvp(law.log_prob, (error,), (ones,))
    force = jnp.where(heard, force, 0.0)
    weight = jnp.where(heard, law.direct_curvature(error), 0.0)
    slope = [*slope, ones]
    gradient = jnp.stack([-jnp.sum(force * s, axis=0) for s in slope])
    pull = jax.grad(lambda x: jnp.sum(log_prior(prior._replace(region=jnp.zeros((0, 2))), [*x])))
    gradient = gradient.at[:-1].add(pull(z[:-1]))
    rows: list[list] = [[None] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            rows[i][j] = jnp.sum(weight * slope[i] * slope[j], axis=0)
        # where the arrivals leave a direction open, the kernel spans a part of the array
        rows[i][i] = rows[i][i] + 1 / span**2
    return rows, gradient


def _climb(ping: Problem, law: Any, prior: Prior, z: Any, span: Any) -> Any:
    """One step of robust least squares towards the nearest mode, no longer than `span`."""
    rows, gradient = _information(ping, law, prior, z, span)
    step = solve_cholesky(cholesky(rows), gradient)
    length = jnp.sqrt(jnp.sum(step[:-1] ** 2, axis=0))
    step = step * jnp.minimum(1.0, span / jnp.maximum(length, 1e-9))[None]
    return z + jnp.where(jnp.isfinite(step), step, 0.0)


def _resampled(z: Any, weight: Any, uniform: Any, k: int) -> Any:
    """K of the particles (n, N), by systematic resampling with weights (N,)."""
    total = jnp.cumsum(weight)
    at = (jnp.arange(k) + uniform) / k * total[-1]
    return z[:, jnp.minimum(jnp.searchsorted(total, at), len(weight) - 1)]


def population(
    ping: Problem,
    shift: Any,
    law: Any,
    prior: Prior,
    start: Any,
    base: Any,
    span: Any,
    width: Any,
    *,
    d: int,
    kernels: int,
    mixture: bool,
    keep: bool,
) -> tuple[dict, dict]:
    """Posterior of one ping.

    Parameters
    ----------
    ping : Problem
        One ping.
    shift : array (iterations, d + 4)
        Uniform on (0, 1): all that is random. d + 3 shift the base points, the last resamples.
    law : ArrivalError
        Law of residuals, m, around 0; a sigma of NaN stands for that of each arrival.
    prior : Prior
    start : array (N0, d)
        Starting places; those of minimal sets are added.
    base : array (d + 3, n_particles)
        Evenly spread in the unit cube, for all pings; shifted at random they are each uniform.
    span : array ()
        Kernel's standard deviation in a direction that the arrivals leave open, m.
    width : array ()
        Kernel's standard deviation in those of the local posterior.
    d, kernels : int
    mixture : bool
        Weights by the mixture of all kernels, or by each particle's own.
    keep : bool
        Return particles and weights of the last iteration.
    """
    each = base.shape[1] // kernels
    # the scale matrix of a Student law with 4 degrees of freedom is half of its covariance
    scale = width / jnp.sqrt(2.0)
    z = _first(ping, start, d)
    z = jax.lax.fori_loop(0, 2, lambda _, z: _climb(ping, law, prior, z, span), z)
    log_weight = _log_target(ping, law, prior, z)
    rows, _ = _information(ping, law, prior, z, span)
    root = cholesky(rows)
    log_weight = log_weight - sum(jnp.log(root[i][i]) for i in range(d + 1))
    log_weight = jnp.where(jnp.isfinite(log_weight), log_weight, -jnp.inf)
    weight = jnp.exp(_POWER * (log_weight - jnp.max(log_weight)))
    centre = _resampled(z, weight, 0.5, kernels)

    def iterate(carry: tuple, shift: Any) -> tuple:
        centre = _climb(ping, law, prior, carry[0], span)
        rows, _ = _information(ping, law, prior, centre, span)
        root = [[None if e is None else e / scale for e in row] for row in cholesky(rows)]
        made = Kernels(centre, root)
        z = draw(made, (base + shift[:-1, None]) % 1.0)
        proposal = log_density(made, z, 0 if mixture else each)
        log_target = _log_target(ping, law, prior, z)
        log_weight = log_target - proposal
        log_weight = jnp.where(jnp.isnan(log_weight), -jnp.inf, log_weight)
        top = jnp.maximum(jnp.max(log_weight), -1e300)
        weight = jnp.exp(log_weight - top)
        return (_resampled(z, weight, shift[-1], kernels), z, log_target, weight, top), None

    shape = (kernels * each,)
    nothing = jnp.zeros(shape)
    carry = (centre, jnp.zeros((d + 1, *shape)), nothing, nothing, jnp.zeros(()))
    carry, _ = jax.lax.scan(iterate, carry, shift)
    return _summary(ping, law, prior, *carry[1:], span, keep)


def _first(ping: Problem, start: Any, d: int) -> Any:
    """Starting places and emissions (d + 1, N0)."""
    position, emission, _ = hypotheses(ping, d, _SETS)
    # each in turn is taken to be direct
    arrival = jnp.arange(len(start)) % jnp.sum(ping.heard)
    free = start.T
    place = ping.place[arrival]
    square = sum((free[i] - place[:, i]) ** 2 for i in range(d))
    if d == 2:
        square = square + place[:, 2] ** 2
    sent = ping.range[arrival] - jnp.sqrt(square)
    z = jnp.concatenate(
        [
            jnp.concatenate([position, emission[None]]),
            jnp.concatenate([free, sent[None]]),
        ],
        axis=1,
    )
    # where a minimal set has no root, a copy of a starting place
    spare = jnp.take(z, emission.shape[0] + jnp.arange(z.shape[1]) % len(start), axis=1)
    return jnp.where(jnp.all(jnp.isfinite(z), axis=0)[None], z, spare)


def _summary(
    ping: Problem,
    law: Any,
    prior: Prior,
    z: Any,
    log_target: Any,
    weight: Any,
    top: Any,
    span: Any,
    keep: bool,
) -> tuple:
    """Moments, sets and shares of the last population."""
    total = jnp.sum(weight)
    alive = jnp.isfinite(total) & (total > 0) & (top > -1e299)
    weight = weight / jnp.where(alive, total, 1.0)
    d = len(z) - 1
    best, other, far = _two_modes(ping, law, prior, z, log_target, weight, span)
    near = jnp.where(far, 0.0, weight)
    place = jnp.sum(near[None] * z, axis=1) / jnp.maximum(jnp.sum(near), 1e-300)
    offset = z[:d] - place[:d, None]
    covariance = jnp.sum(weight[None, None] * offset[:, None] * offset[None], axis=2)
    ridge = covariance + 1e-12 * jnp.trace(covariance) * jnp.eye(d) + 1e-12 * jnp.eye(d)
    root = cholesky([[ridge[i, j] for j in range(i + 1)] for i in range(d)])
    squared = jnp.sum(offset * solve_cholesky(root, offset), axis=0)
    level = jnp.asarray([0.025] * d + [0.975] * d + [0.95])
    bounds = _quantile(jnp.concatenate([z[:d], z[:d], squared[None]]), weight, level)
    error, _ = _errors(ping, z)
    direct = _with_sigma(law, ping.sigma[:, None]).p_direct(error)
    values = {
        "position": place[:d],
        "emission": place[d],
        "mean": jnp.sum(weight[None] * z[:d], axis=1),
        "covariance": covariance,
        "ess": 1 / jnp.maximum(jnp.sum(weight**2), 1e-300),
        "alive": alive,
        "log_evidence": top + jnp.log(jnp.maximum(total, 1e-300) / len(weight)),
        "lo": bounds[:d],
        "hi": bounds[d : 2 * d],
        "radius": bounds[2 * d],
        "mode": best,
        "other": other,
        "other_share": jnp.sum(jnp.where(far, weight, 0.0)),
    }
    if keep:
        values |= {"particles": z, "weights": weight}
    return values, {
        "p_reflected": jnp.sum(weight[None] * (1 - direct), axis=1),
        "direct_square": jnp.sum(weight[None] * direct * error**2, axis=1),
    }


def _quantile(value: Any, weight: Any, level: Any) -> Any:
    """Weighted quantiles (Q,) of rows of values (Q, N), by bisection; weights sum to 1."""

    def halve(_: Any, bounds: tuple) -> tuple:
        low, high = bounds
        middle = 0.5 * (low + high)
        below = jnp.sum(jnp.where(value <= middle[:, None], weight[None], 0.0), axis=1) < level
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    some = weight[None] > 0
    low = jnp.min(jnp.where(some, value, jnp.inf), axis=1)
    high = jnp.max(jnp.where(some, value, -jnp.inf), axis=1)
    return jax.lax.fori_loop(0, 20, halve, (low, high))[1]


def _two_modes(
    ping: Problem, law: Any, prior: Prior, z: Any, log_target: Any, weight: Any, span: Any
) -> tuple[Any, Any, Any]:
    """The most probable place (d,), the one outside its reach, and which are outside (N,)."""
    log_target = jnp.where(weight > 0, log_target, -jnp.inf)
    best = z[:, jnp.argmax(log_target), None]
    rows, _ = _information(ping, law, prior, best, span)
    root = cholesky(rows)
    n = len(z)
    offset = z - best
    along = [sum(root[j][i] * offset[j] for j in range(i, n)) for i in range(n)]
    outside = sum(a**2 for a in along) > _FAR**2
    second = jnp.argmax(jnp.where(outside, log_target, -jnp.inf))
    return best[: n - 1, 0], z[: n - 1, second], outside
