"""Linear algebra of two to four unknowns by hand: SIMD over pings, no LAPACK call a ping.

Every function works on arrays whose *leading* axes are the small ones; what follows is a batch.
"""

from __future__ import annotations

from typing import Any

from maloc._jax import jnp

__all__ = ["cross", "dot", "solve", "under_determined"]


def dot(a: Any, b: Any) -> Any:
    """Inner product over the leading axis."""
    return sum(a[i] * b[i] for i in range(len(a)))


def cross(rows: list) -> Any:
    """Vector v (n, ...) orthogonal to n - 1 rows, with v . u = det[rows, u] (n = 2, 3, 4)."""
    if len(rows) == 1:
        (a,) = rows
        return jnp.stack([-a[1], a[0]])
    if len(rows) == 2:
        a, b = rows
        return jnp.stack(
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        )
    a, b, c = rows
    out = []
    for skip in range(4):
        i, j, k = (n for n in range(4) if n != skip)
        minor = (
            a[i] * (b[j] * c[k] - b[k] * c[j])
            - a[j] * (b[i] * c[k] - b[k] * c[i])
            + a[k] * (b[i] * c[j] - b[j] * c[i])
        )
        out.append(minor if skip % 2 else -minor)
    return jnp.stack(out)


def under_determined(rows: list, right: list) -> tuple[Any, Any, Any]:
    """Solutions w + alpha v of n - 1 equations in n unknowns, without the SVD.

    Parameters
    ----------
    rows : list of array (n, ...)
        n - 1 rows of the matrix.
    right : list of array (...)
        Right-hand sides.

    Returns
    -------
    w : array (n, ...)
        The solution of least norm.
    v : array (n, ...)
        The null vector, of length 1.
    volume : array (...)
        Volume spanned by the rows after scaling each to length 1: 0 where they are dependent.
    """
    size = [jnp.sqrt(dot(a, a)) for a in rows]
    safe = [jnp.where(s > 0, s, 1.0) for s in size]
    rows = [a / s[None] for a, s in zip(rows, safe, strict=True)]
    right = [b / s for b, s in zip(right, safe, strict=True)]
    null = cross(rows)
    square = dot(null, null)
    regular = square > 1e-20
    safe_square = jnp.where(regular, square, 1.0)
    n = len(rows) + 1
    w = jnp.zeros_like(null)
    for i in range(n - 1):
        others = [a for j, a in enumerate(rows) if j != i]
        # the dual of row i: row i times it is |v|^2, the other rows and v times it are 0
        dual = cross([*others, null])
        sign = 1.0 if (n - i) % 2 else -1.0
        w = w + (sign * right[i] / safe_square)[None] * dual
    volume = jnp.sqrt(square)
    return w, null / jnp.sqrt(safe_square)[None], jnp.where(regular, volume, 0.0)


def solve(a: Any, b: Any) -> Any:
    """Solution of a symmetric system (n, n, ...) x = (n, ...), n = 2 or 3; inf where singular."""
    if len(b) == 2:
        det = a[0, 0] * a[1, 1] - a[0, 1] ** 2
        return (
            jnp.stack([a[1, 1] * b[0] - a[0, 1] * b[1], a[0, 0] * b[1] - a[0, 1] * b[0]])
            / det[None]
        )
    c0, c1, c2 = cross([a[1], a[2]]), cross([a[2], a[0]]), cross([a[0], a[1]])
    det = dot(a[0], c0)
    return (c0 * b[0][None] + c1 * b[1][None] + c2 * b[2][None]) / det[None]
