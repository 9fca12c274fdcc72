"""Student kernels of population Monte Carlo, in coordinates and emission at once.

Matrices are lists of rows whose elements are arrays over kernels: sizes are 3 or 4, and a LAPACK
call a kernel would cost more than everything else.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from maloc._jax import jax, jnp

__all__ = ["Kernels", "cholesky", "draw", "log_density", "solve_cholesky"]

_DF = 4  # tails heavier than any posterior's; the chi square of 4 is two uniforms


class Kernels(NamedTuple):
    """K multivariate Student laws (4 degrees of freedom).

    Attributes
    ----------
    centre : array (n, K)
        Coordinates and emission's range, m.
    root : list of lists of array (K,)
        Lower Cholesky factor of the inverse of the scale matrix, 1/m.
    """

    centre: Any
    root: list


def cholesky(a: list) -> list:
    """Lower factor of symmetric positive definite matrices, as rows of arrays."""
    n = len(a)
    root: list[list] = [[None] * n for _ in range(n)]
    for j in range(n):
        square = a[j][j] - sum(root[j][k] ** 2 for k in range(j))
        root[j][j] = jnp.sqrt(jnp.maximum(square, 1e-12 * a[j][j]))
        for i in range(j + 1, n):
            left = a[i][j] - sum(root[i][k] * root[j][k] for k in range(j))
            root[i][j] = left / root[j][j]
    return root


def _backward(root: list, b: Any) -> Any:
    """Solve transpose(root) x = b, b (n, ...)."""
    n = len(root)
    out: list = [None] * n
    for i in reversed(range(n)):
        out[i] = (b[i] - sum(root[k][i] * out[k] for k in range(i + 1, n))) / root[i][i]
    return jnp.stack(out)


def solve_cholesky(root: list, b: Any) -> Any:
    """Solve root transpose(root) x = b, b (n, ...)."""
    half: list = []
    for i in range(len(root)):
        half.append((b[i] - sum(root[i][k] * half[k] for k in range(i))) / root[i][i])
    return _backward(root, half)


def draw(kernels: Kernels, uniform: Any) -> Any:
    """Draws (n, N) of the kernels in turn: N / K of the first, and so on.

    Parameters
    ----------
    kernels : Kernels
    uniform : array (n + 2, N)
        Uniform on (0, 1).
    """
    n, k = kernels.centre.shape
    # single precision is enough for a proposal: weights are of the places drawn
    uniform = jnp.clip(uniform.astype(jnp.float32), 1e-7, 1 - 1e-7)
    chi2 = -2 * jnp.log(uniform[n] * uniform[n + 1])
    noise = 1.4142135 * jax.lax.erf_inv(2 * uniform[:n] - 1) * jnp.sqrt(_DF / chi2)[None]
    noise = noise.astype(float).reshape(n, k, -1)
    root = [[None if e is None else e[:, None] for e in row] for row in kernels.root]
    return (kernels.centre[:, :, None] + _backward(root, noise)).reshape(n, -1)


def log_density(kernels: Kernels, place: Any, own: int = 0) -> Any:
    """Log density of draws (n, N): of the mixture of all K kernels, or of each draw's own.

    Parameters
    ----------
    kernels : Kernels
    place : array (n, N)
        Metres.
    own : int
        Draws a kernel, in the order of `draw`: each draw's own kernel alone. 0: the mixture.
    """
    n, k = kernels.centre.shape
    # the mixture's sum is most of the work: single precision, around one of the centres
    around = kernels.centre[:, :1]
    centre = (kernels.centre - around).astype(jnp.float32)
    place = (place - around).astype(jnp.float32)
    root = [[None if e is None else e.astype(jnp.float32) for e in row] for row in kernels.root]
    if own:
        centre = jnp.repeat(centre, own, axis=1)
        root = [[None if e is None else jnp.repeat(e, own) for e in row] for row in root]
        density = _density(place, centre, root)
    else:

        def add(total: Any, one: tuple) -> tuple:
            return total + _density(place, one[0][:, None], one[1]), None

        # kernel by kernel, so that each step is a plain loop over particles
        start = jnp.zeros(place.shape[1], jnp.float32)
        density, _ = jax.lax.scan(add, start, (centre.T, root))
        density = density / k
    peak = math.gamma((_DF + n) / 2) / (math.gamma(_DF / 2) * (_DF * math.pi) ** (n / 2))
    return jnp.log(jnp.maximum(density.astype(float), 1e-45)) + math.log(peak)


def _density(place: Any, centre: Any, root: list) -> Any:
    """Student density up to its peak's constant."""
    n = len(root)
    offset = [place[i] - centre[i] for i in range(n)]
    # transpose(root) (place - centre)
    z = [sum(root[j][i] * offset[j] for j in range(i, n)) for i in range(n)]
    height = root[0][0]
    for i in range(1, n):
        height = height * root[i][i]
    square = jnp.minimum(1 + sum(y**2 for y in z) / _DF, 1e9)
    return height / (square**4 if n == 4 else square**3 * jnp.sqrt(square))
