"""Slow, dense, obvious answers that the tests compare with. One section a module."""

from __future__ import annotations

from fractions import Fraction
from math import comb, factorial

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


# -- arrival -----------------------------------------------------------------------------------


def ddetect_log_density(error, sigma, phi, w, beta, background=0.0, as_float=True):
    """Log of (1 - w) N(e; 0, sigma) + w GN(e; phi/2, phi/2, beta), some background mixed in.

    The background is Student's t with 3 df, centre phi/2 and scale 10 phi. All in mpmath.
    """
    with mpmath.workdps(40):
        e, s, phi, w = (mpmath.mpf(v) for v in (error, sigma, phi, w))
        half, wide, share = phi / 2, 10 * phi, mpmath.mpf(background)
        normal = mpmath.exp(-((e / s) ** 2) / 2) / (s * mpmath.sqrt(2 * mpmath.pi))
        late = beta / (2 * half * mpmath.gamma(mpmath.mpf(1) / beta))
        late *= mpmath.exp(-(abs((e - half) / half) ** beta))
        t = (e - half) / wide
        wild = 2 / (mpmath.pi * mpmath.sqrt(3)) / wide / (1 + t**2 / 3) ** 2
        total = mpmath.log((1 - share) * ((1 - w) * normal + w * late) + share * wild)
        return float(total) if as_float else total


# -- clock synchronisation ----------------------------------------------------------------------


def clocks_dense(recorded, clock, ping, distance, start, knots, reference, sigma, intensity, speed):
    """Clock states and relative slowness by dense least squares, emission times kept as unknowns.

    start (K, R, 2) is the prior's first knot (offset, slope times spacing) and the point to
    linearise at first; speed = (mean, sd) of the sound speed. Returns state (K, R, 2), its sd,
    the sound speed.
    """
    from scipy.interpolate import CubicHermiteSpline

    n_knots, n_clocks = start.shape[:2]
    h, (c0, c_sd) = knots[1] - knots[0], speed
    free = [r for r in range(n_clocks) if r != reference]
    step = np.array([[1.0, 1.0], [0.0, 1.0]])
    noise = intensity * h**3 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    cov = np.zeros((n_knots, 2, n_knots, 2))
    var = np.diag([1.0, (5e-5 * h) ** 2])
    for k in range(n_knots):
        for m in range(k, n_knots):
            ahead = np.linalg.matrix_power(step, m - k)
            cov[m, :, k, :], cov[k, :, m, :] = ahead @ var, (ahead @ var).T
        var = step @ var @ step.T + noise
    inverse = np.linalg.inv(cov.reshape(2 * n_knots, 2 * n_knots))
    mean = np.stack(
        [[np.linalg.matrix_power(step, k) @ start[0, r] for k in range(n_knots)] for r in free]
    ).reshape(-1)
    n_state, n_pings = len(mean), ping.max() + 1
    n = n_state + 1 + n_pings
    precision = np.zeros((n, n))
    for i in range(len(free)):
        rows = slice(2 * n_knots * i, 2 * n_knots * (i + 1))
        precision[rows, rows] = inverse
    precision[n_state, n_state] = (c0 / c_sd) ** 2
    state = start.copy()
    for _ in range(4):
        common = recorded.copy()
        for r in free:
            curve = CubicHermiteSpline(knots, state[:, r, 0], state[:, r, 1] / h)
            rows = clock == r
            for _ in range(20):
                common[rows] = recorded[rows] - curve(common[rows])
        design = np.zeros((len(recorded), n))
        for i, r in enumerate(free):
            rows = np.flatnonzero(clock == r)
            for k in range(n_knots):
                for d in range(2):
                    unit = np.zeros((n_knots, 2))
                    unit[k, d] = 1.0
                    basis = CubicHermiteSpline(knots, unit[:, 0], unit[:, 1] / h)
                    design[rows, 2 * n_knots * i + 2 * k + d] = basis(common[rows])
        design[:, n_state] = distance / c0
        design[np.arange(len(recorded)), n_state + 1 + ping] = 1.0
        normal = design.T @ design / sigma**2 + precision
        target = design.T @ (recorded - distance / c0) / sigma**2
        target[:n_state] += precision[:n_state, :n_state] @ mean
        scale = 1 / np.sqrt(np.diag(normal))
        x = scale * np.linalg.solve(normal * np.outer(scale, scale), scale * target)
        for i, r in enumerate(free):
            state[:, r] = x[2 * n_knots * i : 2 * n_knots * (i + 1)].reshape(n_knots, 2)
    covariance = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    sd = np.zeros_like(state)
    for i, r in enumerate(free):
        rows = slice(2 * n_knots * i, 2 * n_knots * (i + 1))
        sd[:, r] = np.sqrt(np.diag(covariance)[rows]).reshape(n_knots, 2)
    return state, sd, c0 / (1 + x[n_state])


