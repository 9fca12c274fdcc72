"""Draws of the missed pings of gaps given the path (NumPy), backward from the gap's end.

The last missed ping before s lies an interval x back with density ~ f(x) G(s - x) q(s - x): x is
proposed from the closing law in strata, and one of them drawn by those weights; the chance that
nothing lies between is f(s) against their mean. All gaps of a batch go together.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from maloc.schedule.intervals import Table
from maloc.schedule.renewal.counts import CountPart
from maloc.schedule.renewal.exact import LEAST_LOG_Q, ExactPart
from maloc.schedule.renewal.gap import Gap, end_of, needed
from maloc.schedule.renewal.grid import grid_of
from maloc.schedule.renewal.long import ENDS, LongPart
from maloc.schedule.renewal.pack import exact_part
from maloc.schedule.renewal.poisson import PoissonPart, missed_until

__all__ = [
    "draw_part",
]

_STRATA = 128
_TABLE = 2049  # points of an inverse distribution function


def draw_part(rng: np.random.Generator, part, law, log_q: np.ndarray) -> list[np.ndarray]:
    """Times after each gap's start of its missed pings, for every row, padding included."""
    if isinstance(part, PoissonPart):
        away = _poisson(rng, part, log_q)
    elif isinstance(part, CountPart):
        away = _counts(rng, part, law, log_q)
    else:
        away = _renewal(rng, _on_grid(part, law), law, log_q)
    backward = np.array([ENDS[k][0] == "before" for k in np.asarray(part.kind)])
    ends = np.asarray(part.duration)
    return [
        np.sort(end - t if back else t) for t, end, back in zip(away, ends, backward, strict=True)
    ]


