"""The joint clock model: clocks, their jumps, the sound speed and the places in one fit.

A sync ping p, emitted at common time e_p by the tag beside deployment g, is recorded by receiver r
(at deployment j) as

    recorded = t + offset_r(t) + error,    t = e_p + |x_j - x_g| s(t) + delay (own tag only).

Offsets are cubic Hermite curves between knots (`_curve`) with an integrated-random-walk prior, to
which jumps are added; the slowness s is a mean plus, where the sound speed varies, a Gauss-Markov
deviation (`_prior`). The weight of an arrival is its probability of the direct path (`_arrivals`,
EM). Emission times are eliminated ping by ping (`_normal`): the cost is linear in the length of
the record.
"""

from __future__ import annotations

import numpy as np

from maloc.sync._arrivals import (
    Arrivals,
    Geometry,
    distances,
    links,
    low_quantile,
    p_direct,
)
from maloc.sync._curve import hermite, to_common
from maloc.sync._normal import Step, Unknowns, normal_equations, solve_bordered
from maloc.sync._prior import Q_START, ClockPrior, SpeedPrior
from maloc.sync._progress import Tell, silent
from maloc.sync._state import Grid, Jumps, Layout, Solution, Start

__all__ = ["Grid", "Jumps", "Solution", "Start", "solve"]

ANNEAL = (0.01, 0.005, 0.002)  # error sd of the first rounds, s
LEAST_SIGMA = 2e-5  # s
LEAST_WEIGHT = 1e-9  # keeps the emission time of a ping without any direct arrival
FARTHEST = 3.0  # places move at most so far in one round, m: distances are not linear


