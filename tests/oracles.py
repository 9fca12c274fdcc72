"""Slow, dense, obvious answers that the tests compare with. One section a module."""

from __future__ import annotations

import mpmath
import numpy as np

# -- movement ---------------------------------------------------------------------------------


def ctcrw_transition_exact(dt, sigma_vel, beta, digits=80):
    """A12, A22, Q11, Q12, Q22 and Q22 - Q12^2 / Q11 (Johnson et al. 2008) in mpmath."""
    with mpmath.workdps(digits):
        dt, beta = mpmath.mpf(float(dt)), mpmath.mpf(float(beta))
        alpha2 = 2 * beta * mpmath.mpf(float(sigma_vel)) ** 2
        e = mpmath.exp(-beta * dt)
        q11 = alpha2 / beta**2 * (dt - 2 * (1 - e) / beta + (1 - e**2) / (2 * beta))
        q12 = alpha2 / (2 * beta**2) * (1 - 2 * e + e**2)
        q22 = alpha2 / (2 * beta) * (1 - e**2)
        return (1 - e) / beta, e, q11, q12, q22, q22 - q12**2 / q11


def ctcrw_covariance(times, sigma_vel, beta, spread, digits=50):
    """Covariance (2T, 2T) of (x_1..x_T, v_1..v_T), one axis, from the velocity's autocovariance.

    x is its start plus the integral of v, and cov(v_s, v_t) = sigma^2 exp(-beta |t - s|): no
    transition is used. An mpmath matrix: the determinant needs more digits than a double has.
    """
    with mpmath.workdps(digits):
        t = [mpmath.mpf(float(u)) - mpmath.mpf(float(times[0])) for u in times]
        b, var = mpmath.mpf(beta), mpmath.mpf(float(sigma_vel)) ** 2
        n = len(t)

        def xx(s, u):
            s, u = min(s, u), max(s, u)
            area = 2 * b * s + mpmath.exp(-b * s) + mpmath.exp(-b * u) - mpmath.exp(b * (s - u)) - 1
            return mpmath.mpf(spread) ** 2 + var / b**2 * area

        def xv(s, u):  # integral over r in (0, s) of exp(-b |r - u|)
            before = (mpmath.exp(b * (min(s, u) - u)) - mpmath.exp(-b * u)) / b
            after = (1 - mpmath.exp(-b * (s - u))) / b if s > u else 0
            return var * (before + after)

        cov = mpmath.matrix(2 * n, 2 * n)
        for i in range(n):
            for j in range(n):
                cov[i, j] = xx(t[i], t[j])
                cov[i, n + j] = cov[n + j, i] = xv(t[i], t[j])
                cov[n + i, n + j] = var * mpmath.exp(-b * abs(t[i] - t[j]))
        return cov


def normal_log_density(deviation, covariance, digits=50):
    """Log density of a dense multivariate normal in mpmath."""
    with mpmath.workdps(digits):
        root = mpmath.cholesky(covariance)
        z = mpmath.lu_solve(root, mpmath.matrix([mpmath.mpf(float(d)) for d in deviation]))
        log_det = sum(mpmath.log(root[i, i]) for i in range(root.rows))
        squares = sum(v**2 for v in z)
        return float(-squares / 2 - log_det - len(deviation) * mpmath.log(2 * mpmath.pi) / 2)


def as_floats(matrix):
    """An mpmath matrix as a NumPy array."""
    return np.array(matrix.tolist(), dtype=float)


def brownian_covariance(times, sigma, spread):
    """Covariance (T, T) of Brownian motion with an uncertain start, one axis."""
    t = np.asarray(times, float) - times[0]
    return spread**2 + sigma**2 * np.minimum.outer(t, t)