# -- inference ----------------------------------------------------------------------------------


def from_band(band):
    """Dense symmetric matrix of a lower band, ``band[i - j, j]``."""
    band = np.asarray(band)
    n = band.shape[1]
    out = np.zeros((n, n))
    for j in range(n):
        for i in range(j, min(n, j + band.shape[0])):
            out[i, j] = out[j, i] = band[i - j, j]
    return out


def fixes_posterior(dt, observed, u, spread):
    """Brownian track seen with Gaussian error, all dense: log evidence, mean (T, A), cov (T, T).

    u = (log sigma_step, log noise). The covariance is one axis's; both share it. Centre 0.
    """
    sigma_step, noise = np.exp(u)
    times = np.concatenate([[0.0], np.cumsum(dt)])
    prior = brownian_covariance(times, sigma_step, spread)
    total = prior + noise**2 * np.eye(len(times))
    gain = prior @ np.linalg.inv(total)
    _, log_det = np.linalg.slogdet(2 * np.pi * total)
    squares = np.einsum("ta,tu,ua->", observed, np.linalg.inv(total), observed)
    evidence = -0.5 * (observed.shape[1] * log_det + squares)
    return evidence, gain @ observed, prior - gain @ prior


def fixes_log_posterior(u, dt, observed, spread):
    """Log evidence plus log prior of u = (log sigma_step, log noise): N(0, 1), N(0, 1/2)."""
    evidence = fixes_posterior(dt, observed, u, spread)[0]
    prior = -0.5 * u[0] ** 2 - 0.5 * (u[1] / 0.5) ** 2 - np.log(0.5) - np.log(2 * np.pi)
    return evidence + prior


def fixes_moments(dt, observed, spread, centre, reach, n=41):
    """Posterior mean and variance of u (2,) and of the track (T, A), by quadrature over u."""
    axes = [np.linspace(c - r, c + r, n) for c, r in zip(centre, reach, strict=True)]
    grid = np.array([[a, b] for a in axes[0] for b in axes[1]])
    logs = np.array([fixes_log_posterior(u, dt, observed, spread) for u in grid])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    parts = [fixes_posterior(dt, observed, u, spread)[1:] for u in grid]
    means = np.array([m for m, _ in parts])
    variances = np.array([np.diag(c)[:, None] + m**2 for m, c in parts])
    mean_u, mean_x = weight @ grid, np.einsum("g,gta->ta", weight, means)
    var_u = weight @ (grid - mean_u) ** 2
    var_x = np.einsum("g,gta->ta", weight, variances) - mean_x**2
    return mean_u, var_u, mean_x, var_x


def conditional(covariance, known, values, digits=50):
    """Mean and covariance (floats) of the rest of a zero-mean normal given some of its elements."""
    with mpmath.workdps(digits):
        n = covariance.rows
        rest = [i for i in range(n) if i not in known]
        pick = lambda a, b: mpmath.matrix([[covariance[i, j] for j in b] for i in a])  # noqa: E731
        gain = pick(rest, known) * mpmath.inverse(pick(known, known))
        mean = gain * mpmath.matrix([mpmath.mpf(float(v)) for v in values])
        spread = pick(rest, rest) - gain * pick(known, rest)
        return as_floats(mean)[:, 0], as_floats(spread)


# -- signal ------------------------------------------------------------------------------------


def uniform_sum_density(m, x):
    """Irwin-Hall density of the sum of m uniforms on (0, 1): the alternating sum in fractions."""
    x = Fraction(x)
    terms = ((-1) ** k * comb(m, k) * (x - k) ** (m - 1) for k in range(m + 1) if k < x)
    return float(sum(terms) / factorial(m - 1)) if m > 1 else float(0 <= x < 1)


def simulate_gaps(rng, lo, hi, p_missed, size, most=40):
    """Times from a heard ping to the next heard one, and how many pings were missed in between."""
    missed = rng.geometric(1 - p_missed, size) - 1
    missed = missed[missed < most]
    steps = rng.uniform(lo, hi, (len(missed), most + 1))
    gaps = np.cumsum(steps, axis=1)[np.arange(len(missed)), missed]
    return gaps, missed