def solve(
    arrivals: Arrivals,
    geometry: Geometry,
    start: Start,
    grid: Grid,
    reference: int,
    *,
    varying: bool = False,
    held: bool = False,
    robust: bool = True,
    sigma: float | None = None,
    intensity: float | None = None,
    most_rounds: int = 60,
    tell: Tell = silent,
) -> Solution:
    """Fit the clocks.

    Parameters
    ----------
    arrivals : Arrivals
        Pings of at least two arrivals.
    geometry : Geometry
    start : Start
    grid : Grid
    reference : int
        Clock that is the common time, but for its jumps.
    varying : bool
        Let the sound speed vary in time.
    held : bool
        Hold the shape of the clock curves; only a constant is added to each.
    robust : bool
        False: every arrival is direct, an ordinary least-squares fit.
    sigma, intensity : float, optional
        Hold the error sd (s) or all clock noise intensities (s^2/s^3).
    most_rounds : int
        Give up then, `converged` False.
    tell : Tell
        Told of each round.

    Returns
    -------
    Solution

    Raises
    ------
    numpy.linalg.LinAlgError
        If the normal matrix is not positive definite (numbers that are no clocks).
    """
    a, n_rows, n_clocks = arrivals, len(arrivals.recorded), start.state.shape[1]
    free = np.flatnonzero(np.arange(n_clocks) != reference)
    number = np.full(n_clocks, -1)
    number[free] = np.arange(len(free))
    at = links(a)
    own = np.unique(at.place[at.own])
    layout = Layout(free, own, start.jumps, held, np.flatnonzero(geometry.sd > 0))
    delays, jumps, constants, places = layout.parts
    weak = layout.precision(geometry)
    prior, speed_prior = ClockPrior(start.state[0, free], grid.spacing, held), None
    if varying:
        speed_prior = SpeedPrior(grid.spacing)
    n_pings = int(a.ping[-1]) + 1

    moved = np.zeros(len(weak))
    moved[0] = start.slowness
    xyz = geometry.xyz.copy() if start.xyz is None else start.xyz.copy()
    moved[places] = (xyz - geometry.xyz)[layout.placed, :2].ravel()
    if start.delay is not None:
        moved[delays] = start.delay[own]
    v = np.zeros(grid.n) if start.varying is None else start.varying.copy()
    v_sd = start.varying_sd
    state = start.state.copy()
    q, known = np.full(len(free), intensity or Q_START), 0.0
    if intensity is None and start.intensity is not None:
        q = start.intensity[free].copy()
    warm = start.sigma is not None
    s = sigma or start.sigma or ANNEAL[0]
    w = start.reflected if robust else 0.0
    base = 1 / (geometry.sound_speed * (1.0 if geometry.relative is None else geometry.relative))
    base = np.broadcast_to(base, (grid.n,))
    jump = start.jumps
    order = np.argsort(np.where(number[at.receiver] < 0, n_clocks, number[at.receiver]),
                       kind="stable")  # fmt: skip
    common: np.ndarray | None = None
    emission: np.ndarray | None = None
    u: Unknowns | None = None
    step, border = None, np.zeros((0, 0))
    converged, rounds, anneal = False, 0, 0 if warm else len(ANNEAL)

    while True:
        lead = jump._replace(size=jump.size + moved[jumps]).lead(a.receiver, a.segment)
        recorded = a.recorded - lead
        if held:
            constant = np.append(moved[constants], 0.0)[number]
            recorded = recorded - constant[a.receiver]
        common = to_common(state, grid.first, grid.spacing, a.receiver, recorded, common)
        place = np.clip((common - grid.first) / grid.spacing, 0, grid.n - 1)
        slowness = np.interp(place, np.arange(grid.n), base * (1 + moved[0] + v))
        distance = distances(xyz, at.place, at.source)
        late = np.zeros(len(xyz))
        late[own] = moved[delays]
        y = common - distance[at.of] * slowness - np.where(at.own, late[at.place], 0.0)[at.of]
        if emission is None:
            low = (
                low_quantile(y, a.ping) if robust else np.bincount(a.ping, y) / np.bincount(a.ping)
            )
            emission = low
            knot = ((emission - grid.first) / grid.spacing).astype(int)
            # all arrivals of a ping share its pair of knots, so that blocks couple neighbours only
            knot = np.maximum.accumulate(np.clip(knot, 0, grid.n - 2))[a.ping]
            rank = np.empty(len(order), int)
            rank[order] = np.arange(len(order))
            u = Unknowns(knot, a.ping, number[a.receiver], rank[at.of],
                         np.where(number[at.receiver] < 0, n_clocks, number[at.receiver])[order],
                         grid.n, len(free), varying)  # fmt: skip
        for _ in range(1 if rounds else 3):
            weight = p_direct(y - emission[a.ping], s, w) if robust else np.ones(n_rows)
            precision = np.maximum(weight, LEAST_WEIGHT) / s**2
            total = np.bincount(a.ping, precision, n_pings)
            emission = np.bincount(a.ping, precision * y, n_pings) / total
        residual = y - emission[a.ping]
        if step is not None and (converged or rounds >= most_rounds):
            break

        tell(f"fitting {len(jump.size)} jumps and {len(free)} clocks")
        assert u is not None
        fraction = (common - grid.first) / grid.spacing - u.knot
        speed = None
        if varying:
            reach = (distance[at.of] / geometry.sound_speed)[:, None]
            speed = reach * np.column_stack([1 - fraction, fraction])
        border = layout.rows(at, xyz, float(slowness.mean()), geometry)[order]
        e = normal_equations(u, hermite(fraction), speed, border, precision, residual)
        prior.add(e.diag, e.off, e.rhs, state[:, free], q)
        if speed_prior is not None:
            speed_prior.add(e.diag, e.off, e.rhs, v, v_sd)
        e.corner[np.diag_indices(len(moved))] += weak
        e.rhs_border[:] -= weak * moved
        step = solve_bordered(e)
        far = float(np.abs(step.border[places]).max(initial=0.0))
        change = step.border * min(1.0, FARTHEST / max(far, 1e-12))
        knots = step.knots + step.through @ (step.border - change)
        moved += change
        state[:, free] += knots[:, : 2 * len(free)].reshape(grid.n, -1, 2)
        if varying:
            v += knots[:, -1]
        xyz[layout.placed, :2] = geometry.xyz[layout.placed, :2] + moved[places].reshape(-1, 2)
        rounds += 1

        if intensity is None and not held and rounds > (0 if warm else 2):
            q, known = prior.intensity(state[:, free], *_of_clocks(step, len(free)), q)
        if speed_prior is not None and rounds > (0 if warm else 4):
            v_sd = speed_prior.sd(v, step.cov[:, -1, -1], step.cross[:, -1, -1], v_sd)
        before = s
        if robust and rounds < anneal:
            s = s if sigma else ANNEAL[rounds]
        else:
            used = float(weight.sum())
            if sigma is None:
                freedom = used - np.count_nonzero(total * s**2 > 0.5) - known - len(moved)
                s = np.sqrt((weight * residual**2).sum() / max(freedom, 1.0))
                s = float(np.clip(s, max(before / 3, LEAST_SIGMA), before * 3))
            if robust:
                w = float(np.clip(1 - 0.003 - used / n_rows, 1e-3, 0.5))
        changed = np.abs(knots[:, : 2 * len(free) : 2]).max(initial=0.0)
        settled = abs(s / before - 1) < 2e-3 and changed < 0.02 * s
        converged = bool(settled and rounds > anneal + (1 if warm else 3))

    assert common is not None and emission is not None
    state_sd, all_q = np.zeros_like(state), np.zeros(n_clocks)
    var = np.diagonal(step.cov, axis1=1, axis2=2)
    state_sd[:, free] = np.sqrt(var[:, : 2 * len(free)]).reshape(grid.n, -1, 2)
    all_q[free] = q
    border_sd = np.sqrt(step.border_cov.diagonal())
    xy_sd, delay, delay_sd = np.zeros((len(xyz), 2)), np.zeros(len(xyz)), np.zeros(len(xyz))
    xy_sd[layout.placed] = border_sd[places].reshape(-1, 2)
    delay[own], delay_sd[own] = moved[delays], border_sd[delays]
    if held:
        state[:, free, 0] += moved[constants]
    speed_at = 1 / (base * (1 + moved[0] + v))
    spread = np.full(grid.n, step.border_cov[0, 0])
    if varying:
        spread = spread + var[:, -1] + 2 * step.cov_border[:, -1, 0]
    known_speed = geometry.sound_speed_sd == 0 and not varying
    speed_sd = np.zeros(grid.n) if known_speed else speed_at * np.sqrt(spread) / (1 + moved[0] + v)
    end = Start(
        state, jump._replace(size=jump.size + moved[jumps]), s, w, all_q, xyz, float(moved[0]), v,
        v_sd, delay,
    )  # fmt: skip
    return Solution(
        end, state_sd, xyz, delay, xy_sd, speed_at, speed_sd, s, w, border_sd[jumps], delay_sd,
        emission, common, residual, weight, layout, step, rounds, converged,
    )  # fmt: skip


def _of_clocks(step: Step, n_clocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariances of each clock at a knot (K, C, 2, 2), and with the next (K - 1, C, 2, 2)."""
    i = 2 * np.arange(n_clocks)[:, None, None] + np.array([[0, 0], [1, 1]])
    j = 2 * np.arange(n_clocks)[:, None, None] + np.array([[0, 1], [0, 1]])
    return step.cov[:, i, j], step.cross[:, i, j]