def _on_grid(part: ExactPart | LongPart, law: Table) -> SimpleNamespace:
    """The batch's fields in NumPy; a long one gets the weights of the exact recursion."""
    if isinstance(part, LongPart):
        grid, gaps = grid_of(law), []
        for row in range(len(part.index)):
            time, new = np.unique(np.asarray(part.time[row]), return_index=True)
            kind, first = ENDS[int(part.kind[row])]
            states, end = np.asarray(part.states[row])[new], float(part.duration[row])
            if kind == "before":
                time, states = end - time[::-1], states[::-1]
            gaps.append((row, Gap(kind, end, time, states, first)))
        blocks = max(-(-needed(gap, law, grid) // grid.block) for _, gap in gaps)
        part, _ = exact_part(gaps, law, grid, max(blocks, 1), len(gaps), len(gaps))
    arrays = {name: np.asarray(value) for name, value in vars(part).items()}
    return SimpleNamespace(**arrays | {"coarse": part.coarse})


def _forward(part, log_q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q and log (q H) at the nodes, (N, blocks * block)."""
    left, right = log_q[part.left], log_q[part.right]
    knots = left + part.share * (right - left)
    share = np.arange(part.coarse) / part.coarse
    fine = knots[:, :-1, None] * (1 - share) + knots[:, 1:, None] * share
    fine = fine.reshape(len(knots), -1)[:, : part.later.shape[1]]
    q = np.exp(np.clip(fine, LEAST_LOG_Q, 1.0))
    lags, m = len(part.beta), part.beta.shape[-1]
    started = q[:, : part.first.shape[1]] @ part.a.T
    log_flow, scale = np.full(q.shape, -np.inf), np.zeros(len(q))
    window: list[np.ndarray] = []
    with np.errstate(divide="ignore"):
        for i in range(q.shape[1] // m):
            here = slice(i * m, (i + 1) * m)
            rhs = started[:, here] * np.exp(-scale)[:, None] if i * m < started.shape[1] else 0.0
            for flow, weights in zip(window, part.beta, strict=False):
                rhs = rhs + flow @ weights
            flow = np.broadcast_to(q[:, here] * rhs, (len(q), m))
            if m == 1:
                flow = flow / (1 - part.diagonal * q[:, here])
            log_flow[:, here] = np.log(flow) + scale[:, None]
            window = [flow, *window][:lags]
            size = np.maximum.reduce([w.max(axis=1) for w in window])
            size = np.where(size > 0, size, 1.0)
            if i * m >= started.shape[1]:
                window = [w / size[:, None] for w in window]
                scale = scale + np.log(size)
    return q, log_flow


def _inverse(function, breaks, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Distribution function (normalised) of a density on a table of points, and its total."""
    x = np.unique(np.concatenate([np.linspace(0.0, reach, _TABLE), np.clip(breaks, 0.0, reach)]))
    middle = function((x[1:] + x[:-1]) / 2)
    cdf = np.concatenate([[0.0], np.cumsum(np.diff(x) * middle)])
    return x, cdf


def _renewal(rng, part, law: Table, log_q: np.ndarray) -> list[np.ndarray]:
    q, log_flow = _forward(part, log_q)
    grid = grid_of(law)
    n = len(q)
    times: list[list[float]] = [[] for _ in range(n)]
    s = np.array(part.duration, float)
    active = np.flatnonzero((part.first.any(axis=1)) | (part.later.any(axis=1)))
    closing = {}
    for code in np.unique(part.kind):
        end, breaks, reach = end_of(law, *ENDS[code])
        reach = min(reach, float(s.max()))
        closing[int(code)] = (end, *_inverse(end, breaks, reach))
    interval = (law.density, *_inverse(law.density, law.breaks, law.hi))
    first_step = True
    while len(active):
        back = np.empty((len(active), _STRATA))
        direct, weight = np.empty(len(active)), np.empty(len(active))
        u = (np.arange(_STRATA) + rng.random((len(active), 1))) / _STRATA
        groups = part.kind[active] if first_step else np.full(len(active), -1)
        for code in np.unique(groups):
            mine = groups == code
            density, x, cdf = closing[int(code)] if code >= 0 else interval
            back[mine] = np.interp(u[mine] * cdf[-1], cdf, x)
            direct[mine], weight[mine] = density(s[active][mine]), cdf[-1]
        at = s[active][:, None] - back
        log_mass = _log_mass(at, law, q[active], log_flow[active], grid)
        top = log_mass.max(axis=1)
        base = np.where(np.isfinite(top), top, 0.0)
        mass = np.exp(log_mass - base[:, None])
        cumulated = np.cumsum(mass, axis=1)
        through = weight * cumulated[:, -1] / _STRATA
        with np.errstate(divide="ignore", over="ignore"):
            none = np.exp(np.minimum(np.log(direct) - base, 700.0))
        more = rng.random(len(active)) * (none + through) < through
        pick = np.argmax(cumulated > rng.random((len(active), 1)) * cumulated[:, -1:], axis=1)
        chosen = at[np.arange(len(active)), pick]
        active = active[more]
        s[active] = chosen[more]
        for g in active:
            times[g].append(float(s[g]))
        first_step = False
    return [np.array(t) for t in times]


def _log_mass(at, law: Table, q, log_flow, grid) -> np.ndarray:
    """Log of q G at times `at` (N, C)."""
    place = (at - grid.start) / grid.step
    cell = np.clip(np.floor(place), 0, q.shape[1] - 2).astype(int)
    share = np.clip(place - cell, 0.0, 1.0)
    row = np.arange(len(at))[:, None]
    with np.errstate(divide="ignore"):
        q_here = (1 - share) * q[row, cell] + share * q[row, cell + 1]
        first = np.log(law.density(at) * q_here)
        later = np.logaddexp(
            np.log1p(-share) + log_flow[row, cell], np.log(share) + log_flow[row, cell + 1]
        )
    return np.where(at > grid.start, np.logaddexp(first, later), -np.inf)


def _counts(rng, part: CountPart, law, log_q: np.ndarray) -> list[np.ndarray]:
    joint = np.asarray(part.log_density) + np.einsum(
        "nmk,nk->nm", np.asarray(part.weight), log_q[np.asarray(part.states)]
    )
    share = np.exp(joint - joint.max(axis=1, keepdims=True))
    cumulated = np.cumsum(share, axis=1)
    pick = np.argmax(cumulated > rng.random((len(joint), 1)) * cumulated[:, -1:], axis=1)
    out = []
    for row, n in enumerate(np.asarray(part.least) + pick):
        end, inside = float(part.duration[row]), ENDS[int(part.kind[row])][0] == "inside"
        steps = np.maximum(rng.normal(law.mean, law.sd, int(n) + 1), 0.1 * law.mean)
        steps = np.cumsum(steps)
        # given their sum (inside), or that they fit, the intervals share the difference
        scale = end / steps[-1] if inside or (n and steps[n - 1] >= end) else 1.0
        out.append(scale * steps[:n])
    return out


def _poisson(rng, part: PoissonPart, log_q: np.ndarray) -> list[np.ndarray]:
    shares, missed = (np.asarray(v) for v in missed_until(part, log_q))
    cumulated = np.cumsum(shares, axis=1)
    last = np.argmax(cumulated > rng.random((len(shares), 1)) * cumulated[:, -1:], axis=1)
    last = np.minimum(last + 1, shares.shape[1] - 1)  # silent by this node
    out = []
    for row, node in enumerate(last):
        area, time = missed[row, : node + 1], np.asarray(part.time)[row, : node + 1]
        n = rng.poisson(float(part.rate) * area[-1])
        out.append(np.interp(rng.uniform(0.0, area[-1], n), area, time) if n else np.empty(0))
    return out