def intervals_given_sum(rng, lo, hi, m, total, size):
    """Uniform intervals given their sum, by rejection: all but the last free, the last allowed."""
    kept = []
    while sum(map(len, kept)) < size:
        steps = rng.uniform(lo, hi, (200_000, m - 1))
        last = total - steps.sum(axis=1)
        good = (last >= lo) & (last <= hi)
        kept.append(np.column_stack([steps, last])[good])
    return np.concatenate(kept)[:size]


# -- renewal ----------------------------------------------------------------------------------


def missed_by_simulation(rng, draw_interval, q, duration, end, draws, first=None):
    """Likelihood of a gap and of each count in it, by simulating pings: (mean, se, by count).

    ``q(s)`` is the chance of a miss at s; ``end(x)`` closes the gap x after the last ping before
    its end. With ``first`` (draws of the first ping's time) the gap begins without a heard ping,
    and the ping at its end counts as no miss: ``end`` of the empty gap is then given as a pair.
    """
    alone, close = end if isinstance(end, tuple) else (end, end)
    s = np.zeros(draws) if first is None else first(rng, draws)
    weight = np.ones(draws)
    by_count = [np.full(draws, float(alone(np.asarray(duration))))]
    if first is not None:
        weight = np.where(s < duration, q(s), 0.0)
        by_count.append(weight * close(duration - s))
    while np.any(weight > 0):
        s = s + draw_interval(rng, draws)
        weight = np.where(s < duration, weight * q(s), 0.0)
        by_count.append(weight * close(duration - s))
    total = np.sum(by_count, axis=0)
    return total.mean(), total.std() / np.sqrt(draws), np.array([v.mean() for v in by_count])


# -- emitters without identity ------------------------------------------------------------------


def best_packing(sets, worth):
    """Rows of the disjoint sets of greatest total worth, and the total, by trying all."""
    best, total = [], 0.0

    def grow(chosen, taken, value, first):
        nonlocal best, total
        if value > total:
            best, total = chosen, value
        for i in range(first, len(sets)):
            if not sets[i] & taken and worth[i] > 0:
                grow([*chosen, i], taken | sets[i], value + worth[i], i + 1)

    grow([], frozenset(), 0.0, 0)
    return best, total


def emission_log_ratio(member, position, emission, value, sensing):
    """Log ratio of an emission's likelihood to that of false measurements, by Laplace's formula.

    The information is that of derivatives by differences, a measurement at a time in loops.
    """
    s, c = sensing.sigma * sensing.speed, sensing.speed
    ref = sensing.reference

    def predicted(x, j):
        away = np.linalg.norm(x[:2] - sensing.receivers[j])
        return away + x[2] if ref is None else away - np.linalg.norm(x[:2] - sensing.receivers[ref])

    at = np.array([*position, emission * c] if ref is None else position, float)
    d, h, log_likelihood = len(at), 1e-4, 0.0
    information = np.zeros((d, d))
    for j, row in enumerate(member):
        if row < 0:
            continue
        log_likelihood -= 0.5 * ((value[row] * c - predicted(at, j)) / s) ** 2
        log_likelihood -= np.log(s * np.sqrt(2 * np.pi))
        slope = [(predicted(at + e, j) - predicted(at - e, j)) / (2 * h) for e in h * np.eye(d)]
        information += np.outer(slope, slope) / s**2
    low, high = np.array(sensing.low), np.array(sensing.high)
    space = np.prod(high - low) * (1.0 if ref is not None else max(sensing.window[1]) * c)
    volume = (2 * np.pi) ** (d / 2) / np.sqrt(max(np.linalg.det(information), 1e-300))
    out = log_likelihood + np.log(min(volume, space) * sensing.expected / space)
    for j, row in enumerate(member):
        if j == ref:
            continue
        if row < 0:
            out += np.log(1 - sensing.p_detect)
        else:
            width = (sensing.window[1][j] - sensing.window[0][j]) * c
            out += np.log(sensing.p_detect) - np.log(sensing.n_false / width)
    return out


def gospa_by_permutations(truth, estimate, c, p):
    """GOSPA (alpha = 2) from its definition: the least over all partial assignments."""
    from itertools import combinations, permutations

    t, e = len(truth), len(estimate)
    best = np.inf
    for k in range(min(t, e) + 1):
        for some in combinations(range(t), k):
            for to in permutations(range(e), k):
                away = [np.linalg.norm(truth[i] - estimate[j]) for i, j in zip(some, to)]  # noqa: B905
                best = min(best, sum(a**p for a in away) + c**p / 2 * (t + e - 2 * k))
    return best ** (1 / p)
